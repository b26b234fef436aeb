//! A live camera: frames with the kernel's stamps, through unplugging, stalls and errors.
//!
//! [`Capture`] holds the rules; what it asks of the kernel is a [`Driver`], so that each error code can be had in a test.

mod capture;
#[cfg(feature = "v4l2")]
mod device;
mod driver;
mod jpeg;
mod message;
mod socket;
#[cfg(test)]
mod tests;

pub use capture::{Capture, CaptureEvent, CaptureRules, Drop, Frame, StampClock};
#[cfg(feature = "v4l2")]
pub use device::V4l2;
pub use driver::{BufferInfo, CameraError, CameraOptions, Driver, Negotiated, PixelFormat};
pub use jpeg::is_whole;
pub use message::{EncodeError, ImageMessage, image_message};
pub use socket::{SCHEME, SocketCamera};

/// What speaks to this device: a V4L2 node, or `unix:PATH` for frames from another process.
pub fn driver_of(device: &str) -> Result<Box<dyn Driver>, CameraError> {
    if device.starts_with(SCHEME) {
        return Ok(Box::new(SocketCamera::default()));
    }
    #[cfg(feature = "v4l2")]
    return Ok(Box::new(V4l2::default()));
    #[cfg(not(feature = "v4l2"))]
    Err(CameraError::NotBuilt { device: device.to_owned() })
}
