//! The robot's state at the exposure of a frame: odometry, attitude, the camera's place and motion.

use glam::DVec3;

use super::{InitialPose, OdometryOrigin, Synchroniser};
use crate::camera_twist::{RateSources, camera_twist};
use crate::history::{History, Sample};
use crate::transforms::{CameraPlace, ChainError, Head, Posture};
use realitysim_geometry::{Pose2, Twist};

/// What is known of the robot at one time, mostly the exposure of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RobotState {
    /// Pose of `base_footprint` in `odom`, metres and radians, if there is any odometry.
    pub odometry: Option<Pose2>,
    /// Stamp of the newest odometry that was used, nanoseconds; it does not depend on how much more had arrived.
    pub odometry_until_ns: Option<i64>,
    /// Pose of the camera above `base_footprint`, or why the transforms do not give it.
    pub place: Result<CameraPlace, ChainError>,
    /// Angles of the head, if its joints are known.
    pub head: Option<Head>,
    /// Turn about the vertical since the frame before, radians, if a gyro measured it.
    pub turned_rad: Option<f64>,
    /// Angle by which the torso has rolled and pitched since then, both ways added up, radians, if a gyro measured it.
    pub swayed_rad: Option<f64>,
    /// Velocity of `camera_optical_frame` along its own axes, by gyro, odometry and joints, if they are known.
    pub camera_twist: Option<Twist>,
    /// Whether a gyro measured how the camera turns; otherwise `camera_twist` has the turn of the feet by odometry.
    pub turn_is_measured: bool,
    /// Whether the odometry, an attitude, a joint angle or a transform that was used is older than [`STALE_NS`].
    pub stale: bool,
    /// Standard deviation of the times of odometry and gyro, seconds: [`LOG_TIME_SIGMA_S`] where the log's time stands for a stamp,
    /// else 0.
    pub stamp_sigma_s: f64,
    /// Standard deviation of the torso's roll and pitch, radians, that comes of an attitude made of raw rates or stamped by log time.
    pub tilt_sigma_rad: f64,
    /// The pose that was announced since the last frame.
    pub initial_pose: Option<InitialPose>,
    /// Where the robot's step begins, if not at the frame before.
    pub anchor: Option<OdometryOrigin>,
}

/// Age beyond which a measurement does not describe a walking robot any more, nanoseconds.
pub const STALE_NS: i64 = 250_000_000;
/// Distance in time beyond which an attitude is not used, nanoseconds; the torso is taken to stand upright.
pub const GONE_NS: i64 = 2_000_000_000;
/// Standard deviation of the time of a measurement that has no stamp, seconds.
///
/// A message is logged up to a period of the camera after its measurement, since programs pass it on once a cycle: 33 ms at 30
/// hertz, and an even distribution over it has a standard deviation of a twelfth's root, 10 ms.
pub const LOG_TIME_SIGMA_S: f64 = 0.01;
/// Age beyond which a gyro sample does not say how fast the camera turns, nanoseconds.
const GYRO_AGE_NS: i64 = 30_000_000;
/// Distance in time beyond which a joint angle does not say where the neck was, nanoseconds.
const NECK_AGE_NS: i64 = 5_000_000;
/// Time between the two poses that the speed of the neck is computed from, nanoseconds.
const NECK_STEP_NS: i64 = 40_000_000;
/// Time between the two poses that the speed of the feet is computed from, nanoseconds.
const FEET_STEP_NS: i64 = 100_000_000;

impl Synchroniser {
    /// Returns the state of the robot for a next frame that is exposed at `stamp_ns`.
    pub fn robot_next(&self, stamp_ns: i64) -> RobotState {
        let Self { state, .. } = self;
        let since_ns = self.since().map(|since| since.stamp_ns);
        RobotState { initial_pose: state.initial_pose, anchor: state.anchor, ..self.robot(since_ns, stamp_ns) }
    }

    /// Returns the state of the robot at `stamp_ns` where there is no frame at `since_ns` either; turns count from then.
    pub fn robot_between(&self, since_ns: i64, stamp_ns: i64) -> RobotState {
        self.robot(Some(since_ns), stamp_ns)
    }

