//! The agent as on a robot: a simulated walk comes in real time over a socket (frames) and a serial line (MAVLink).

mod calibration;
mod delay;
mod doctor;
mod load;
mod no_frames;
mod odd_recorders;
mod orders;
mod play;
mod ports;
pub mod recorder;
pub mod robot;
mod sender;
mod stand_in;
mod walks;
pub mod watch;
