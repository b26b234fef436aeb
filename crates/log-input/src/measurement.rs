//! What each message of a log means to the agent, by topic and type.

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
    Frame {
        stamp_ns: i64,
        frame_id: String,
    },
    CameraInfo(Box<CameraInfo>),
    /// `map`-independent pose of `base_footprint` as the robot counts its steps.
    Odometry {
        stamp_ns: i64,
        odom_from_footprint: Pose2,
    },
    /// `orientation` of `frame_id` against gravity, if the sensor measures it.
    Imu {
        stamp_ns: i64,
        frame_id: String,
        orientation: Option<DQuat>,
        /// Radians per second about the axes of `frame_id`, if the sensor measures it.
        turn_rate: Option<DVec3>,
    },
    Joints {
        stamp_ns: i64,
        pan: Option<f64>,
        tilt: Option<f64>,
    },
    Transforms {
        latched: bool,
        transforms: Vec<StampedTransform>,
    },
    InitialPose {
        stamp_ns: i64,
        map_from_footprint: Pose2,
        deviations: StatedDeviations,
    },
    /// No robot can have measured it: a number in it is not finite, or out of all range. Recorded, and counted.
    Impossible,
    /// Recorded, but nothing to the filter.
    Other,
}

/// What a message says of its own pose's standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StatedDeviations {
    None,
    /// Along the longer of x and y, and of the heading.
    Of {
        xy_m: f64,
        yaw_rad: f64,
    },
    /// The numbers are no covariance: not finite, negative, not positive semi-definite, or wider than any field.
    Impossible,
}

#[derive(Clone, Debug, PartialEq)]
pub struct StampedTransform {
    pub stamp_ns: i64,
    pub parent: String,
    pub child: String,
    pub parent_from_child: Isometry,
}

/// Whether a message is a camera's image: another type on the same topic is none.
pub fn is_frame(channel: &Channel, topics: &Topics) -> bool {
    channel.topic == topics.image && [CompressedImage::TYPE, Image::TYPE].contains(&channel.type_name.as_str())
}

/// Reads one message. An error means that its bytes are not what its type says; a frame is one as long as it says when
/// it was exposed.
pub fn read(message: &LogMessage, topics: &Topics, head: &HeadSettings) -> Result<Measurement, CdrError> {
    let topic = message.channel.topic.as_str();
    let data = message.data.as_slice();
    // One topic may carry several types, of which one is meant. A log that names no types is believed.
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
                parent: plain(t.header.frame_id),
                child: plain(t.child_frame_id),
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
            deviations: StatedDeviations::of(&initial.pose.covariance),
        });
    }
    if is(&topics.camera_info, CameraInfo::TYPE) {
        return Ok(Measurement::CameraInfo(Box::new(CameraInfo::decode(data)?)));
    }
    Ok(Measurement::Other)
}

fn frame_header(type_name: &str, data: &[u8]) -> Result<Header, CdrError> {
    let header = if type_name == Image::TYPE {
        ImageView::decode(data).map(|image| image.header)
    } else {
        CompressedImageView::decode(data).map(|image| image.header)
    };
    header.or_else(|error| stamp_of_torn(data).map(|stamp| Header { stamp, ..Header::default() }).ok_or(error))
}

/// The stamp is the first thing in a frame, and often whole where the rest is not.
fn stamp_of_torn(data: &[u8]) -> Option<Stamp> {
    let stamp = Stamp::read(&mut CdrReader::new(data).ok()?).ok()?;
    // What is zero was never written.
    (stamp.nanosec < 1_000_000_000 && stamp != Stamp::default()).then_some(stamp)
}

/// Wider than any field: a standard deviation of 100 m, and of 100 rad.
const MOST_VARIANCE: f64 = 1e4;
/// By so much the square of a covariance may exceed the product of its variances: rounding.
const ROUNDING: f64 = 1e-6;

impl StatedDeviations {
    /// Of the covariance of a ROS pose: x, y, z, and rotations about them, row by row. All zeros state nothing.
    fn of(covariance: &[f64; 36]) -> Self {
        let [xx, xy, yx, yy, yaw] = [0, 1, 6, 7, 35].map(|index| settled(covariance[index]));
        let variances = [xx, yy, yaw];
        let is_covariance = variances.iter().all(|variance| (0.0..=MOST_VARIANCE).contains(variance))
            && [xy, yx].iter().all(|both| both * both <= xx * yy * (1.0 + ROUNDING));
        if !is_covariance {
            Self::Impossible
        } else if variances == [0.0; 3] {
            Self::None
        } else {
            Self::Of { xy_m: libm::sqrt(xx.max(yy)), yaw_rad: libm::sqrt(yaw) }
        }
    }
}

/// ROS 1 names start with a slash; ROS 2's do not.
fn plain(frame: String) -> String {
    frame.strip_prefix('/').map(str::to_owned).unwrap_or(frame)
}
