//! Tests of the crate from outside, room by room.

mod architecture;
mod config;
mod dev;
mod documents;
mod features;
mod fuzz;
mod hardware;
mod limits;
mod live;
mod numerics;
mod real;
mod recording;
mod replay;
mod ros2;
mod scene;
mod serial;
mod service;
mod stress;
mod sync;
mod systemd;
mod views;
