//! A model of a detector's errors, to be sampled from.

use std::collections::BTreeMap;

use serde::Serialize;

use realitysim_labels::LANDMARK_CLASSES;

use super::bands::{Band, DISTANCES_M, OFF_AXIS_DEG, SPEEDS_DEG_S};
use super::observation::{Observation, Observations};
use super::statistics::Statistics;
use crate::statistics::quantile;

/// Version of the file's format.
const FORMAT: u32 = 1;
/// Fewest landmarks to be seen of which a cell of an angle or a speed is made: a probability is then known to about 0.15.
const MIN_TO_BE_SEEN: usize = 30;

/// A model of a detector's errors. Its JSON is described in `docs/reference/formats.md`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorModel {
    /// Version of the format.
    pub realitysim_error_model: u32,
    /// Version of the program that wrote it.
    pub software: &'static str,
    /// Number of pictures that the detector has looked at.
    pub pictures: usize,
    /// Time that the detector's command took for a picture, with its start.
    pub delay_ms: Delay,
    /// For each class its cells: the first that contains a landmark is that landmark's.
    pub classes: BTreeMap<&'static str, Vec<ModelCell>>,
}

/// Time that a detector took for a picture, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Delay {
    /// The median.
    pub median: f64,
    /// The 99 % quantile.
    pub p99: f64,
}

/// What a detector does with landmarks of a class at some distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ModelCell {
    /// Distance over the ground from the camera, metres.
    pub distance_m: Band,
    /// Angle off the optical axis, degrees; `None` stands for all.
    pub off_axis_deg: Option<Band>,
    /// Angular speed of the camera, degrees a second; `None` stands for all, also unknown ones.
    pub speed_deg_s: Option<Band>,
    /// What was counted there.
    #[serde(flatten)]
    pub statistics: Statistics,
}

impl Delay {
    /// Of the times for some pictures, milliseconds.
    pub fn of(mut times_ms: Vec<f64>) -> Self {
        times_ms.sort_by(f64::total_cmp);
        Self { median: quantile(&times_ms, 0.5), p99: quantile(&times_ms, 0.99) }
    }
}

impl ErrorModel {
    /// Of what was seen of a detector.
    pub fn new(observations: &Observations, delay_ms: Delay) -> Self {
        let classes = LANDMARK_CLASSES.names.iter().enumerate();
        Self {
            realitysim_error_model: FORMAT,
            software: env!("CARGO_PKG_VERSION"),
            pictures: observations.speeds_rad_s.len(),
            delay_ms,
            classes: classes.map(|(class, name)| (*name, cells(observations, class))).collect(),
        }
    }
}

/// The cells of a class, the narrowest first.
fn cells(observations: &Observations, class: usize) -> Vec<ModelCell> {
    let all = [None];
    let (angles, speeds) = (OFF_AXIS_DEG.map(Some), SPEEDS_DEG_S.map(Some));
    let mut cells = Vec::new();
    for (angles, speeds) in [(&angles[..], &speeds[..]), (&angles, &all), (&all, &speeds), (&all, &all)] {
        for distance_m in DISTANCES_M {
            for off_axis_deg in angles {
                for speed_deg_s in speeds {
                    let cell = Condition { distance_m, off_axis_deg: *off_axis_deg, speed_deg_s: *speed_deg_s };
                    cells.extend(cell.cell(observations, class));
                }
            }
        }
    }
    cells
}

/// What observations of a cell have in common.
struct Condition {
    distance_m: Band,
    off_axis_deg: Option<Band>,
    speed_deg_s: Option<Band>,
}

impl Condition {
    /// The cell, unless too little was seen there.
    fn cell(&self, observations: &Observations, class: usize) -> Option<ModelCell> {
        let own = observations.all.iter().filter(|one| one.class == class && self.holds_for(one));
        let pictures = observations.speeds_rad_s.iter().filter(|speed| self.has_speed(**speed)).count();
        let statistics = Statistics::of(own, pictures);
        let Self { distance_m, off_axis_deg, speed_deg_s } = *self;
        let is_whole = off_axis_deg.is_none() && speed_deg_s.is_none();
        let suffices = if is_whole { !statistics.is_empty() } else { statistics.to_be_seen >= MIN_TO_BE_SEEN };
        suffices.then_some(ModelCell { distance_m, off_axis_deg, speed_deg_s, statistics })
    }

    fn holds_for(&self, one: &Observation) -> bool {
        let has_angle = |band: Band| band.contains(one.off_axis_rad.to_degrees());
        self.distance_m.contains(one.distance_m)
            && self.off_axis_deg.is_none_or(has_angle)
            && self.has_speed(one.speed_rad_s)
    }

    fn has_speed(&self, speed_rad_s: Option<f64>) -> bool {
        self.speed_deg_s.is_none_or(|band| speed_rad_s.is_some_and(|speed| band.contains(speed.to_degrees())))
    }
}
