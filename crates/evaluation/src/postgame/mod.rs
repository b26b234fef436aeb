//! A robot's own pose after a game: where it was wrong, since when and after what, and what its odometry is worth.
//!
//! The measure are the tags, which are right to centimetres where they are valid. Poses are those of `base_footprint` in the plane.

mod episodes;
mod odometry;

use serde::Serialize;

use crate::compare::truth_at;
use realitysim_geometry::{Isometry, Pose2, wrap_angle};

pub use episodes::{Cause, Episode};
pub use odometry::{DirectionFit, Motion, OdometryFit};

/// One frame of a game.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GameFrame {
    /// Time of the exposure, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of `base_footprint` in `map` by the tag; `None` if it is not valid.
    pub tagged: Option<Pose2>,
    /// Pose of `base_footprint` in `odom`, if there is odometry.
    pub odometry: Option<Pose2>,
    /// Angle between the torso's axis and the vertical, radians, if it is measured.
    pub lean_rad: Option<f64>,
    /// Pose of `base_footprint` in `map` that the robot believed; `None` if it sent none near the time.
    pub own: Option<Pose2>,
}

impl GameFrame {
    /// Distance (metres) and turn (radians) between the robot's own pose and the tag.
    pub fn error(&self) -> Option<(f64, f64)> {
        let (own, tagged) = (self.own?, self.tagged?);
        Some((distance_m(own, tagged), wrap_angle(own.yaw - tagged.yaw).abs()))
    }
}

/// What is found in a game.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Postgame {
    /// Number of frames.
    pub frames: usize,
    /// Number of frames with a valid tag and an own pose, which are judged.
    pub judged: usize,
    /// Median distance of the own pose, metres.
    pub median_m: f64,
    /// The distance that 95 % of the own poses keep, metres.
    pub p95_m: f64,
    /// Median turn of the own pose, degrees.
    pub median_yaw_deg: f64,
    /// Time in which the own pose was wrong, seconds.
    pub wrong_s: f64,
    /// Share of the judged time in which it was wrong.
    pub wrong_share: f64,
    /// The times in which it was wrong.
    pub episodes: Vec<Episode>,
    /// What the odometry is worth.
    pub odometry: OdometryFit,
}

/// An own pose that is farther off, in metres, is wrong.
pub const WRONG_M: f64 = 0.3;
/// An own pose that is turned by more, in radians, is wrong.
pub const WRONG_RAD: f64 = 15.0 * core::f64::consts::PI / 180.0;

impl Postgame {
    /// Judges a game, whose frames are in order of time.
    pub fn of(frames: &[GameFrame]) -> Self {
        let mut errors: Vec<(f64, f64)> = frames.iter().filter_map(GameFrame::error).collect();
        let judged = errors.len();
        let mut share = |which: fn(&(f64, f64)) -> f64, part: f64| {
            errors.sort_by(|a, b| which(a).total_cmp(&which(b)));
            errors.get(((judged as f64 * part) as usize).min(judged.saturating_sub(1))).map_or(0.0, which)
        };
        let (median_m, p95_m) = (share(|error| error.0, 0.5), share(|error| error.0, 0.95));
        let median_yaw_deg = share(|error| error.1, 0.5).to_degrees();
        let episodes = episodes::episodes(frames);
        let wrong_s = episodes.iter().map(|episode| episode.until_s - episode.from_s).sum();
        let judged_s = judged_seconds(frames);
        Self {
            frames: frames.len(),
            judged,
            median_m,
            p95_m,
            median_yaw_deg,
            wrong_s,
            wrong_share: if judged_s > 0.0 { (wrong_s / judged_s).min(1.0) } else { 0.0 },
            episodes,
            odometry: OdometryFit::of(frames),
        }
    }
}

/// The robot's own pose at a time, between those that it sent before and after it. `own` is in order of time.
pub fn own_at(own: &[(i64, Isometry)], stamp_ns: i64) -> Option<Pose2> {
    truth_at(own, stamp_ns).map(|pose| Pose2::from_isometry(&pose))
}

/// Longest time between two frames that counts as looked at, seconds.
const COUNTED_STEP_S: f64 = 0.5;

/// Time between judged frames, seconds.
fn judged_seconds(frames: &[GameFrame]) -> f64 {
    let judged: Vec<i64> = frames.iter().filter(|frame| frame.error().is_some()).map(|frame| frame.stamp_ns).collect();
    judged.windows(2).map(|pair| ((pair[1] - pair[0]) as f64 * 1e-9).min(COUNTED_STEP_S)).sum()
}

/// Distance between two poses, metres.
pub(crate) fn distance_m(a: Pose2, b: Pose2) -> f64 {
    libm::hypot(a.x - b.x, a.y - b.y)
}
