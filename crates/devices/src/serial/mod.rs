//! Odometry, attitude and head from microcontrollers on serial lines.

mod latency;
mod line;
mod port;
mod port_health;

pub use line::{Line, LineStatus, Measured, Pose, SenderClock};
pub use port::{PortEvent, PortOptions, SerialError, run};
pub use port_health::Trouble;
