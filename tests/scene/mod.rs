//! Scenes: files, motion, sensor messages and images, from outside.

mod common;
mod look;
