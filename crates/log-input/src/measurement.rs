//! Decodes a message of a log into a measurement, by its topic and type.

use glam::{DQuat, DVec3};

use realitysim_config::{HeadSettings, Topics};
use realitysim_geometry::physical::settled;
use realitysim_geometry::{Isometry, Physical, Pose2};
use realitysim_ros2::cdr::{CdrError, CdrReader, Wire};
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{
    CameraInfo, CompressedImage, CompressedImageView, Header, Image, ImageView, Imu, JointState, Message, Odometry,
    PoseWithCovarianceStamped, Stamp, TFMessage,
};

/// A measurement, or a frame whose pixels stay in the message.
#[derive(Clone, Debug, PartialEq)]
pub enum Measurement {
    /// An image of the camera, compressed or raw.
    Frame {
        /// Time of the exposure, nanoseconds.
        stamp_ns: i64,
        /// Coordinate frame of the camera, as the message names it.
        frame_id: String,
    },
    /// The calibration of the camera's lens.
    CameraInfo(Box<CameraInfo>),
    /// Pose of `base_footprint` as the robot counts its steps; it knows nothing of `map`.
    Odometry {
        /// Time of the measurement, nanoseconds.
        stamp_ns: i64,
        /// Position in metres and heading in radians, in the coordinate frame `odom`.
        odom_from_footprint: Pose2,
    },
    /// A sample of the inertial measurement unit.
    Imu {
        /// Time of the measurement, nanoseconds.
        stamp_ns: i64,
        /// Coordinate frame of the sensor.
        frame_id: String,
        /// Orientation of `frame_id` against gravity, if the sensor measures it.
        orientation: Option<DQuat>,
        /// Radians per second about the axes of `frame_id`, if the sensor measures it.
        turn_rate: Option<DVec3>,
    },
    /// Angles of the head's joints.
    Joints {
        /// Time of the measurement, nanoseconds.
        stamp_ns: i64,
        /// Angle of the pan joint, radians, if the message has it.
        pan: Option<f64>,
        /// Angle of the tilt joint, radians, if the message has it.
        tilt: Option<f64>,
    },
    /// Transforms of `/tf` or `/tf_static`.
    Transforms {
        /// Whether they came on `/tf_static` and hold for good.
        latched: bool,
        /// The transforms, in the order of the message.
        transforms: Vec<StampedTransform>,
    },
    /// A pose that somebody announces.
    InitialPose {
        /// Time of the header, nanoseconds.
        stamp_ns: i64,
        /// Position in metres and heading in radians, in the coordinate frame `map`.
        map_from_footprint: Pose2,
        /// Standard deviations that the message states for the pose.
        deviations: StatedDeviations,
    },
    /// A measurement that no robot can have made: a number in it is not finite, or out of all range. It is recorded and counted.
    Impossible,
    /// A message that is recorded, and that the filter does not use.
    Other,
}

/// The standard deviations that a message states for the pose in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StatedDeviations {
    /// The message states none: its variances are zero.
    None,
    /// The message states these.
    Of {
        /// Of the position, metres: the larger of those of x and y.
        xy_m: f64,
        /// Of the heading, radians.
        yaw_rad: f64,
    },
    /// The numbers are no covariance: not finite, negative, not positive semi-definite, or wider than any field.
    Impossible,
}

/// One transform of `/tf` or `/tf_static`.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedTransform {
    /// Time at which it holds, nanoseconds.
    pub stamp_ns: i64,
    /// Name of the parent coordinate frame, without a leading slash.
    pub parent: String,
    /// Name of the child coordinate frame, without a leading slash.
    pub child: String,
    /// Turns coordinates of `child` into those of `parent`, metres.
    pub parent_from_child: Isometry,
}

/// Returns whether messages of a channel are images of the camera: its topic is the camera's and its type is that of an image.
pub fn is_frame(channel: &Channel, topics: &Topics) -> bool {
    channel.topic == topics.image && [CompressedImage::TYPE, Image::TYPE].contains(&channel.type_name.as_str())
}

