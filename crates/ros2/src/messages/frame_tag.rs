//! realitysim_msgs/FrameTag: where the camera was when a frame was exposed.

use serde::Serialize;

use super::geometry::{Pose, PoseWithCovariance};
use super::message;
use super::time::{Header, Stamp};
use crate::cdr::wire_struct;

wire_struct! {
    /// realitysim_msgs/FrameTag.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct FrameTag {
        /// `stamp` is the exposure, `frame_id` is `map`.
        pub header: Header,
        /// `camera_link`.
        pub child_frame_id: String,
        /// Frame number within the session.
        pub sequence: u64,
        /// Whether `pose` may be used.
        pub valid: bool,
        /// Why not; empty when valid.
        pub reason: String,
        /// `gauss` or `distance`.
        pub model: String,
        /// `corrected` or `paper`.
        pub formula: String,
        pub particles: u32,
        pub iterations: u32,
        /// Model points in view of the best particle.
        pub line_points: u32,
        /// Milliseconds from decoded image to tag.
        pub elapsed_ms: f64,
        /// Whether time ran out before the last iteration.
        pub capped: bool,
        pub weighed: u32,
        pub stopped_at: u32,
        pub effective_sample_size: f64,
        /// Log mean weight of the last iteration, per point.
        pub evidence: f64,
        /// Standard deviation of the particles along the axis where it is larger, metres.
        pub spread_m: f64,
        /// Standard deviation of the particles' yaw, radians.
        pub spread_yaw_rad: f64,
        /// Whether the mirror pose explains the frame as well.
        pub ambiguous: bool,
        /// `camera_link` in `map`, turned by half a turn about the field's centre.
        pub mirror_pose: Pose,
        /// Share of the expected line contrast that was found; 1 is perfect.
        pub residual: f64,
        /// `camera_link` in `map`, as in the paper.
        pub best_particle: Pose,
        /// Whether `pose` holds more than the best particle: it was fitted to the lines of this frame.
        pub refined: bool,
        /// Places where the refined pose expects a line and nothing hides it, ...
        pub lines_expected: u32,
        /// ... and where one was found that fits.
        pub lines_fitting: u32,
        /// Root of the mean squared distance between these and the refined pose's lines, pixels.
        pub lines_rms_px: f64,
        pub lines_explained: f64,
        /// `camera_link` in `map`.
        pub pose: PoseWithCovariance,
        /// Of `pose`, radians, R = Rz(yaw) Ry(pitch) Rx(roll).
        pub yaw: f64,
        pub pitch: f64,
        pub roll: f64,
        /// Stamp of the newest odometry that was used.
        pub odometry_until: Stamp,
        /// The device's own stamp of the exposure, nanoseconds.
        pub kernel_stamp_ns: i64,
        /// UTC minus monotonic clock, nanoseconds.
        pub utc_offset_ns: i64,
    }
}

message!(FrameTag is "realitysim_msgs" / "FrameTag",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Pose",
    needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion", needs "geometry_msgs/PoseWithCovariance");
