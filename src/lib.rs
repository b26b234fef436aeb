//! Reality Sim: real camera images for any pose on the field.
//!
//! The rooms stand in the order in which data passes. A room may use those above it, not those below
//! (docs/architecture.md has the map; the test `no_room_uses_one_below_it` holds it).

pub mod geometry;

pub mod vision;

pub mod views;

pub mod localization;

pub mod smoothing;

pub mod ros2;

pub mod config;

pub mod scene;

pub mod sensors;

pub mod recording;

pub mod sync;

pub mod agent;

pub mod database;

pub mod evaluation;

pub mod service;

pub mod playback;

pub mod cli;

// What integration tests and unit tests share.
#[cfg(test)]
#[path = "../tests/numerics/exact.rs"]
mod exact;
#[cfg(test)]
#[path = "../tests/numerics/measured.rs"]
mod measured;
