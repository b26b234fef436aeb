//! The rest of sensor_msgs: camera calibration, inertial sensors, joints.

use serde::Serialize;

use super::geometry::{Quaternion, Vector3};
use super::message;
use super::time::Header;
use crate::cdr::wire_struct;

wire_struct! {
    /// sensor_msgs/RegionOfInterest, in pixels of the full image; all zero means all of it.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct RegionOfInterest {
        pub x_offset: u32,
        pub y_offset: u32,
        pub height: u32,
        pub width: u32,
        pub do_rectify: bool,
    }
}

wire_struct! {
    /// sensor_msgs/CameraInfo.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct CameraInfo {
        /// `frame_id` is the optical frame (z forward, x right, y down).
        pub header: Header,
        /// Rows of the full image, before binning and region of interest.
        pub height: u32,
        /// Columns of the full image.
        pub width: u32,
        /// `plumb_bob`, `rational_polynomial` or `equidistant` (the fisheye k1..k4).
        pub distortion_model: String,
        pub d: Vec<f64>,
        /// Intrinsics, row by row, pixels of the full image.
        pub k: [f64; 9],
        /// Rectification, row by row.
        pub r: [f64; 9],
        /// Projection of the rectified image, 3 x 4, row by row.
        pub p: [f64; 12],
        /// 0 and 1 both mean no binning.
        pub binning_x: u32,
        pub binning_y: u32,
        pub roi: RegionOfInterest,
    }
}

wire_struct! {
    /// sensor_msgs/Imu, in `header.frame_id`. A covariance that starts with -1 says that the value is not measured.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct Imu {
        pub header: Header,
        /// Of the frame in a fixed one whose z points up.
        pub orientation: Quaternion,
        /// Row by row, radians squared.
        pub orientation_covariance: [f64; 9],
        /// Radians per second.
        pub angular_velocity: Vector3,
        pub angular_velocity_covariance: [f64; 9],
        /// Metres per second squared, gravity included: at rest it points up.
        pub linear_acceleration: Vector3,
        pub linear_acceleration_covariance: [f64; 9],
    }
}

wire_struct! {
    /// sensor_msgs/JointState. Each of the arrays is as long as `name`, or empty.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct JointState {
        pub header: Header,
        pub name: Vec<String>,
        /// Radians.
        pub position: Vec<f64>,
        /// Radians per second.
        pub velocity: Vec<f64>,
        /// Newton metres.
        pub effort: Vec<f64>,
    }
}

message!(CameraInfo is "sensor_msgs" / "CameraInfo",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "sensor_msgs/RegionOfInterest");
message!(Imu is "sensor_msgs" / "Imu",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Quaternion",
    needs "geometry_msgs/Vector3");
message!(JointState is "sensor_msgs" / "JointState", needs "std_msgs/Header", needs "builtin_interfaces/Time");
