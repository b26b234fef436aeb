//! Judging: tags against the truth, and pictures of both.

pub mod capture;
pub mod compare;
pub mod drawing;
pub mod statistics;

pub use compare::{Comparison, Tagged, compare, mirrored};
pub use statistics::Summary;
