//! Tests of the crate from outside, room by room.

mod config;
mod dev;
mod limits;
mod real;
mod replay;
mod ros2;
mod scene;
mod serial;
