//! The program from end to end: logs in, captures out, as a user runs it.

mod capture;
mod determinism;
mod packing;
mod pictures;
mod power_loss;
mod segments;
mod support;
mod topics;
mod truth;
mod warm_start;
