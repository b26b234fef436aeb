//! Scenes: files, motion, sensor messages and images, from outside.

mod common;
mod filtering;
mod geometry;
mod look;
mod motion;
mod properties;
mod refusals;
