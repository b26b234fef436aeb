//! Odometry, attitude and head from microcontrollers on serial lines.

mod line;
mod port;

pub use line::{Line, LineStatus, Measured};
pub use port::{PortEvent, PortOptions, SerialError, run};
