//! Locates an image whose tilt or height is not known: both are found from the field lines, together with the place.
//!
//! Mounts are tried on a grid: each is one look at the ground and one survey of the field on a wide grid of places. Around the best of
//! them finer steps are tried, each from the places of the mount beside it. The best ones are
//! fitted to the lines with attitude and height free. Lines determine them only if there are enough of them in view; otherwise,
//! or if two solutions differ, [`ImageLocation::fit`] is `None`.

use realitysim_geometry::{Euler, Field, Isometry, Lens, Pose2};
use realitysim_localization::global_search::Candidate;
use realitysim_vision::{BodyMask, Picture};

use crate::image_location::{ImageLocation, PoseHypothesis, without_mirrors};
use crate::single_image::{FieldSearch, ImagePrior, MEASURED_HEIGHT_SIGMA_M};

/// What is known about a camera whose attitude or height is not.
#[derive(Clone, Debug)]
pub struct UnknownMount {
    /// The lens.
    pub lens: Lens,
    /// Attitude of `camera_link` with the standard deviation of roll and pitch, radians, if it is known; yaw is ignored.
    pub attitude: Option<(Euler, f64)>,
    /// Height of `camera_link` above the carpet, metres, if it is known.
    pub height_m: Option<f64>,
    /// Approximate pose of `camera_link` in `map`; without it the whole field is searched.
    pub initial: Option<Pose2>,
    /// Pixels that show the robot's own body.
    pub body: Option<BodyMask>,
}

/// A mount of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Mount {
    roll: f64,
    pitch: f64,
    height_m: f64,
}

/// A mount that was tried.
#[derive(Clone, Debug)]
struct Tried {
    mount: Mount,
    /// Its best places on the field, best first; at least one.
    places: Vec<Candidate>,
}

/// Pitches that are tried, radians: from slightly above the horizon to steeply down, as heads of humanoids look.
const PITCHES_RAD: [f64; 2] = [-0.1, 1.1];
/// Heights that are tried, metres: from the smallest humanoid to above the tallest (RoboCup Humanoid League rules: 0.4 to 2 m).
const HEIGHTS_M: [f64; 2] = [0.25, 1.8];
/// Step between pitches of the grid, radians.
const PITCH_STEP_RAD: f64 = 0.06;
/// Ratio of two heights of the grid that follow each other.
const HEIGHT_RATIO: f64 = 1.13;
/// Steps around a mount in the finer rounds, as shares of the grid's.
const ROUNDS: [f64; 3] = [0.5, 0.5, 0.25];
/// Step of roll in the first finer round, radians; later ones go with the other steps. A robot on its feet leans little.
const ROLL_STEP_RAD: f64 = 0.05;
/// Number of mounts that go on to the next round.
const KEPT_MOUNTS: usize = 5;
/// Number of mounts whose poses are fitted to the lines.
const FITTED_MOUNTS: usize = 8;
/// Standard deviations of a mount of the last round, as the fit takes it.
const TILT_SIGMA_RAD: f64 = 0.04;
const HEIGHT_SIGMA_SHARE: f64 = 0.08;
/// Number of fits, each from where the one before ended.
const FITS: usize = 3;
/// Most poses that are returned.
const KEPT: usize = 5;

impl UnknownMount {
    /// Finds the poses on a field that explain what the image shows. `seed` is for the particles around an initial pose.
    pub fn locate(&self, picture: &Picture, field: &Field, seed: u64) -> ImageLocation {
        let mut survey = FieldSearch::for_survey(field);
        let grid = self.grid().into_iter();
        let mut tried: Vec<Tried> = grid
            .filter_map(|mount| Tried::new(mount, self.exactly(mount).placed_by_survey(picture, &mut survey, seed)))
            .collect();
        for share in ROUNDS {
            for best in best_distinct(&tried, KEPT_MOUNTS) {
                for finer in self.around(best.mount, share) {
                    if !tried.iter().any(|known| known.mount == finer) {
                        let places = self.exactly(finer).placed_near(picture, &mut survey, &best.places);
                        tried.extend(Tried::new(finer, places));
                    }
                }
            }
        }
        let mut found: Vec<PoseHypothesis> = Vec::new();
        for best in best_distinct(&tried, FITTED_MOUNTS) {
            found.extend(self.fitted(picture, field, &survey, &best));
        }
        // Log likelihoods of different heights are of different amounts of field in view: what chance explains is not.
        let is_possible = |height_m: f64| self.height_m.is_some() || is_possible_height(height_m);
        found.retain(|found| found.weight > 0.0 && is_possible(found.map_from_link.translation.z));
        found.sort_by(|a, b| b.merit().total_cmp(&a.merit()));
        let mut found = without_mirrors(found.into_iter());
        found.truncate(KEPT);
        ImageLocation { found, searched: self.initial.is_none(), mount_is_known: false }
    }

    /// The mounts of the coarse grid. What is known is not varied.
    fn grid(&self) -> Vec<Mount> {
        let heights: Vec<f64> = match self.height_m {
            Some(height_m) => vec![height_m],
            None => {
                let steps = libm::ceil(libm::log(HEIGHTS_M[1] / HEIGHTS_M[0]) / libm::log(HEIGHT_RATIO)) as i32;
                (0..=steps).map(|step| HEIGHTS_M[0] * libm::pow(HEIGHT_RATIO, f64::from(step))).collect()
            }
        };
        let tilts: Vec<[f64; 2]> = match self.attitude {
            Some((attitude, _)) => vec![[attitude.roll, attitude.pitch]],
            None => {
                let steps = libm::ceil((PITCHES_RAD[1] - PITCHES_RAD[0]) / PITCH_STEP_RAD) as i32;
                (0..=steps).map(|step| [0.0, PITCHES_RAD[0] + f64::from(step) * PITCH_STEP_RAD]).collect()
            }
        };
        let with_height = |[roll, pitch]: &[f64; 2], height_m: f64| Mount { roll: *roll, pitch: *pitch, height_m };
        heights.iter().flat_map(|height_m| tilts.iter().map(move |tilt| with_height(tilt, *height_m))).collect()
    }

