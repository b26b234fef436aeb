//! Tests of the crate from outside, room by room.

mod config;
mod real;
mod ros2;
mod scene;
