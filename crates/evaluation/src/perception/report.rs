//! How a detector did by class, distance and light.

use serde::Serialize;

use realitysim_labels::LANDMARK_CLASSES;

use super::bands::{Band, DISTANCES_M, Light};
use super::error_model::Delay;
use super::observation::{Observation, Observations};
use super::statistics::Statistics;

/// How a detector did on some pictures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DetectorReport {
    /// Time that its command took for a picture, with its start.
    pub delay_ms: Delay,
    /// What was counted, for each class and condition under which there was anything.
    pub cells: Vec<ReportCell>,
}

/// How a detector did on the landmarks of a class under some condition.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReportCell {
    /// Name of the class.
    pub class: &'static str,
    /// Distance over the ground from the camera, metres; `None` stands for all.
    pub distance_m: Option<Band>,
    /// How bright the picture is there; `None` stands for all.
    pub light: Option<Light>,
    /// What was counted.
    #[serde(flatten)]
    pub statistics: Statistics,
}

impl DetectorReport {
    /// Of what was seen of a detector.
    pub fn new(observations: &Observations, delay_ms: Delay) -> Self {
        let mut cells = Vec::new();
        for class in 0..LANDMARK_CLASSES.names.len() {
            for distance_m in [None].into_iter().chain(DISTANCES_M.map(Some)) {
                let lights = [None].into_iter().chain(Light::ALL.map(Some));
                cells.extend(lights.filter_map(|light| cell(observations, class, distance_m, light)));
            }
        }
        Self { delay_ms, cells }
    }
}

fn cell(
    observations: &Observations,
    class: usize,
    distance_m: Option<Band>,
    light: Option<Light>,
) -> Option<ReportCell> {
    let belongs = |one: &&Observation| {
        one.class == class
            && distance_m.is_none_or(|band| band.contains(one.distance_m))
            && light.is_none_or(|light| light == one.light)
    };
    let statistics = Statistics::of(observations.all.iter().filter(belongs), observations.speeds_rad_s.len());
    let cell = ReportCell { class: LANDMARK_CLASSES.names[class], distance_m, light, statistics };
    (!statistics.is_empty()).then_some(cell)
}
