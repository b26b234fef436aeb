//! What topics, frames and joints are called.

use serde::{Deserialize, Serialize};

/// Where each measurement comes from, and where tags go.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Topics {
    /// `sensor_msgs/CompressedImage` or `sensor_msgs/Image`.
    pub image: String,
    pub camera_info: String,
    pub imu: String,
    pub odometry: String,
    pub joints: String,
    pub tf: String,
    pub tf_static: String,
    pub initial_pose: String,
    /// For judging only: never an input.
    pub ground_truth: String,
}

/// REP 105 names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameNames {
    pub map: String,
    pub odom: String,
    pub base_footprint: String,
    pub base_link: String,
    pub camera_link: String,
    /// If the transforms do not know it: the `frame_id` of the images.
    pub camera_optical: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HeadSettings {
    pub pan_joint: String,
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
