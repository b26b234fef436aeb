//! Reads odometry, attitude and head angles from microcontrollers on serial lines.
//!
//! [`run`] opens a port and keeps it open; [`Line`] turns its bytes into measurements.

mod latency;
mod line;
mod port;
mod port_health;

pub use line::{Line, LineStatus, Measured, Pose, SenderClock};
pub use port::{PortEvent, PortOptions, SerialError, run};
pub use port_health::Trouble;
