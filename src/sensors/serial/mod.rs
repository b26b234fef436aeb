//! Odometry, attitude and head from microcontrollers on serial lines.

mod latency;
mod line;
mod port;

pub use line::{Line, LineStatus, Measured, Pose};
pub use port::{PortEvent, PortOptions, SerialError, run};
