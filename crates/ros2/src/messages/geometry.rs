//! geometry_msgs, tf2_msgs and nav_msgs.

use serde::{Serialize, Serializer};

use super::message;
use super::time::Header;
use crate::cdr::wire_struct;
use realitysim_geometry::longest_axis;

wire_struct! {
    /// geometry_msgs/Point, metres.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Point {
        pub x: f64,
        pub y: f64,
        pub z: f64,
    }
}

wire_struct! {
    /// geometry_msgs/Vector3.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Vector3 {
        pub x: f64,
        pub y: f64,
        pub z: f64,
    }
}

wire_struct! {
    /// geometry_msgs/Quaternion.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct Quaternion {
        pub x: f64,
        pub y: f64,
        pub z: f64,
        pub w: f64,
    }
}

wire_struct! {
    /// geometry_msgs/Pose.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Pose {
        pub position: Point,
        pub orientation: Quaternion,
    }
}

wire_struct! {
    /// geometry_msgs/PoseStamped: in `header.frame_id`.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct PoseStamped {
        pub header: Header,
        pub pose: Pose,
    }
}

wire_struct! {
    /// geometry_msgs/PoseWithCovariance.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct PoseWithCovariance {
        pub pose: Pose,
        /// Row by row over x, y, z (metres) and rotations about x, y, z (radians), all about fixed axes.
        #[serde(serialize_with = "as_slice")]
        pub covariance: [f64; 36],
    }
}

impl PoseWithCovariance {
    /// Standard deviation of x, y along its longer axis, metres.
    pub fn sigma_xy_m(&self) -> f64 {
        longest_axis(self.covariance[0], self.covariance[1], self.covariance[7])
    }
}

wire_struct! {
    /// geometry_msgs/PoseWithCovarianceStamped: in `header.frame_id`.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct PoseWithCovarianceStamped {
        pub header: Header,
        pub pose: PoseWithCovariance,
    }
}

wire_struct! {
    /// geometry_msgs/Twist.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Twist {
        /// Metres per second.
        pub linear: Vector3,
        /// Radians per second.
        pub angular: Vector3,
    }
}

wire_struct! {
    /// geometry_msgs/TwistWithCovariance.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct TwistWithCovariance {
        pub twist: Twist,
        /// Row by row, ordered as that of [`PoseWithCovariance`].
        #[serde(serialize_with = "as_slice")]
        pub covariance: [f64; 36],
    }
}

wire_struct! {
    /// geometry_msgs/Transform: a point of the child frame, rotated, then translated, is in the parent frame.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Transform {
        /// Metres.
        pub translation: Vector3,
        pub rotation: Quaternion,
    }
}

wire_struct! {
    /// geometry_msgs/TransformStamped: `header.frame_id` from `child_frame_id`.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct TransformStamped {
        pub header: Header,
        pub child_frame_id: String,
        pub transform: Transform,
    }
}

wire_struct! {
    /// tf2_msgs/TFMessage.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct TFMessage {
        pub transforms: Vec<TransformStamped>,
    }
}

wire_struct! {
    /// nav_msgs/Odometry.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct Odometry {
        /// `frame_id` is usually `odom`.
        pub header: Header,
        /// Usually `base_footprint` or `base_link`.
        pub child_frame_id: String,
        /// Of `child_frame_id` in `header.frame_id`.
        pub pose: PoseWithCovariance,
        /// In `child_frame_id`.
        pub twist: TwistWithCovariance,
    }
}

message!(PoseStamped is "geometry_msgs" / "PoseStamped",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Pose",
    needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion");
message!(PoseWithCovarianceStamped is "geometry_msgs" / "PoseWithCovarianceStamped",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/PoseWithCovariance",
    needs "geometry_msgs/Pose", needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion");
message!(TransformStamped is "geometry_msgs" / "TransformStamped",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Transform",
    needs "geometry_msgs/Vector3", needs "geometry_msgs/Quaternion");
message!(TFMessage is "tf2_msgs" / "TFMessage",
    needs "geometry_msgs/TransformStamped", needs "std_msgs/Header", needs "builtin_interfaces/Time",
    needs "geometry_msgs/Transform", needs "geometry_msgs/Vector3", needs "geometry_msgs/Quaternion");
message!(Odometry is "nav_msgs" / "Odometry",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/PoseWithCovariance",
    needs "geometry_msgs/Pose", needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion",
    needs "geometry_msgs/TwistWithCovariance", needs "geometry_msgs/Twist", needs "geometry_msgs/Vector3");

impl Default for Quaternion {
    /// No rotation.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl Default for PoseWithCovariance {
    fn default() -> Self {
        Self { pose: Pose::default(), covariance: [0.0; 36] }
    }
}

impl Default for TwistWithCovariance {
    fn default() -> Self {
        Self { twist: Twist::default(), covariance: [0.0; 36] }
    }
}

/// Serde knows arrays of up to 32 elements only.
fn as_slice<S: Serializer>(values: &[f64; 36], serializer: S) -> Result<S::Ok, S::Error> {
    values.as_slice().serialize(serializer)
}