    /// Returns the state of the robot at `stamp_ns`, with turns since `since_ns`, and without announced pose and anchor.
    fn robot(&self, since_ns: Option<i64>, stamp_ns: i64) -> RobotState {
        let state = &self.state;
        let odometry = state.odometry();
        let attitude = state.attitude.at(stamp_ns).filter(|sample| sample.age_ns <= GONE_NS);
        let head = state.head(stamp_ns);
        let posture = Posture { attitude: attitude.map(|sample| sample.value), head };
        let place = state.tree.camera_place(stamp_ns, &self.names, posture);
        let torso_rate = self.torso_rate(stamp_ns);
        let camera_twist = place.as_ref().ok().and_then(|place| self.camera_twist(stamp_ns, place, torso_rate));
        // After a gap in velocities nothing says how far the robot has walked.
        let is_unknown = since_ns.is_some_and(|since_ns| state.velocity.has_gap_between(since_ns, stamp_ns));
        let step = odometry.at(stamp_ns).filter(|_| !is_unknown);
        let ages = [
            step.map(|s| s.age_ns),
            attitude.map(|s| s.age_ns),
            state.pan.at(stamp_ns).map(|s| s.age_ns),
            state.tilt.at(stamp_ns).map(|s| s.age_ns),
            place.as_ref().ok().map(|place| place.age_ns),
        ];
        RobotState {
            odometry: step.map(|sample| sample.value),
            odometry_until_ns: odometry.until(stamp_ns),
            place,
            head,
            turned_rad: since_ns.and_then(|since_ns| state.turn_rate.integral(since_ns, stamp_ns)),
            swayed_rad: since_ns.and_then(|since_ns| state.sway_rate.integral(since_ns, stamp_ns)),
            camera_twist,
            turn_is_measured: torso_rate.is_some() && camera_twist.is_some(),
            stale: ages.into_iter().flatten().any(|age| age > STALE_NS),
            stamp_sigma_s: if state.is_by_log_time() { LOG_TIME_SIGMA_S } else { 0.0 },
            tilt_sigma_rad: if attitude.is_some() { state.tilt_sigma_rad(stamp_ns) } else { 0.0 },
            initial_pose: None,
            anchor: None,
        }
    }

    /// Returns the torso's turn rate about its own axes by gyro, radians per second; `None` if that is old or exactly zero.
    fn torso_rate(&self, stamp_ns: i64) -> Option<DVec3> {
        let measured = |rate: &Sample<DVec3>| rate.age_ns <= GYRO_AGE_NS && rate.value != DVec3::ZERO;
        Some(self.state.torso_rate.at(stamp_ns).filter(measured)?.value)
    }

    /// Returns how the camera moves. Without a gyro the torso is taken to turn with the feet.
    ///
    /// `None` if the robot has neck joints whose angles are not known, or if the velocity is impossible.
    fn camera_twist(&self, stamp_ns: i64, now: &CameraPlace, torso_rate: Option<DVec3>) -> Option<Twist> {
        let state = &self.state;
        let (neck_ns, feet_ns) = (stamp_ns.saturating_sub(NECK_STEP_NS), stamp_ns.saturating_sub(FEET_STEP_NS));
        let is_heard = |joint: &History<f64>, at_ns: i64| {
            joint.is_empty() || joint.at(at_ns).is_some_and(|angle| angle.age_ns <= NECK_AGE_NS)
        };
        if ![neck_ns, stamp_ns].iter().all(|at_ns| is_heard(&state.pan, *at_ns) && is_heard(&state.tilt, *at_ns)) {
            return None;
        }
        let posture = Posture { attitude: None, head: state.head(neck_ns) };
        let neck = state.tree.camera_place(neck_ns, &self.names, posture).ok()?.base_from_optical;
        let odometry = |stamp_ns| state.odometry().at(stamp_ns).map(|sample| sample.value);
        let feet = odometry(feet_ns).zip(odometry(stamp_ns)).map(|(then, now)| then.inverse().compose(&now));
        let seconds = |step_ns: i64| step_ns as f64 * 1e-9;
        let (feet, feet_s) = (feet.unwrap_or_default(), seconds(FEET_STEP_NS));
        let sources = RateSources {
            torso_rate: torso_rate.unwrap_or(DVec3::Z * (feet.yaw / feet_s)),
            neck: (neck, seconds(NECK_STEP_NS)),
            feet: (feet, feet_s),
        };
        camera_twist(now, &sources)
    }

    /// Returns whether all measurements are known up to `stamp_ns`.
    pub(super) fn is_known_until(&self, stamp_ns: i64) -> bool {
        let state = &self.state;
        let reaches = |settled: Option<i64>| settled.is_none_or(|settled| settled >= stamp_ns);
        // Odometry that has never been heard is waited for as long as the log allows: it may only start late.
        let odometry = state.odometry().settled_ns().is_some_and(|settled| settled >= stamp_ns);
        let unheard = (self.expected.imu && state.attitude.is_empty())
            || (self.expected.joints && state.pan.is_empty() && state.tilt.is_empty());
        odometry
            && !unheard
            && reaches(state.attitude.settled_ns())
            && reaches(state.pan.settled_ns())
            && reaches(state.tilt.settled_ns())
            && state.tree.is_known_until(stamp_ns, &self.names)
    }
}