    /// The mounts around one, at this share of the grid's steps.
    fn around(&self, mount: Mount, share: f64) -> Vec<Mount> {
        let (roll_step, pitch_step) = match self.attitude {
            // A known attitude is varied by its own uncertainty.
            Some((_, sigma_rad)) => (2.0 * share * sigma_rad, 2.0 * share * sigma_rad),
            None => (2.0 * share * ROLL_STEP_RAD, share * PITCH_STEP_RAD),
        };
        let ratio = if self.height_m.is_some() { 1.0 } else { libm::pow(HEIGHT_RATIO, share) };
        // One after the other: all combinations would be four times as many, and rounds follow each other.
        let changed = |roll: f64, pitch: f64, ratio: f64| Mount {
            roll: mount.roll + roll,
            pitch: mount.pitch + pitch,
            height_m: mount.height_m * ratio,
        };
        vec![
            changed(roll_step, 0.0, 1.0),
            changed(-roll_step, 0.0, 1.0),
            changed(0.0, pitch_step, 1.0),
            changed(0.0, -pitch_step, 1.0),
            changed(0.0, 0.0, ratio),
            changed(0.0, 0.0, 1.0 / ratio),
        ]
    }

    /// This mount as if it were known.
    fn exactly(&self, mount: Mount) -> ImagePrior {
        self.prior(mount, 0.0, MEASURED_HEIGHT_SIGMA_M, self.initial)
    }

    /// The poses of one mount, each fitted to the lines with attitude and height free.
    fn fitted(&self, picture: &Picture, field: &Field, survey: &FieldSearch, tried: &Tried) -> Vec<PoseHypothesis> {
        let mount = tried.mount;
        let tilt_sigma_rad = self.attitude.map_or(TILT_SIGMA_RAD, |(_, sigma_rad)| sigma_rad);
        let height_sigma = |height_m: f64| match self.height_m {
            Some(_) => MEASURED_HEIGHT_SIGMA_M,
            None => HEIGHT_SIGMA_SHARE * height_m,
        };
        let first = self.prior(mount, tilt_sigma_rad, height_sigma(mount.height_m), self.initial);
        let look = first.look_once(picture, field.line_width());
        let located = first.judged(&look, field, survey, core::slice::from_ref(&tried.places));
        let mut found = Vec::new();
        for start in located.found {
            let mut best = start;
            for _ in 1..FITS {
                let mount = self.known_or(mount_of(&best.map_from_link));
                let prior = self.prior(mount, tilt_sigma_rad, height_sigma(mount.height_m), self.initial);
                match prior.refit(picture, field, survey, &best) {
                    Some(better) => best = better,
                    None => break,
                }
            }
            found.push(best);
        }
        found
    }

    /// The mount with what is known in place of what was fitted, so that no fit moves the centre of a prior.
    fn known_or(&self, fitted: Mount) -> Mount {
        let [roll, pitch] =
            self.attitude.map_or([fitted.roll, fitted.pitch], |(attitude, _)| [attitude.roll, attitude.pitch]);
        Mount { roll, pitch, height_m: self.height_m.unwrap_or(fitted.height_m) }
    }

    fn prior(&self, mount: Mount, tilt_sigma_rad: f64, height_sigma_m: f64, initial: Option<Pose2>) -> ImagePrior {
        let Mount { roll, pitch, height_m } = mount;
        ImagePrior {
            lens: self.lens.clone(),
            attitude: Euler { yaw: 0.0, pitch, roll },
            tilt_sigma_rad,
            height_m,
            height_sigma_m,
            initial,
            body: self.body.clone(),
        }
    }
}

fn mount_of(map_from_link: &Isometry) -> Mount {
    let Euler { roll, pitch, .. } = map_from_link.euler();
    Mount { roll, pitch, height_m: map_from_link.translation.z }
}

/// Whether a fit has not left the range of heights by more than a step.
fn is_possible_height(height_m: f64) -> bool {
    (HEIGHTS_M[0] / HEIGHT_RATIO..=HEIGHTS_M[1] * HEIGHT_RATIO).contains(&height_m)
}

impl Tried {
    fn new(mount: Mount, places: Vec<Candidate>) -> Option<Self> {
        (!places.is_empty()).then_some(Self { mount, places })
    }

    fn log_likelihood(&self) -> f64 {
        self.places.first().map_or(f64::NEG_INFINITY, |best| best.log_likelihood)
    }
}

/// The best mounts, best first, of which no two are neighbours on the grid.
fn best_distinct(tried: &[Tried], count: usize) -> Vec<Tried> {
    let mut ranked: Vec<&Tried> = tried.iter().collect();
    ranked.sort_by(|a, b| b.log_likelihood().total_cmp(&a.log_likelihood()));
    let are_near = |a: &Mount, b: &Mount| {
        let ratio = libm::fabs(libm::log(a.height_m / b.height_m)) < libm::log(HEIGHT_RATIO);
        ratio && libm::fabs(a.pitch - b.pitch) < PITCH_STEP_RAD && libm::fabs(a.roll - b.roll) < ROLL_STEP_RAD
    };
    let mut best: Vec<Tried> = Vec::new();
    for tried in ranked {
        if best.len() == count {
            break;
        }
        if !best.iter().any(|known| are_near(&known.mount, &tried.mount)) {
            best.push(tried.clone());
        }
    }
    best
}
