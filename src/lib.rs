//! Reality Sim: real camera images for any pose on the field.
//!
//! The rooms, in the order in which data passes; a room may use those above it, not those below
//! (docs/architecture.md has the map).

pub mod geometry;

pub mod config;

pub mod vision;

pub mod views;

pub mod localization;

pub mod smoothing;

pub mod scene;

pub mod ros2;

pub mod sensors;

pub mod recording;

pub mod sync;

pub mod agent;

pub mod evaluation;

pub mod database;

pub mod service;

pub mod cli;

mod plain_file;
mod vectorised;

// What integration tests and unit tests share.
#[cfg(test)]
#[path = "../tests/numerics/exact.rs"]
mod exact;
#[cfg(test)]
#[path = "../tests/numerics/measured.rs"]
mod measured;
