//! A live camera: frames with the kernel's stamps, through unplugging, stalls and errors.
//!
//! [`Capture`] holds the rules; what it asks of the kernel is a [`Driver`], so that each error code can be had in a test.

mod capture;
#[cfg(feature = "v4l2")]
mod device;
mod driver;
mod jpeg;
mod message;
#[cfg(test)]
mod tests;

pub use capture::{Capture, CaptureEvent, CaptureRules, Drop, Frame, StampClock};
#[cfg(feature = "v4l2")]
pub use device::V4l2;
pub use driver::{BufferInfo, CameraError, CameraOptions, Driver, Negotiated, PixelFormat};
pub use jpeg::is_whole;
pub use message::{ImageMessage, image_message};
