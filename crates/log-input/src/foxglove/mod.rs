//! Turns messages of Foxglove's schemas in protobuf into the ROS 2 messages that say the same.
//!
//! A robot without ROS often logs MCAP with Foxglove's own schemas. They are converted where a log is read, so that everything
//! behind knows ROS 2 only, and a capture of such a log is a ROS 2 bag.

mod schemas;
#[cfg(test)]
mod tests;

use prost::bytes::Bytes;
use thiserror::Error;

use realitysim_ros2::cdr::MAX_MESSAGE_BYTES;
use realitysim_ros2::mcap_read::Channel;
use realitysim_ros2::messages::{
    CameraInfo, CompressedImage, CompressedImageView, Header, Image, ImageView, JointState, Message, Odometry, Point,
    Pose, PoseStamped, PoseWithCovariance, Quaternion, RegionOfInterest, Stamp, TFMessage, Transform, TransformStamped,
    Twist, TwistWithCovariance, Vector3,
};

/// Largest message without an image, bytes: a transform takes some hundred. Two bytes can state an empty transform, which takes
/// a hundred times as much in memory.
pub const MAX_FOXGLOVE_BYTES: usize = 1 << 20;

/// Why a message of Foxglove's schemas cannot be converted.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FoxgloveError {
    /// The bytes are no protobuf, or not of the type.
    #[error("{type_name}: the message is not what its type says: {reason}")]
    Message {
        /// The type.
        type_name: &'static str,
        /// What the decoder says.
        reason: String,
    },
    /// The message lacks its time.
    #[error(
        "{type_name}: timestamp is missing or not a time: seconds since 1970 and 0 to 999999999 nanoseconds are needed"
    )]
    Timestamp {
        /// The type.
        type_name: &'static str,
    },
    /// A list of numbers has the wrong length.
    #[error("{type_name}: {field} has {found} numbers, where {needed} are needed")]
    Length {
        /// The type.
        type_name: &'static str,
        /// The field.
        field: &'static str,
        /// Number of elements in the message.
        found: usize,
        /// Number of elements that are needed.
        needed: usize,
    },
    /// The message is larger than any of its type.
    #[error("{type_name}: {found} bytes, at most {limit} are read")]
    TooLarge {
        /// The type.
        type_name: &'static str,
        /// Size of the message, bytes.
        found: usize,
        /// Largest size that is read, bytes.
        limit: usize,
    },
}

/// A type of Foxglove's schemas that is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FoxgloveType {
    /// An image as a JPEG or PNG.
    CompressedImage,
    /// An image as raw pixels.
    RawImage,
    /// The calibration of a camera.
    CameraCalibration,
    /// A transform between two coordinate frames.
    FrameTransform,
    /// Several such transforms.
    FrameTransforms,
    /// A pose at a time.
    PoseInFrame,
    /// Pose and velocity as odometry measures them.
    Odometry,
    /// The angles of the joints.
    JointStates,
}

impl FoxgloveType {
    /// Every type that is read.
    pub const ALL: [Self; 8] = [
        Self::CompressedImage,
        Self::RawImage,
        Self::CameraCalibration,
        Self::FrameTransform,
        Self::FrameTransforms,
        Self::PoseInFrame,
        Self::Odometry,
        Self::JointStates,
    ];

    /// Returns the type of a channel's messages if they are of Foxglove's schemas and in protobuf.
    pub fn of(type_name: &str, message_encoding: &str) -> Option<Self> {
        let named = || Self::ALL.into_iter().find(|kind| kind.name() == type_name);
        if message_encoding == "protobuf" { named() } else { None }
    }

