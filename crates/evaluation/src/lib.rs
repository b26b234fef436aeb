//! Judging: tags against the truth and against earlier ones, suites with limits, what accuracy costs, how tags fare as lines fade and under falsehoods, the
//! paper's experiments, made-up views, and pictures of them.

pub mod capture;
pub mod compare;
pub mod contrast;
pub mod cost;
pub mod cpu_yardstick;
pub mod drawing;
pub mod effect_cost;
pub mod falsify;
pub mod paper;
pub mod reference;
pub mod statistics;
pub mod suite;
pub mod truth;
pub mod video;
pub mod views;

pub use compare::{Comparison, Tagged, compare, mirrored, up_to_mirror};
pub use statistics::Summary;
