//! The program from end to end: logs in, captures out, as a user runs it.

mod broken;
mod capture;
mod chains;
mod cost;
mod delays;
mod determinism;
mod export;
mod independent;
mod losses;
mod memory;
mod packing;
mod pictures;
mod places;
mod power_loss;
mod refused;
mod segments;
mod support;
mod tag;
mod topics;
mod truth;
mod usage;
mod warm_start;
