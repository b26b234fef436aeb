//! What a checkpoint stores of the synchroniser: transforms, and the recent past of each measurement.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::LOG_TIME_SIGMA_S;
use crate::attitude_filter::{AttitudeFilter, MADE_TILT_SIGMA_RAD};
use crate::history::History;
use crate::planar_velocity::VelocityIntegrator;
use crate::transforms::{Head, TransformTree};
use realitysim_geometry::{Physical, Pose2};

/// The part of a [`Synchroniser`](super::Synchroniser) that a checkpoint stores: transforms, and the recent past of each measurement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SynchroniserState {
    pub(super) tree: TransformTree,
    pub(super) odometry: History<Pose2>,
    pub(super) odometry_in_tf: History<Pose2>,
    pub(super) attitude: History<DQuat>,
    /// Turn rate of the torso about the vertical, radians per second.
    pub(super) turn_rate: History<f64>,
    /// Magnitude of the torso's turn rate about horizontal axes, radians per second.
    pub(super) sway_rate: History<f64>,
    /// Turn rate of the torso about its own axes, radians per second.
    pub(super) torso_rate: History<DVec3>,
    /// Makes an attitude of raw rates and accelerations, as long as no sensor has stated one.
    pub(super) attitude_filter: AttitudeFilter,
    /// Whether a sensor has stated its attitude.
    pub(super) attitude_is_stated: bool,
    /// Adds velocities up to odometry.
    pub(super) velocity: VelocityIntegrator,
    /// Whether odometry has no stamps, and the log's times stand for them.
    pub(super) odometry_by_log_time: bool,
    /// The same of attitude and turn rates.
    pub(super) attitude_by_log_time: bool,
    /// The last frame that was popped.
    pub(super) last_frame: Option<StepOrigin>,
    pub(super) pan: History<f64>,
    pub(super) tilt: History<f64>,
    pub(super) initial_pose: Option<InitialPose>,
    /// Where the step to the next frame begins, if not at the last one.
    pub(super) anchor: Option<OdometryOrigin>,
}

/// The odometry at a time of which there is no frame: when a pose was announced, or when odometry was first heard.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OdometryOrigin {
    /// That time, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of `base_footprint` in `odom` at that time, metres and radians.
    pub odometry: Pose2,
    /// Log time of the message that set it, nanoseconds.
    pub(super) log_time_ns: i64,
    /// Number of times that odometry has begun anew since then.
    pub(super) begun: u32,
}

impl OdometryOrigin {
    pub(super) fn new(stamp_ns: i64, odometry: Pose2, log_time_ns: i64) -> Self {
        Self { stamp_ns, odometry, log_time_ns, begun: 0 }
    }
}

/// The time from which the robot's step to the next frame counts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepOrigin {
    /// Exposure of the last frame, or the later announcement of a pose, or the first odometry; nanoseconds.
    pub stamp_ns: i64,
    /// Log time of that message, nanoseconds.
    pub log_time_ns: i64,
    /// Time between the last frame and the one before, nanoseconds; 0 if not known.
    pub interval_ns: i64,
    /// Number of times that odometry has begun anew since then.
    pub(super) begun: u32,
}

/// An announced pose with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct InitialPose {
    /// Pose of `base_footprint` in `map`, metres and radians.
    pub map_from_footprint: Pose2,
    /// Standard deviation of the position, metres, if it was stated.
    pub xy_m: Option<f64>,
    /// Standard deviation of the heading, radians, if it was stated.
    pub yaw_rad: Option<f64>,
}

impl Physical for InitialPose {
    fn is_possible(&self) -> bool {
        self.map_from_footprint.is_possible() && self.xy_m.is_possible() && self.yaw_rad.is_possible()
    }
}

impl Physical for SynchroniserState {
    fn is_possible(&self) -> bool {
        let Self { tree, odometry, odometry_in_tf, attitude, turn_rate, sway_rate, torso_rate, pan, tilt, .. } = self;
        tree.is_possible()
            && self.attitude_filter.is_possible()
            && self.velocity.is_possible()
            && [odometry, odometry_in_tf].iter().all(|history| history.is_possible())
            && [turn_rate, sway_rate, pan, tilt].iter().all(|history| history.is_possible())
            && (attitude.is_possible() && torso_rate.is_possible())
            && self.initial_pose.is_possible()
            && self.anchor.is_none_or(|anchor| anchor.odometry.is_possible())
    }
}

impl SynchroniserState {
    /// Returns the angles of the head, if at least one joint is known.
    pub(super) fn head(&self, stamp_ns: i64) -> Option<Head> {
        let [pan, tilt] = [&self.pan, &self.tilt].map(|joint| joint.at(stamp_ns).map(|sample| sample.value));
        (pan.is_some() || tilt.is_some()).then(|| Head { pan: pan.unwrap_or(0.0), tilt: tilt.unwrap_or(0.0) })
    }

    /// Returns whether odometry or turn rates have no stamps of their own.
    pub(super) fn is_by_log_time(&self) -> bool {
        let odometry = self.odometry_by_log_time && !self.odometry.is_empty();
        odometry || (self.attitude_by_log_time && !self.turn_rate.is_empty())
    }

    /// Returns the standard deviation that an attitude has because it was made here, or because its time is not known well.
    pub(super) fn tilt_sigma_rad(&self, stamp_ns: i64) -> f64 {
        let made = if self.attitude_is_stated { 0.0 } else { MADE_TILT_SIGMA_RAD };
        let sways = self.sway_rate.at(stamp_ns).filter(|_| self.attitude_by_log_time);
        libm::hypot(made, sways.map_or(0.0, |rate| LOG_TIME_SIGMA_S * rate.value))
    }

    /// Returns the announced pose that no frame has been given out with yet.
    pub fn pending(&self) -> Option<InitialPose> {
        self.initial_pose
    }

    /// Returns the odometry of its topic, or that of `/tf` where there is none.
    pub(super) fn odometry(&self) -> &History<Pose2> {
        if self.odometry.is_empty() { &self.odometry_in_tf } else { &self.odometry }
    }
}
