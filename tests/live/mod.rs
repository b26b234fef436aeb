//! The agent as on a robot: a simulated walk comes in real time over a socket (frames) and a serial line (MAVLink).

mod calibration;
mod delay;
mod doctor;
mod load;
mod no_frames;
mod orders;
mod play;
mod ports;
mod recorder;
mod robot;
mod sender;
mod walks;
mod watch;
