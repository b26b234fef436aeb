//! Messages of `geometry_msgs`, `tf2_msgs` and `nav_msgs`.

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

use super::message;
use super::time::Header;
use crate::cdr::wire_struct;
use realitysim_geometry::longest_axis;

wire_struct! {
    /// `geometry_msgs/Point`: a position, metres.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
    pub struct Point {
        /// X, metres.
        pub x: f64,
        /// Y, metres.
        pub y: f64,
        /// Z, metres.
        pub z: f64,
    }
}

wire_struct! {
    /// `geometry_msgs/Vector3`: a vector whose unit depends on the message around it.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Vector3 {
        /// Component along x.
        pub x: f64,
        /// Component along y.
        pub y: f64,
        /// Component along z.
        pub z: f64,
    }
}

wire_struct! {
    /// `geometry_msgs/Quaternion`: a rotation, w + x i + y j + z k.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Quaternion {
        /// Coefficient of i.
        pub x: f64,
        /// Coefficient of j.
        pub y: f64,
        /// Coefficient of k.
        pub z: f64,
        /// Real part.
        pub w: f64,
    }
}

wire_struct! {
    /// `geometry_msgs/Pose`: position and attitude.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
    pub struct Pose {
        /// Position, metres.
        pub position: Point,
        /// Attitude.
        pub orientation: Quaternion,
    }
}

wire_struct! {
    /// `geometry_msgs/PoseStamped`: a pose at a time.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct PoseStamped {
        /// Time of the pose, and coordinate frame in which it is given.
        pub header: Header,
        /// The pose.
        pub pose: Pose,
    }
}

wire_struct! {
    /// `geometry_msgs/PoseWithCovariance`: a pose and its uncertainty.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
    pub struct PoseWithCovariance {
        /// The most probable pose.
        pub pose: Pose,
        /// Covariance, 6 x 6, row by row, of x, y, z (metres) and the rotations about the fixed axes x, y, z (radians).
        #[serde(serialize_with = "as_slice", deserialize_with = "from_slice")]
        pub covariance: [f64; 36],
    }
}

impl PoseWithCovariance {
    /// Returns the standard deviation of x, y along its longer axis, metres.
    pub fn sigma_xy_m(&self) -> f64 {
        longest_axis(self.covariance[0], self.covariance[1], self.covariance[7])
    }
}

wire_struct! {
    /// `geometry_msgs/PoseWithCovarianceStamped`: a pose and its uncertainty at a time.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct PoseWithCovarianceStamped {
        /// Time of the pose, and coordinate frame in which it is given.
        pub header: Header,
        /// The pose.
        pub pose: PoseWithCovariance,
    }
}

wire_struct! {
    /// `geometry_msgs/Twist`: a velocity.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Twist {
        /// Linear velocity, metres per second.
        pub linear: Vector3,
        /// Angular velocity, radians per second.
        pub angular: Vector3,
    }
}

wire_struct! {
    /// `geometry_msgs/TwistWithCovariance`: a velocity and its uncertainty.
    #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
    pub struct TwistWithCovariance {
        /// The most probable velocity.
        pub twist: Twist,
        /// Covariance, 6 x 6, row by row, ordered as that of [`PoseWithCovariance`].
        #[serde(serialize_with = "as_slice")]
        pub covariance: [f64; 36],
    }
}

wire_struct! {
    /// `geometry_msgs/TwistStamped`: a velocity at a time, along the axes of `header.frame_id`.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct TwistStamped {
        /// Time of the velocity, and coordinate frame along whose axes it is given.
        pub header: Header,
        /// The velocity.
        pub twist: Twist,
    }
}

wire_struct! {
    /// `geometry_msgs/TwistWithCovarianceStamped`: a velocity and its uncertainty at a time.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct TwistWithCovarianceStamped {
        /// Time of the velocity, and coordinate frame along whose axes it is given.
        pub header: Header,
        /// The velocity.
        pub twist: TwistWithCovariance,
    }
}

wire_struct! {
    /// `geometry_msgs/Transform`: rotates, then translates a point of the child frame to give it in the parent frame.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
    pub struct Transform {
        /// Translation, metres.
        pub translation: Vector3,
        /// Rotation.
        pub rotation: Quaternion,
    }
}

wire_struct! {
    /// `geometry_msgs/TransformStamped`: the transform from `child_frame_id` to `header.frame_id` at a time.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct TransformStamped {
        /// Time of the transform, and parent frame.
        pub header: Header,
        /// Child frame.
        pub child_frame_id: String,
        /// The transform.
        pub transform: Transform,
    }
}

wire_struct! {
    /// `tf2_msgs/TFMessage`: transforms of `/tf` or `/tf_static`.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct TFMessage {
        /// The transforms.
        pub transforms: Vec<TransformStamped>,
    }
}

wire_struct! {
    /// `nav_msgs/Odometry`: pose and velocity as odometry measures them.
    #[derive(Clone, Debug, Default, PartialEq, Serialize)]
    pub struct Odometry {
        /// Time of the measurement; `frame_id` is usually `odom`.
        pub header: Header,
        /// Frame that moves, usually `base_footprint` or `base_link`.
        pub child_frame_id: String,
        /// Pose of `child_frame_id` in `header.frame_id`.
        pub pose: PoseWithCovariance,
        /// Velocity, given in `child_frame_id`.
        pub twist: TwistWithCovariance,
    }
}

message!(PoseStamped is "geometry_msgs" / "PoseStamped",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Pose",
    needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion");
message!(PoseWithCovarianceStamped is "geometry_msgs" / "PoseWithCovarianceStamped",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/PoseWithCovariance",
    needs "geometry_msgs/Pose", needs "geometry_msgs/Point", needs "geometry_msgs/Quaternion");
message!(TwistStamped is "geometry_msgs" / "TwistStamped",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/Twist",
    needs "geometry_msgs/Vector3");
message!(TwistWithCovarianceStamped is "geometry_msgs" / "TwistWithCovarianceStamped",
    needs "std_msgs/Header", needs "builtin_interfaces/Time", needs "geometry_msgs/TwistWithCovariance",
    needs "geometry_msgs/Twist", needs "geometry_msgs/Vector3");
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
    /// Returns the quaternion of no rotation.
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

/// Serializes the array as a slice, because serde implements arrays only up to 32 elements.
fn as_slice<S: Serializer>(values: &[f64; 36], serializer: S) -> Result<S::Ok, S::Error> {
    values.as_slice().serialize(serializer)
}

/// Reads what [`as_slice`] has written.
fn from_slice<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 36], D::Error> {
    let values = Vec::<f64>::deserialize(deserializer)?;
    let length = |values: Vec<f64>| D::Error::invalid_length(values.len(), &"the 36 numbers of a covariance");
    values.try_into().map_err(length)
}
