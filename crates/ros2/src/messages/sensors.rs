//! Messages of `sensor_msgs` beside images: camera calibration, inertial sensors, joints.

use serde::Serialize;

use super::geometry::{Quaternion, Vector3};
use super::message;
use super::time::Header;
use crate::cdr::wire_struct;

wire_struct! {
    /// `sensor_msgs/RegionOfInterest`: a part of an image, in pixels of the full image. All zero means the whole image.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
    pub struct RegionOfInterest {
        /// Leftmost column, pixels.
        pub x_offset: u32,
        /// Uppermost row, pixels.
        pub y_offset: u32,
        /// Height, pixels.
        pub height: u32,
        /// Width, pixels.
        pub width: u32,
        /// Whether a rectified image is to be cut as well.
        pub do_rectify: bool,
    }
}

wire_struct! {
    /// `sensor_msgs/CameraInfo`: the calibration of a camera.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct CameraInfo {
        /// Time of the image; `frame_id` is the optical frame (z forward, x right, y down).
        pub header: Header,
        /// Height of the full image, before binning and region of interest, pixels.
        pub height: u32,
        /// Width of the full image, pixels.
        pub width: u32,
        /// Distortion model: `plumb_bob`, `rational_polynomial` or `equidistant` (the fisheye k1..k4).
        pub distortion_model: String,
        /// Coefficients of the distortion model.
        pub d: Vec<f64>,
        /// Intrinsic matrix, 3 x 3, row by row, pixels of the full image.
        pub k: [f64; 9],
        /// Rectification matrix, 3 x 3, row by row.
        pub r: [f64; 9],
        /// Projection matrix of the rectified image, 3 x 4, row by row.
        pub p: [f64; 12],
        /// Pixels that are combined along a row; 0 and 1 both mean no binning.
        pub binning_x: u32,
        /// Pixels that are combined along a column; 0 and 1 both mean no binning.
        pub binning_y: u32,
        /// Part of the full image that is sent.
        pub roi: RegionOfInterest,
    }
}

wire_struct! {
    /// `sensor_msgs/Imu`: a measurement of an IMU, in `header.frame_id`. A covariance that starts with -1 marks a value as not
    /// measured.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct Imu {
        /// Time of the measurement; `frame_id` is the frame of the IMU.
        pub header: Header,
        /// Attitude of the IMU in a fixed frame whose z axis points up.
        pub orientation: Quaternion,
        /// Covariance of the attitude, 3 x 3, row by row, radians squared.
        pub orientation_covariance: [f64; 9],
        /// Angular velocity, radians per second.
        pub angular_velocity: Vector3,
        /// Covariance of the angular velocity, 3 x 3, row by row.
        pub angular_velocity_covariance: [f64; 9],
        /// Acceleration with gravity, metres per second squared: at rest it points up.
        pub linear_acceleration: Vector3,
        /// Covariance of the acceleration, 3 x 3, row by row.
        pub linear_acceleration_covariance: [f64; 9],
    }
}

wire_struct! {
    /// `sensor_msgs/JointState`: the state of joints. Each array is as long as `name`, or empty.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct JointState {
        /// Time of the measurement.
        pub header: Header,
        /// Names of the joints.
        pub name: Vec<String>,
        /// Angles, radians.
        pub position: Vec<f64>,
        /// Angular velocities, radians per second.
        pub velocity: Vec<f64>,
        /// Torques, newton metres.
        pub effort: Vec<f64>,
    }
}

message!(CameraInfo is "sensor_msgs" / "CameraInfo",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "sensor_msgs/RegionOfInterest");
message!(Imu is "sensor_msgs" / "Imu",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Quaternion",
    needs "geometry_msgs/Vector3");
message!(JointState is "sensor_msgs" / "JointState", needs "std_msgs/Header", needs "builtin_interfaces/Time");