/// Decodes one message. `head` names the head's joints.
///
/// An error means that the bytes of the message are not what its type says. A damaged image still is a frame as long as
/// its stamp can be read.
pub fn read(message: &LogMessage, topics: &Topics, head: &HeadSettings) -> Result<Measurement, CdrError> {
    let topic = message.channel.topic.as_str();
    let data = message.data.as_slice();
    // A topic may carry several types; only the expected one is read. Where a log names no types, the topic decides.
    let is = |wanted: &str, kind: &str| {
        topic == wanted && (message.channel.type_name == kind || message.channel.type_name.is_empty())
    };
    if is_frame(&message.channel, topics) {
        let header = frame_header(&message.channel.type_name, data)?;
        return Ok(Measurement::Frame { stamp_ns: header.stamp.to_nanoseconds(), frame_id: header.frame_id });
    }
    if is(&topics.odometry, Odometry::TYPE) {
        let odometry = Odometry::decode(data)?;
        let odom_from_footprint = Isometry::from(odometry.pose.pose);
        if !odom_from_footprint.is_possible() {
            return Ok(Measurement::Impossible);
        }
        let odom_from_footprint = Pose2::from_isometry(&odom_from_footprint);
        return Ok(Measurement::Odometry { stamp_ns: odometry.header.stamp.to_nanoseconds(), odom_from_footprint });
    }
    if is(&topics.imu, Imu::TYPE) {
        let imu = Imu::decode(data)?;
        // A quaternion of zeros is how drivers that know no attitude leave the field.
        let measured = imu.orientation_covariance[0] != -1.0;
        let orientation = measured.then(|| DQuat::from(imu.orientation)).filter(|q| q.length_squared() != 0.0);
        return Ok(Measurement::Imu {
            stamp_ns: imu.header.stamp.to_nanoseconds(),
            frame_id: imu.header.frame_id,
            orientation,
            turn_rate: (imu.angular_velocity_covariance[0] != -1.0).then(|| DVec3::from(imu.angular_velocity)),
        });
    }
    if is(&topics.joints, JointState::TYPE) {
        let joints = JointState::decode(data)?;
        let angle = |name: &str| {
            let index = joints.name.iter().position(|joint| joint == name)?;
            joints.position.get(index).copied().map(settled)
        };
        let (pan, tilt) = (angle(&head.pan_joint), angle(&head.tilt_joint));
        return Ok(Measurement::Joints { stamp_ns: joints.header.stamp.to_nanoseconds(), pan, tilt });
    }
    if is(&topics.tf, TFMessage::TYPE) || is(&topics.tf_static, TFMessage::TYPE) {
        let transforms = TFMessage::decode(data)?.transforms;
        let transforms = transforms
            .into_iter()
            .map(|t| StampedTransform {
                stamp_ns: t.header.stamp.to_nanoseconds(),
                parent: strip_slash(t.header.frame_id),
                child: strip_slash(t.child_frame_id),
                parent_from_child: t.transform.into(),
            })
            .collect();
        return Ok(Measurement::Transforms { latched: topic == topics.tf_static, transforms });
    }
    if is(&topics.initial_pose, PoseWithCovarianceStamped::TYPE) {
        let initial = PoseWithCovarianceStamped::decode(data)?;
        let pose = initial.pose.pose;
        let map_from_footprint = Isometry::from(pose);
        if !map_from_footprint.is_possible() {
            return Ok(Measurement::Impossible);
        }
        return Ok(Measurement::InitialPose {
            stamp_ns: initial.header.stamp.to_nanoseconds(),
            map_from_footprint: Pose2::from_isometry(&map_from_footprint),
            deviations: StatedDeviations::from_covariance(&initial.pose.covariance),
        });
    }
    if is(&topics.camera_info, CameraInfo::TYPE) {
        return Ok(Measurement::CameraInfo(Box::new(CameraInfo::decode(data)?)));
    }
    Ok(Measurement::Other)
}

/// Returns the header of an image message; of a damaged one only the stamp.
fn frame_header(type_name: &str, data: &[u8]) -> Result<Header, CdrError> {
    let header = if type_name == Image::TYPE {
        ImageView::decode(data).map(|image| image.header)
    } else {
        CompressedImageView::decode(data).map(|image| image.header)
    };
    header.or_else(|error| stamp_of_torn(data).map(|stamp| Header { stamp, ..Header::default() }).ok_or(error))
}

/// Returns the stamp of an image message that is damaged further back: the stamp comes first and is often whole.
fn stamp_of_torn(data: &[u8]) -> Option<Stamp> {
    let stamp = Stamp::read(&mut CdrReader::new(data).ok()?).ok()?;
    // A stamp of zero was never written.
    (stamp.nanosec < 1_000_000_000 && stamp != Stamp::default()).then_some(stamp)
}

/// Largest variance that is believed, m² or rad²: a standard deviation of 100 m or 100 rad is wider than any field.
const MAX_VARIANCE: f64 = 1e4;
/// Share by which the square of a covariance may exceed the product of its variances because of rounding.
const ROUNDING_SHARE: f64 = 1e-6;

impl StatedDeviations {
    /// Takes the standard deviations from the covariance of a ROS pose: 6 x 6, row by row, of x, y, z and the rotations
    /// about them. Variances of zero state nothing.
    fn from_covariance(covariance: &[f64; 36]) -> Self {
        let [xx, xy, yx, yy, yaw] = [0, 1, 6, 7, 35].map(|index| settled(covariance[index]));
        let variances = [xx, yy, yaw];
        let is_covariance = variances.iter().all(|variance| (0.0..=MAX_VARIANCE).contains(variance))
            && [xy, yx].iter().all(|both| both * both <= xx * yy * (1.0 + ROUNDING_SHARE));
        if !is_covariance {
            Self::Impossible
        } else if variances == [0.0; 3] {
            Self::None
        } else {
            Self::Of { xy_m: libm::sqrt(xx.max(yy)), yaw_rad: libm::sqrt(yaw) }
        }
    }
}

/// Removes the slash that names of coordinate frames begin with in ROS 1, and not in ROS 2.
fn strip_slash(frame: String) -> String {
    frame.strip_prefix('/').map(str::to_owned).unwrap_or(frame)
}
