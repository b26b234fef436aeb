//! Foxglove's messages in protobuf, field by field (foxglove/foxglove-sdk, schemas/proto/foxglove). Fields that nothing here
//! needs are left out; a decoder skips them.

use prost::Message;
use prost::bytes::Bytes;

/// `google.protobuf.Timestamp`: time since 1970.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Timestamp {
    /// Seconds, rounded down.
    #[prost(int64, tag = "1")]
    pub seconds: i64,
    /// Nanoseconds on top of them.
    #[prost(int32, tag = "2")]
    pub nanos: i32,
}

/// `foxglove.Vector3`: a vector whose unit depends on the message around it.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Vector3 {
    #[prost(double, tag = "1")]
    pub x: f64,
    #[prost(double, tag = "2")]
    pub y: f64,
    #[prost(double, tag = "3")]
    pub z: f64,
}

/// `foxglove.Quaternion`: a rotation.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Quaternion {
    #[prost(double, tag = "1")]
    pub x: f64,
    #[prost(double, tag = "2")]
    pub y: f64,
    #[prost(double, tag = "3")]
    pub z: f64,
    #[prost(double, tag = "4")]
    pub w: f64,
}

/// `foxglove.Pose`: position in metres, and attitude.
#[derive(Clone, Copy, PartialEq, Message)]
pub struct Pose {
    #[prost(message, optional, tag = "1")]
    pub position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    pub orientation: Option<Quaternion>,
}

/// `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, Message)]
pub struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(bytes = "bytes", tag = "2")]
    pub data: Bytes,
    #[prost(string, tag = "3")]
    pub format: String,
    #[prost(string, tag = "4")]
    pub frame_id: String,
}

/// `foxglove.RawImage`. Numbers of 16 bits are little-endian.
#[derive(Clone, PartialEq, Message)]
pub struct RawImage {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    pub width: u32,
    #[prost(fixed32, tag = "3")]
    pub height: u32,
    #[prost(string, tag = "4")]
    pub encoding: String,
    #[prost(fixed32, tag = "5")]
    pub step: u32,
    #[prost(bytes = "bytes", tag = "6")]
    pub data: Bytes,
    #[prost(string, tag = "7")]
    pub frame_id: String,
}

/// `foxglove.CameraCalibration`: the fields of `sensor_msgs/CameraInfo` but binning and region of interest.
#[derive(Clone, PartialEq, Message)]
pub struct CameraCalibration {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(fixed32, tag = "2")]
    pub width: u32,
    #[prost(fixed32, tag = "3")]
    pub height: u32,
    #[prost(string, tag = "4")]
    pub distortion_model: String,
    #[prost(double, repeated, tag = "5")]
    pub d: Vec<f64>,
    #[prost(double, repeated, tag = "6")]
    pub k: Vec<f64>,
    #[prost(double, repeated, tag = "7")]
    pub r: Vec<f64>,
    #[prost(double, repeated, tag = "8")]
    pub p: Vec<f64>,
    #[prost(string, tag = "9")]
    pub frame_id: String,
}

/// `foxglove.FrameTransform`: turns coordinates of the child into those of the parent.
#[derive(Clone, PartialEq, Message)]
pub struct FrameTransform {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    pub rotation: Option<Quaternion>,
}

/// `foxglove.FrameTransforms`.
#[derive(Clone, PartialEq, Message)]
pub struct FrameTransforms {
    #[prost(message, repeated, tag = "1")]
    pub transforms: Vec<FrameTransform>,
}

/// `foxglove.PoseInFrame`.
#[derive(Clone, PartialEq, Message)]
pub struct PoseInFrame {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub frame_id: String,
    #[prost(message, optional, tag = "3")]
    pub pose: Option<Pose>,
}

/// `foxglove.Odometry`. Velocities are those of `body_frame_id`; covariances are 6 x 6, row by row, or empty.
#[derive(Clone, PartialEq, Message)]
pub struct Odometry {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub frame_id: String,
    #[prost(string, tag = "3")]
    pub body_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub pose: Option<Pose>,
    #[prost(message, optional, tag = "5")]
    pub linear_velocity: Option<Vector3>,
    #[prost(message, optional, tag = "6")]
    pub angular_velocity: Option<Vector3>,
    #[prost(double, repeated, tag = "7")]
    pub pose_covariance: Vec<f64>,
    #[prost(double, repeated, tag = "8")]
    pub velocity_covariance: Vec<f64>,
}

/// `foxglove.JointState`: one joint.
#[derive(Clone, PartialEq, Message)]
pub struct JointState {
    #[prost(string, tag = "1")]
    pub name: String,
    #[prost(double, optional, tag = "2")]
    pub position: Option<f64>,
}

/// `foxglove.JointStates`.
#[derive(Clone, PartialEq, Message)]
pub struct JointStates {
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    #[prost(message, repeated, tag = "2")]
    pub joints: Vec<JointState>,
}
