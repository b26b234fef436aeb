//! Judging: tags against the truth and against earlier ones, suites with limits, what accuracy costs, the paper's experiments, and pictures of
//! them.

pub mod capture;
pub mod compare;
pub mod cost;
pub mod drawing;
pub mod effect_cost;
pub mod paper;
pub mod reference;
pub mod statistics;
pub mod suite;
pub mod truth;

pub use compare::{Comparison, Tagged, compare, mirrored};
pub use statistics::Summary;
