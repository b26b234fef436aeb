//! The ROS 2 messages that logs hold. Names, order and units of fields are those of ROS (REP 103: metres, radians, seconds).

mod booster;
mod conversion;
mod diagnostics;
mod frame_tag;
mod geometry;
mod image;
pub mod schema;
mod sensors;
mod time;
mod visualization;

use super::cdr::{CdrError, CdrReader, CdrWriter, Wire};

pub use booster::{ImuState, LowState, MotorState, Odometer};
pub use diagnostics::{DiagnosticArray, DiagnosticStatus, KeyValue};
pub use frame_tag::FrameTag;
pub use geometry::{
    Odometry, Point, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion, TFMessage,
    Transform, TransformStamped, Twist, TwistStamped, TwistWithCovariance, TwistWithCovarianceStamped, Vector3,
};
pub use image::{CompressedImage, CompressedImageView, Image, ImageView};
pub use sensors::{CameraInfo, Imu, JointState, RegionOfInterest};
pub use time::{Header, Stamp};
pub use visualization::{
    CircleAnnotation, Color, ColorRGBA, Duration, ImageAnnotations, Marker, MarkerArray, MeshFile, Point2,
    PointsAnnotation, TextAnnotation, UVCoordinate,
};

/// A message type that a topic can have.
pub trait Message: Wire {
    /// Name of the type: `package/msg/Name`.
    const TYPE: &'static str;

    /// Definition of the type in the form `ros2msg`, nested types included, so that any reader can decode the log.
    const DEFINITION: &'static str;

    /// Decodes a message, which must take all the bytes but padding.
    fn decode(bytes: &[u8]) -> Result<Self, CdrError> {
        let mut reader = CdrReader::new(bytes)?;
        let message = Self::read(&mut reader)?;
        reader.finish()?;
        Ok(message)
    }

    /// Encodes the message into a buffer, whose content it replaces.
    fn encode_into(&self, buffer: &mut Vec<u8>) {
        self.write(&mut CdrWriter::new(buffer));
    }

    /// Encodes the message into a new buffer.
    fn encode(&self) -> Vec<u8> {
        let mut buffer = Vec::new();
        self.encode_into(&mut buffer);
        buffer
    }
}

/// Implements [`Message`] from the files in `definitions/`.
macro_rules! message {
    ($name:ident is $package:literal / $file:literal $(, needs $nested:literal)* $(,)?) => {
        impl $crate::messages::Message for $name {
            const TYPE: &'static str = concat!($package, "/msg/", $file);
            const DEFINITION: &'static str = concat!(
                include_str!(concat!("definitions/", $package, "/", $file, ".msg")),
                $(
                    "================================================================================\nMSG: ",
                    $nested,
                    "\n",
                    include_str!(concat!("definitions/", $nested, ".msg")),
                )*
            );
        }
    };
}
use message;

#[cfg(test)]
mod tests;
