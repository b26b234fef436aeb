//! Captures frames of a live camera with the kernel's stamps, and goes on after unplugging, stalls and errors.
//!
//! [`Capture`] has the rules. It talks to the kernel through a [`Driver`], so that tests can produce each error code.

mod capture;
#[cfg(feature = "v4l2")]
mod device;
mod driver;
mod jpeg;
mod message;
#[cfg(feature = "v4l2")]
mod output;
mod republish;
mod socket;
#[cfg(test)]
mod tests;

use std::sync::Arc;

pub use capture::{Capture, CaptureEvent, CaptureRules, Drop, Frame, StampClock};
#[cfg(feature = "v4l2")]
pub use device::V4l2;
pub use driver::{BufferInfo, CameraError, CameraOptions, Driver, Negotiated, PixelFormat};
pub use jpeg::is_whole;
pub use message::{ImageMessage, image_message};
#[cfg(feature = "v4l2")]
pub use output::OutputDevice;
pub use republish::{Republished, Republishing, Sink};
pub use socket::{SCHEME, SocketCamera};

/// Returns the driver of a device: a V4L2 node, or `unix:PATH` for frames from another process.
///
/// `republish` names a V4L2 device that every frame is passed on to, and the report that counts these frames.
pub fn driver_of(device: &str, republish: Option<(&str, Arc<Republished>)>) -> Result<Box<dyn Driver>, CameraError> {
    let camera = camera_of(device)?;
    match republish {
        None => Ok(camera),
        #[cfg(feature = "v4l2")]
        Some((to, report)) => Ok(Box::new(Republishing::new(camera, OutputDevice::new(to), report))),
        #[cfg(not(feature = "v4l2"))]
        Some((to, _)) => Err(CameraError::NotBuilt { device: to.to_owned() }),
    }
}

/// Returns the driver of a device, without passing frames on.
fn camera_of(device: &str) -> Result<Box<dyn Driver>, CameraError> {
    if device.starts_with(SCHEME) {
        return Ok(Box::new(SocketCamera::default()));
    }
    #[cfg(feature = "v4l2")]
    return Ok(Box::new(V4l2::default()));
    #[cfg(not(feature = "v4l2"))]
    Err(CameraError::NotBuilt { device: device.to_owned() })
}
