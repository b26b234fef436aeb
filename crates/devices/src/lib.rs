//! Cameras and serial ports of a robot: what they send, and when.
//!
//! [`mavlink`] and [`clock`] are pure; [`camera`] and [`serial`] have a thread each and survive a device that goes away.

pub mod camera;
pub mod clock;
pub mod host_clock;
pub mod mavlink;
pub mod permission;
pub mod serial;
pub mod stale_socket;
#[cfg(feature = "v4l2")]
pub mod v4l2;
pub mod video_out;
