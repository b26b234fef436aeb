//! Where was a single image taken? Lens, tilt and height are known; x, y and yaw are looked for on a field.

use glam::DVec3;
use nalgebra::{Matrix6, Vector6};
use serde::Serialize;

use crate::config::{Formula, Model, SimdPath};
use crate::geometry::{Euler, Field, Isometry, Lens, Pose2, wrap_angle};
use crate::localization::filter::always;
use crate::localization::global::{self, Candidate, Search, SearchState};
use crate::localization::observation::default_alpha;
use crate::localization::refinement::{Prior, Refiner};
use crate::localization::{
    Effort, Filter, FilterSettings, FilterState, MotionModel, Observation, Sampling, Spread, Support, observation,
};
use crate::vision::{BodyMask, Picture, Seen, Vision, VisionSettings};

/// What is known beforehand.
#[derive(Clone, Debug)]
pub struct Known {
    pub lens: Lens,
    /// Of `camera_link`; yaw is ignored.
    pub attitude: Euler,
    /// Of `camera_link` above the carpet.
    pub height_m: f64,
    /// About where `camera_link` is; without it the whole field is searched.
    pub initial: Option<Pose2>,
    pub body: Option<BodyMask>,
}

/// A pose that explains the image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Found {
    #[serde(serialize_with = "planar")]
    pub pose: Pose2,
    /// Fitted to the lines to a fraction of a pixel; else as the search over the field found it.
    pub refined: bool,
    /// Share of the expected line contrast that was found, 0 to 1.
    pub share: f64,
    /// Painted line in view in units of 10 cm, counted by its certainty.
    pub weight: f64,
    pub log_likelihood: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Located {
    /// Best first; none if the image shows no line on the ground. Each pose's mirror image explains the image as well.
    pub found: Vec<Found>,
}

/// How far the best pose may be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fit {
    /// It explains the lines, and no other pose does so nearly as well.
    Good,
    /// It explains the lines, and so does a pose elsewhere.
    Doubtful,
    /// The lines are not explained, or there are hardly any: what was found means nothing.
    None,
}

/// A search of a whole field finds a third to a half of the expected contrast in an image of noise, and sometimes more:
/// but then on little line, or at many places.
pub const LEAST_SHARE: f64 = 0.5;
/// Certain line in view, in units of 10 cm.
pub const LEAST_WEIGHT: f64 = 8.0;
/// Log likelihood by which the best must stand out.
const CLEAR_BY: f64 = 2.0;

/// Poses closer than this are one.
const SAME_M: f64 = 0.4;
const SAME_RAD: f64 = 0.3;

/// How many explanations are kept.
const KEPT: usize = 5;
/// The tilt is known: what is left is the lens file's own error.
const TILT_SIGMA_RAD: f64 = 0.005;
/// On every field that is played on.
const LINE_WIDTH_M: f64 = 0.05;
const LINE_POINTS: usize = 700;
const SEARCH_MARGIN_M: f64 = 0.5;
/// How far off a pose that was found may be before it is refined, and how wrong the given height.
const START_M: f64 = 0.15;
const START_RAD: f64 = 0.05;
const HEIGHT_M: f64 = 0.005;
/// The tilt is given: it is not to make up for a field that is not quite as its file says.
const TILT_RAD: f64 = 0.0005;
/// What a refined pose needs: line places that fit, and their share of those expected. A field is hardly ever quite as its
/// file says, and refining moves a pose no farther than its basin.
const FEWEST_FITTING: usize = 15;
const LEAST_FITTING_SHARE: f64 = 0.25;
/// Around an initial pose.
const INITIAL: Spread = Spread { xy_m: 0.3, yaw_rad: 0.15 };
const INITIAL_PARTICLES: usize = 2000;
const INITIAL_ITERATIONS: usize = 8;

impl Known {
    /// `base_footprint` is the point of the carpet below the camera, heading as the camera.
    fn footprint_from_link(&self) -> Isometry {
        let Euler { pitch, roll, .. } = self.attitude;
        Isometry::from_euler(Euler { yaw: 0.0, pitch, roll }, DVec3::new(0.0, 0.0, self.height_m))
    }

    /// The camera's pose in `map` when it stands at a place of the field.
    pub fn map_from_link(&self, place: &Pose2) -> Isometry {
        place.to_isometry() * self.footprint_from_link()
    }

    /// What the image shows of the ground: the same for every field.
    pub fn look(&self, picture: &Picture) -> Seen {
        let settings = VisionSettings {
            reading: observation::reading(Model::Gauss, Formula::Corrected),
            line_width_m: LINE_WIDTH_M,
            range_m: 0.0,
            tilt_sigma_rad: TILT_SIGMA_RAD,
            nearest_reach_m: 0.25,
            reduction: 0,
        };
        let footprint_from_optical = self.footprint_from_link() * Isometry::link_from_optical();
        Vision::new(&self.lens, settings).look(picture, &footprint_from_optical, self.body.as_ref())
    }

