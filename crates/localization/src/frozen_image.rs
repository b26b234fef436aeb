//! Detects a camera that repeats its last picture, with new stamps, while the robot moves.

use serde::{Deserialize, Serialize};

use super::localizer::{FrameSensors, SWAYS_RAD_PER_S};
use realitysim_geometry::{Physical, Pose2, wrap_angle};

/// Remembers the picture that the camera shows, and how far the robot has moved since it first came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrozenImageDetector {
    /// Hash of the picture.
    fingerprint: Option<u64>,
    /// Time of the previous frame.
    stamp_ns: i64,
    /// Odometry of the previous frame.
    odometry: Option<Pose2>,
    /// Distance walked since the picture first came.
    walked_m: f64,
    /// Turn since the picture first came.
    turned_rad: f64,
    /// Sum of the torso's roll and pitch, to and fro, since the picture first came.
    swayed_rad: f64,
}

impl Physical for FrozenImageDetector {
    fn is_possible(&self) -> bool {
        let moved = [self.walked_m, self.turned_rad, self.swayed_rad];
        self.odometry.is_possible() && moved.iter().all(|moved| moved.is_finite())
    }
}

/// Distance walked that must change the picture: less moves lines by less than the camera's noise changes the picture. Metres.
const MOVED_M: f64 = 0.01;
/// Turn that must change the picture, radians.
const TURNED_RAD: f64 = 0.01;
/// Sway of the torso that must change the picture, radians.
const SWAYED_RAD: f64 = 0.02;
/// Slower turns may be noise and bias of the gyro while the robot stands, radians per second.
const TURNS_RAD_PER_S: f64 = 0.05;
/// A longer step of odometry between two frames is a jump of its origin and not counted, metres.
const JUMP_THRESHOLD_M: f64 = 0.3;

impl FrozenImageDetector {
    /// Takes one frame and returns whether its picture is stale: the same as before although the robot has moved since.
    ///
    /// `fingerprint` is a hash of the picture.
    pub fn detect_freeze(&mut self, moment: &FrameSensors, fingerprint: u64) -> bool {
        let before = core::mem::replace(&mut self.odometry, moment.odometry);
        let seconds =
            moment.stamp_ns.saturating_sub(core::mem::replace(&mut self.stamp_ns, moment.stamp_ns)) as f64 * 1e-9;
        if self.fingerprint != Some(fingerprint) {
            let Self { stamp_ns, odometry, .. } = *self;
            *self = Self { fingerprint: Some(fingerprint), stamp_ns, odometry, ..Self::default() };
            return false;
        }
        let step = before.zip(moment.odometry).map(|(then, now)| (then.distance(&now), wrap_angle(now.yaw - then.yaw)));
        if let Some((walked_m, turned_rad)) = step.filter(|(walked_m, _)| *walked_m <= JUMP_THRESHOLD_M) {
            self.walked_m += walked_m;
            let turned_rad = moment.turned_rad.unwrap_or(turned_rad);
            self.turned_rad += if turned_rad.abs() > TURNS_RAD_PER_S * seconds { turned_rad } else { 0.0 };
        }
        let swayed_rad = moment.swayed_rad.unwrap_or(0.0);
        self.swayed_rad += if swayed_rad > SWAYS_RAD_PER_S * seconds { swayed_rad } else { 0.0 };
        self.walked_m > MOVED_M || self.turned_rad.abs() > TURNED_RAD || self.swayed_rad > SWAYED_RAD
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment(frame: u32, x: f64, turned_rad: f64, swayed_rad: f64) -> FrameSensors {
        FrameSensors {
            stamp_ns: i64::from(frame) * 33_000_000,
            odometry: Some(Pose2::new(x, 0.0, 0.0)),
            turned_rad: Some(turned_rad),
            swayed_rad: Some(swayed_rad),
            camera_twist: None,
            turn_is_measured: true,
            footprint_from_optical: None,
            tilt_is_measured: true,
            lean_rad: None,
            stale: false,
            stamp_sigma_s: 0.0,
            tilt_sigma_rad: 0.0,
        }
    }

    #[test]
    fn a_repeated_picture_is_stale_once_the_robot_has_moved() {
        for (step_m, turned_rad, swayed_rad) in [(0.004, 0.0, 0.0), (0.0, 0.004, 0.0), (0.0, 0.0, 0.008)] {
            let mut frozen = FrozenImageDetector::default();
            let mut judge = |frame: u32, picture| {
                frozen.detect_freeze(&moment(frame, f64::from(frame) * step_m, turned_rad, swayed_rad), picture)
            };
            assert_eq!(
                [judge(0, 1), judge(1, 2), judge(2, 2), judge(3, 2), judge(4, 2)],
                [false, false, false, false, true]
            );
            assert!(!judge(5, 3), "a new one");
        }
    }

    #[test]
    fn a_standing_robot_may_see_the_same_and_an_odometry_jump_is_no_walk() {
        let mut frozen = FrozenImageDetector::default();
        assert!((0..1000).all(|frame| !frozen.detect_freeze(&moment(frame, 0.0, 3e-4, 1e-3), 7)));
        assert!(!frozen.detect_freeze(&moment(1000, 100.0, 0.0, 0.0), 7));
        assert!(!frozen.detect_freeze(&moment(1001, f64::NAN, f64::NAN, 0.0), 7));
    }
}
