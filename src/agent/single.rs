//! Where was a single image taken? Lens, tilt and height are known; x, y and yaw are looked for on a field.

use glam::DVec3;
use serde::Serialize;

use crate::config::{Formula, Model, SimdPath};
use crate::geometry::{Euler, Field, Isometry, Lens, Pose2};
use crate::localization::global::{self, Candidate};
use crate::localization::observation::default_alpha;
use crate::localization::{
    Filter, FilterSettings, FilterState, MotionModel, Observation, Spread, Support, observation,
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
    /// Share of the expected line contrast that was found, 0 to 1.
    pub share: f64,
    /// Painted line in view in units of 10 cm, counted by its certainty.
    pub weight: f64,
    pub log_likelihood: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Located {
    /// Best first; none if the image shows no ground. Each pose's mirror image explains the image as well.
    pub found: Vec<Found>,
}

/// How many explanations are kept.
const KEPT: usize = 5;
/// The tilt is known: what is left is the lens file's own error.
const TILT_SIGMA_RAD: f64 = 0.005;
const LINE_POINTS: usize = 700;
const SEARCH_MARGIN_M: f64 = 0.5;
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
            range_m: 0.0,
            tilt_sigma_rad: TILT_SIGMA_RAD,
            nearest_reach_m: 0.25,
            reduction: 0,
        };
        let footprint_from_optical = self.footprint_from_link() * Isometry::link_from_optical();
        Vision::new(self.lens.clone(), settings).look(picture, &footprint_from_optical, self.body.as_ref())
    }

    pub fn locate(&self, seen: &Seen, field: &Field, seed: u64) -> Located {
        let alpha = default_alpha(Formula::Corrected);
        let observation = Observation::new(field, LINE_POINTS, Formula::Corrected, alpha, SimdPath::Auto);
        let candidates = match self.initial {
            None => global::search(&observation, &seen.table, field, SEARCH_MARGIN_M, true, KEPT),
            Some(initial) => vec![around(&observation, seen, initial, seed)],
        };
        let found = candidates.iter().map(|candidate| {
            let Support { share, weight, .. } = observation.support(seen.lines(), &candidate.pose);
            Found { pose: candidate.pose, share, weight, log_likelihood: candidate.log_likelihood }
        });
        Located { found: found.filter(|found| found.weight > 0.0).collect() }
    }
}

fn around(observation: &Observation, seen: &Seen, initial: Pose2, seed: u64) -> Candidate {
    let settings = FilterSettings {
        particles: INITIAL_PARTICLES,
        iterations: INITIAL_ITERATIONS,
        motion: MotionModel::default(),
        jitter: Spread { xy_m: 0.05, yaw_rad: 0.03 },
        jitter_shrink: 0.7,
        seed,
    };
    let mut filter = Filter::new(settings, observation.clone(), FilterState::default());
    filter.restart(initial, INITIAL);
    let best = filter.step(Some(Pose2::default()), 0.0, &seen.table).best;
    let start = Candidate { pose: best, log_likelihood: observation.log_likelihood(&seen.table, &best) };
    global::climb(observation, &seen.table, start)
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