    pub fn locate(&self, seen: &Seen, field: &Field, seed: u64) -> Located {
        let alpha = default_alpha(Formula::Corrected);
        let observation = Observation::new(field, LINE_POINTS, Formula::Corrected, alpha, SimdPath::Auto);
        let candidates = match self.initial {
            None => {
                let mut search = Search::new(field, SEARCH_MARGIN_M, &observation);
                let mut state = SearchState::default();
                let found =
                    search.run(&observation, &seen.table, KEPT, &mut state, &mut Effort::default(), &mut always);
                found.unwrap_or_default()
            }
            Some(initial) => vec![around(&observation, seen, initial, seed)],
        };
        let mut refiner = Refiner::new(field, &self.lens);
        let found = candidates.iter().map(|candidate| {
            let refined = self.refined(&mut refiner, seen, &candidate.pose);
            let pose = refined.unwrap_or(candidate.pose);
            // On a field that is not quite as its file says a refined pose may show less of the contrast than the one it
            // came from: whichever shows more says whether this is the place.
            let support = |pose: &Pose2| observation.support(seen.lines(), pose);
            let (own, start) = (support(&pose), support(&candidate.pose));
            let Support { share, weight, .. } = if own.share >= start.share { own } else { start };
            let log_likelihood = observation.log_likelihood(&seen.table, &pose).max(candidate.log_likelihood);
            Found { pose, refined: refined.is_some(), share, weight, log_likelihood }
        });
        let mut found: Vec<Found> = found.collect();
        found.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
        let found = found.into_iter();
        Located { found: without_mirrors(found.filter(|found| found.weight > 0.0)) }
    }
}

impl Known {
    /// The pose that the lines fit best, if enough of them do. Tilt and height may give way a little.
    fn refined(&self, refiner: &mut Refiner, seen: &Seen, start: &Pose2) -> Option<Pose2> {
        let map_from_optical = self.map_from_link(start) * Isometry::link_from_optical();
        let sigmas = Vector6::new(START_M, START_M, HEIGHT_M, TILT_RAD, TILT_RAD, START_RAD);
        let covariance = Matrix6::from_diagonal(&sigmas.component_mul(&sigmas));
        let prior = Prior::of_pose(map_from_optical, &covariance);
        let refined = refiner.refine(&seen.image, &prior, &[Vector6::zeros()])?;
        let lines = refined.lines;
        let agrees = lines.fitting >= FEWEST_FITTING && lines.share > LEAST_FITTING_SHARE;
        agrees.then(|| Pose2::from_isometry(&(refined.map_from_optical * Isometry::link_from_optical().inverse())))
    }
}

/// Each pose stands for its mirror image too; near the halfway line a search finds both.
fn without_mirrors(found: impl Iterator<Item = Found>) -> Vec<Found> {
    let mut kept: Vec<Found> = Vec::new();
    for candidate in found {
        let mirror = candidate.pose.mirrored();
        let is_known = |known: &Found| {
            let turned = wrap_angle(known.pose.yaw - mirror.yaw).abs();
            known.pose.distance(&mirror) < SAME_M && turned < SAME_RAD
        };
        if !kept.iter().any(is_known) {
            kept.push(candidate);
        }
    }
    kept
}

impl Located {
    pub fn fit(&self) -> Fit {
        match self.found[..] {
            [best, ..] if best.share < LEAST_SHARE || best.weight < LEAST_WEIGHT => Fit::None,
            [best, next, ..] if best.log_likelihood - next.log_likelihood < CLEAR_BY => Fit::Doubtful,
            [_, ..] => Fit::Good,
            [] => Fit::None,
        }
    }
}

fn around(observation: &Observation, seen: &Seen, initial: Pose2, seed: u64) -> Candidate {
    let settings = FilterSettings {
        sampling: Sampling { particles: INITIAL_PARTICLES, iterations: INITIAL_ITERATIONS, adaptive: false, fewest: 0 },
        motion: MotionModel::default(),
        jitter: Spread { xy_m: 0.05, yaw_rad: 0.03 },
        jitter_shrink: 0.7,
        seed,
    };
    let mut filter = Filter::new(settings, observation.clone(), FilterState::default());
    filter.restart(initial, INITIAL);
    let still = Some(Pose2::default());
    let best = filter.step(still, 0.0, &seen.table, &mut Effort::default(), &mut always).best;
    let start = Candidate { pose: best, log_likelihood: observation.log_likelihood(&seen.table, &best) };
    global::climb(observation, &seen.table, start, &mut Effort::default())
}

fn planar<S: serde::Serializer>(pose: &Pose2, serializer: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct Planar {
        x: f64,
        y: f64,
        yaw_deg: f64,
    }
    Planar { x: pose.x, y: pose.y, yaw_deg: pose.yaw.to_degrees() }.serialize(serializer)
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;

    #[test]
    fn a_fit_needs_contrast_line_and_no_rival() {
        let found = |share, weight, log_likelihood| Found {
            pose: Pose2::default(),
            refined: true,
            share,
            weight,
            log_likelihood,
        };
        let fit = |found: &[Found]| Located { found: found.to_vec() }.fit();
        assert_eq!(fit(&[]), Fit::None);
        let at = |x, yaw, log_likelihood| Found { pose: Pose2::new(x, 0.02, yaw), ..found(0.9, 30.0, log_likelihood) };
        let both = [at(0.05, 1.0, 9.0), Found { pose: Pose2::new(-0.05, -0.02, 1.0 - PI), ..found(0.9, 30.0, 9.0) }];
        assert_eq!(without_mirrors(both.into_iter()).len(), 1, "a pose and its mirror");
        assert_eq!(without_mirrors([both[0], at(2.0, 1.0, 8.0)].into_iter()).len(), 2);
        assert_eq!(fit(&[found(0.4, 50.0, 9.0)]), Fit::None);
        assert_eq!(fit(&[found(0.9, 3.0, 9.0)]), Fit::None);
        assert_eq!(fit(&[found(0.9, 30.0, 9.0)]), Fit::Good);
        assert_eq!(fit(&[found(0.9, 30.0, 9.0), found(0.8, 30.0, 4.0)]), Fit::Good);
        assert_eq!(fit(&[found(0.9, 30.0, 9.0), found(0.8, 30.0, 8.5)]), Fit::Doubtful);
    }
}
