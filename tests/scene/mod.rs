//! Scenes: files, motion, sensor messages and images, from outside.

mod common;
mod faults;
mod filtering;
mod geometry;
mod motion;
mod moved;
mod pictures;
mod properties;
mod ranges;
mod refusals;
mod shelf;
mod stored;
mod told;
mod turf;
mod upon_views;
mod world;
