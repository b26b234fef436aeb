//! `[topics]`, `[frames]` and `[head]`: names of topics, coordinate frames and joints.

use serde::{Deserialize, Serialize};

/// Topics from which measurements are read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Topics {
    /// Images: `sensor_msgs/CompressedImage` or `sensor_msgs/Image`.
    pub image: String,
    /// Calibration of the camera: `sensor_msgs/CameraInfo`; not needed with `camera.lens`.
    pub camera_info: String,
    /// Attitude against gravity: `sensor_msgs/Imu` or `booster_interface/LowState`.
    pub imu: String,
    /// Odometry of `base_footprint`: `nav_msgs/Odometry`, `booster_interface/Odometer`, or a stamped pose or twist of
    /// `geometry_msgs`.
    pub odometry: String,
    /// Angles of the head's joints: `sensor_msgs/JointState` or `booster_interface/LowState`.
    pub joints: String,
    /// Transforms that change: `tf2_msgs/TFMessage`.
    pub tf: String,
    /// Transforms that do not change: `tf2_msgs/TFMessage`.
    pub tf_static: String,
    /// Announced poses of `base_footprint` in `map`: `geometry_msgs/PoseWithCovarianceStamped`.
    pub initial_pose: String,
    /// True poses of `camera_link`, for evaluation only: never an input, and never copied into a capture.
    pub ground_truth: String,
}

/// Names of the coordinate frames; the defaults are those of REP 105.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameNames {
    /// The field: origin at its centre, x towards one goal, z up.
    pub map: String,
    /// The frame in which odometry counts.
    pub odom: String,
    /// The point on the ground below the robot.
    pub base_footprint: String,
    /// The torso, to which roll and pitch of the IMU apply.
    pub base_link: String,
    /// The camera with x forward, y left, z up. Tags are poses of this frame.
    pub camera_link: String,
    /// The camera with z forward, x right, y down. If no transform knows it, the `frame_id` of the images is taken.
    pub camera_optical: String,
}

/// Names of the head's joints in `sensor_msgs/JointState`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HeadSettings {
    /// Joint that turns the head about the z axis of the torso.
    pub pan_joint: String,
    /// Joint that then tilts the head about the y axis of the camera; positive looks down.
    pub tilt_joint: String,
}

impl Default for Topics {
    fn default() -> Self {
        Self {
            image: "/camera/image/compressed".into(),
            camera_info: "/camera/camera_info".into(),
            imu: "/imu/data".into(),
            odometry: "/odom".into(),
            joints: "/joint_states".into(),
            tf: "/tf".into(),
            tf_static: "/tf_static".into(),
            initial_pose: "/initialpose".into(),
            ground_truth: "/ground_truth/camera_pose".into(),
        }
    }
}

impl Default for FrameNames {
    fn default() -> Self {
        Self {
            map: "map".into(),
            odom: "odom".into(),
            base_footprint: "base_footprint".into(),
            base_link: "base_link".into(),
            camera_link: "camera_link".into(),
            camera_optical: "camera_optical_frame".into(),
        }
    }
}

impl Default for HeadSettings {
    fn default() -> Self {
        Self { pan_joint: "head_pan".into(), tilt_joint: "head_tilt".into() }
    }
}