    /// Returns the name of the type, as logs have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::CompressedImage => "foxglove.CompressedImage",
            Self::RawImage => "foxglove.RawImage",
            Self::CameraCalibration => "foxglove.CameraCalibration",
            Self::FrameTransform => "foxglove.FrameTransform",
            Self::FrameTransforms => "foxglove.FrameTransforms",
            Self::PoseInFrame => "foxglove.PoseInFrame",
            Self::Odometry => "foxglove.Odometry",
            Self::JointStates => "foxglove.JointStates",
        }
    }

    /// Returns the name of the ROS 2 type that says the same.
    pub fn ros2_name(self) -> &'static str {
        match self {
            Self::CompressedImage => CompressedImage::TYPE,
            Self::RawImage => Image::TYPE,
            Self::CameraCalibration => CameraInfo::TYPE,
            Self::FrameTransform | Self::FrameTransforms => TFMessage::TYPE,
            Self::PoseInFrame => PoseStamped::TYPE,
            Self::Odometry => Odometry::TYPE,
            Self::JointStates => JointState::TYPE,
        }
    }

    /// Returns the channel that a channel of this type becomes: the same topic with the ROS 2 type.
    pub fn ros2_channel(self, channel: &Channel) -> Channel {
        let (id, topic, metadata) = (channel.id, channel.topic.as_str(), channel.metadata.clone());
        match self {
            Self::CompressedImage => Channel::of::<CompressedImage>(id, topic, metadata),
            Self::RawImage => Channel::of::<Image>(id, topic, metadata),
            Self::CameraCalibration => Channel::of::<CameraInfo>(id, topic, metadata),
            Self::FrameTransform | Self::FrameTransforms => Channel::of::<TFMessage>(id, topic, metadata),
            Self::PoseInFrame => Channel::of::<PoseStamped>(id, topic, metadata),
            Self::Odometry => Channel::of::<Odometry>(id, topic, metadata),
            Self::JointStates => Channel::of::<JointState>(id, topic, metadata),
        }
    }

    /// Converts a message in protobuf into the ROS 2 message that says the same, in CDR.
    ///
    /// A part that is left out has protobuf's defaults: zeros, and a quaternion of zeros means no rotation, as in ROS. A message
    /// without a time is refused.
    pub fn to_ros2(self, message: Vec<u8>) -> Result<Vec<u8>, FoxgloveError> {
        let limit = match self {
            Self::CompressedImage | Self::RawImage => MAX_MESSAGE_BYTES,
            _ => MAX_FOXGLOVE_BYTES,
        };
        self.check_size(message.len(), limit)?;
        let message = Bytes::from(message);
        let mut cdr = Vec::new();
        match self {
            Self::CompressedImage => {
                let image: schemas::CompressedImage = self.decode(message)?;
                let header = self.header(image.timestamp, image.frame_id)?;
                CompressedImageView { header, format: &image.format, data: &image.data }.encode_into(&mut cdr);
            }
            Self::RawImage => {
                let image: schemas::RawImage = self.decode(message)?;
                let header = self.header(image.timestamp, image.frame_id)?;
                // Foxglove defines the order of the colours that ROS leaves open.
                let encoding = if image.encoding == "8UC3" { "bgr8" } else { &image.encoding };
                let schemas::RawImage { width, height, step, ref data, .. } = image;
                ImageView { header, height, width, encoding, is_bigendian: 0, step, data }.encode_into(&mut cdr);
            }
            Self::CameraCalibration => self.calibration(self.decode(message)?)?.encode_into(&mut cdr),
            Self::FrameTransform => {
                let transforms = vec![self.transform(self.decode(message)?)?];
                TFMessage { transforms }.encode_into(&mut cdr);
            }
            Self::FrameTransforms => {
                let message: schemas::FrameTransforms = self.decode(message)?;
                let transforms = message.transforms.into_iter().map(|transform| self.transform(transform));
                TFMessage { transforms: transforms.collect::<Result<_, _>>()? }.encode_into(&mut cdr);
            }
            Self::PoseInFrame => {
                let message: schemas::PoseInFrame = self.decode(message)?;
                let header = self.header(message.timestamp, message.frame_id)?;
                PoseStamped { header, pose: pose(message.pose) }.encode_into(&mut cdr);
            }
            Self::Odometry => self.odometry(self.decode(message)?)?.encode_into(&mut cdr),
            Self::JointStates => {
                let message: schemas::JointStates = self.decode(message)?;
                let header = self.header(message.timestamp, String::new())?;
                let measured = |joint: schemas::JointState| Some((joint.name, joint.position?));
                let (name, position) = message.joints.into_iter().filter_map(measured).unzip();
                JointState { header, name, position, velocity: Vec::new(), effort: Vec::new() }.encode_into(&mut cdr);
            }
        }
        self.check_size(cdr.len(), MAX_MESSAGE_BYTES)?;
        Ok(cdr)
    }

    fn check_size(self, found: usize, limit: usize) -> Result<(), FoxgloveError> {
        let type_name = self.name();
        if found > limit { Err(FoxgloveError::TooLarge { type_name, found, limit }) } else { Ok(()) }
    }

    fn decode<M: prost::Message + Default>(self, message: Bytes) -> Result<M, FoxgloveError> {
        M::decode(message).map_err(|error| FoxgloveError::Message { type_name: self.name(), reason: error.to_string() })
    }

    /// Makes a header of time and coordinate frame. A time that ROS cannot express is refused.
    fn header(self, timestamp: Option<schemas::Timestamp>, frame_id: String) -> Result<Header, FoxgloveError> {
        let stamp = timestamp.and_then(|time| {
            let nanosec = u32::try_from(time.nanos).ok().filter(|nanosec| *nanosec < 1_000_000_000)?;
            Some(Stamp { sec: i32::try_from(time.seconds).ok()?, nanosec })
        });
        let stamp = stamp.ok_or(FoxgloveError::Timestamp { type_name: self.name() })?;
        Ok(Header { stamp, frame_id })
    }

    fn calibration(self, message: schemas::CameraCalibration) -> Result<CameraInfo, FoxgloveError> {
        Ok(CameraInfo {
            header: self.header(message.timestamp, message.frame_id)?,
            height: message.height,
            width: message.width,
            distortion_model: message.distortion_model,
            d: message.d,
            k: self.matrix("K", &message.k)?,
            r: self.matrix("R", &message.r)?,
            p: self.matrix("P", &message.p)?,
            binning_x: 0,
            binning_y: 0,
            roi: RegionOfInterest::default(),
        })
    }

    fn transform(self, message: schemas::FrameTransform) -> Result<TransformStamped, FoxgloveError> {
        let transform = Transform { translation: vector(message.translation), rotation: quaternion(message.rotation) };
        let header = self.header(message.timestamp, message.parent_frame_id)?;
        Ok(TransformStamped { header, child_frame_id: message.child_frame_id, transform })
    }

    fn odometry(self, message: schemas::Odometry) -> Result<Odometry, FoxgloveError> {
        let twist = Twist { linear: vector(message.linear_velocity), angular: vector(message.angular_velocity) };
        Ok(Odometry {
            header: self.header(message.timestamp, message.frame_id)?,
            child_frame_id: message.body_frame_id,
            pose: PoseWithCovariance {
                pose: pose(message.pose),
                covariance: self.matrix("pose_covariance", &message.pose_covariance)?,
            },
            twist: TwistWithCovariance {
                twist,
                covariance: self.matrix("velocity_covariance", &message.velocity_covariance)?,
            },
        })
    }

    /// Takes the elements of a matrix, row by row; zeros if the message leaves it out.
    fn matrix<const N: usize>(self, field: &'static str, found: &[f64]) -> Result<[f64; N], FoxgloveError> {
        if found.is_empty() {
            return Ok([0.0; N]);
        }
        let length = |_| FoxgloveError::Length { type_name: self.name(), field, found: found.len(), needed: N };
        found.try_into().map_err(length)
    }
}

fn vector(vector: Option<schemas::Vector3>) -> Vector3 {
    let schemas::Vector3 { x, y, z } = vector.unwrap_or_default();
    Vector3 { x, y, z }
}

fn quaternion(quaternion: Option<schemas::Quaternion>) -> Quaternion {
    let schemas::Quaternion { x, y, z, w } = quaternion.unwrap_or_default();
    Quaternion { x, y, z, w }
}

fn pose(pose: Option<schemas::Pose>) -> Pose {
    let schemas::Pose { position, orientation } = pose.unwrap_or_default();
    let Vector3 { x, y, z } = vector(position);
    Pose { position: Point { x, y, z }, orientation: quaternion(orientation) }
}
