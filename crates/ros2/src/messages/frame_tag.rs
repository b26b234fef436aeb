//! The message `realitysim_msgs/FrameTag`.

use serde::{Deserialize, Serialize};

use super::geometry::{Pose, PoseWithCovariance};
use super::message;
use super::time::{Header, Stamp};
use crate::cdr::wire_struct;

wire_struct! {
    /// `realitysim_msgs/FrameTag`: the pose of the camera at the exposure of a frame, and what is known about it.
    ///
    /// Read from JSON, what is missing has its default: another version may say less.
    #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
    #[serde(default)]
    pub struct FrameTag {
        /// `stamp` is the time of the exposure, `frame_id` is `map`.
        pub header: Header,
        /// Frame whose pose this is: `camera_link`.
        pub child_frame_id: String,
        /// Number of the frame within the session, from 0.
        pub sequence: u64,
        /// Whether `pose` may be used.
        pub valid: bool,
        /// Reason why the tag is not valid; empty when it is.
        pub reason: String,
        /// Observation model: `gauss` or `distance`.
        pub model: String,
        /// Formula of the weights: `corrected` or `paper`.
        pub formula: String,
        /// Number of particles that were weighed in the last iteration.
        pub particles: u32,
        /// Number of iterations of weighting and resampling.
        pub iterations: u32,
        /// Number of points of the field's lines in view of the best particle.
        pub line_points: u32,
        /// Time from the decoded image to the tag, milliseconds.
        pub elapsed_ms: f64,
        /// Whether the time budget allowed fewer particles or iterations than wanted.
        pub capped: bool,
        /// Number of poses weighed in all iterations and in searching the field.
        pub weighed: u32,
        /// Number of poses that had been weighed when time was up; 0 when not capped.
        pub stopped_at: u32,
        /// Effective sample size of the last iteration: 1 / sum of squared weights, particles.
        pub effective_sample_size: f64,
        /// Logarithm of the mean weight of the last iteration, divided by the number of line points.
        pub evidence: f64,
        /// Standard deviation of the particles around the best along its longer axis, metres.
        pub spread_m: f64,
        /// Standard deviation of the yaw of these particles, radians.
        pub spread_yaw_rad: f64,
        /// Whether the mirror pose explains everything as well: the half of the field is not known.
        pub ambiguous: bool,
        /// Pose of `camera_link` in `map`, turned by half a turn about the centre of the field.
        pub mirror_pose: Pose,
        /// Share of the expected line contrast that was found; 1 is perfect.
        pub residual: f64,
        /// Pose of `camera_link` in `map` by the best particle, as in the paper.
        pub best_particle: Pose,
        /// Whether `pose` was fitted to the lines of this frame by least squares.
        pub refined: bool,
        /// Number of line places that the refined pose expects and nothing hides.
        pub lines_expected: u32,
        /// Number of these line places where a line was found that fits.
        pub lines_fitting: u32,
        /// Root mean square distance of the fitting lines from those of the refined pose, pixels of the reduced image.
        pub lines_rms_px: f64,
        /// Share of the line seen that the field has painted there, 0 to 1; 1 if none is seen.
        pub lines_explained: f64,
        /// Pose of `camera_link` in `map`.
        pub pose: PoseWithCovariance,
        /// Yaw of `pose`, radians: R = Rz(yaw) Ry(pitch) Rx(roll).
        pub yaw: f64,
        /// Pitch of `pose`, radians; above 0 it looks down.
        pub pitch: f64,
        /// Roll of `pose`, radians.
        pub roll: f64,
        /// Stamp of the newest odometry that was used.
        pub odometry_until: Stamp,
        /// Stamp of the exposure by the device itself, nanoseconds; the stamp of the image in a replay.
        pub kernel_stamp_ns: i64,
        /// UTC minus monotonic clock, nanoseconds; 0 in a replay.
        pub utc_offset_ns: i64,
    }
}

message!(FrameTag is "realitysim_msgs" / "FrameTag",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Pose",
    needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion", needs "geometry_msgs/PoseWithCovariance");
