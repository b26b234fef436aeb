//! Reads the cameras and serial ports of a robot, and finds out when what they send was measured.
//!
//! [`mavlink`] turns the bytes of a serial line into measurements, and [`clock`] the stamps of a device into host time. Both are
//! pure: bytes and times are arguments. [`serial::Line`] joins them; [`serial::run`] runs it on a port. [`camera::Capture`] takes
//! frames from a [`camera::Driver`], which is a Video4Linux device (feature `v4l2`) or a socket. Port and camera are opened again
//! after they went away. [`video_out`] plays pictures back to where those of a camera would come from.
//!
//! ```rust
//! use glam::{DQuat, DVec3};
//! use realitysim_devices::mavlink::{Content, RobotSide};
//! use realitysim_devices::serial::Line;
//!
//! // What a microcontroller sends five seconds after its start ...
//! let mut robot = RobotSide::new(1);
//! let bytes = robot.attitude(5_000_000_000, DQuat::IDENTITY, DVec3::ZERO);
//!
//! // ... and what comes of it at nine seconds of the host's clock.
//! let mut line = Line::new(1, 0);
//! let mut measured = Vec::new();
//! line.push(&bytes, 9_000_000_000, |measurement| measured.push(measurement));
//! assert!(matches!(measured[0].content, Content::Attitude(_)));
//! assert!(measured[0].stamp_ns <= 9_000_000_000);
//! ```

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
