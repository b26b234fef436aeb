//! Evaluation of tags and views against the truth.
//!
//! [`compare()`] judges tags against true poses; [`capture`] reads both from logs, [`truth`] takes true poses from a
//! scene. [`suite`] runs many logs and scenes with limits, and [`mod@reference`] holds a replay to the tags of an earlier
//! one bit for bit.
//! [`cost`] measures what accuracy costs in time. [`contrast`] measures how tags degrade as lines fade, [`falsify`]
//! what they do under false assumptions, [`accuracy`] how good they are on one's own field, [`postgame`] judges a robot's own pose by them, [`paper`] repeats the experiments of the paper, [`perception`] says how a detector does and models its errors, and [`views`] scores
//! synthesized images.
//! [`drawing`] makes pictures of the results. This crate prints nothing.
//!
//! ```rust
//! use realitysim_evaluation::{Tagged, compare};
//! use realitysim_geometry::{Euler, Isometry};
//!
//! // Poses of `camera_link` in `map`, 0.1 s apart.
//! let at = |x: f64| Isometry::from_euler(Euler::default(), [x, 0.0, 0.5].into());
//! let truth = [(0, at(0.0)), (100_000_000, at(1.0))];
//! let covariance = [0.01, 0.0, 0.01];
//! let tag = Tagged { stamp_ns: 50_000_000, valid: true, pose: at(0.53), covariance, ambiguous: false };
//! let result = compare(&[tag], &truth);
//! assert_eq!((result.frames, result.judged), (1, 1));
//! assert!((result.position_cm.mean - 3.0).abs() < 1e-6);
//! ```

pub mod accuracy;
pub mod capture;
pub mod compare;
pub mod contrast;
pub mod cost;
pub mod cpu_calibration;
pub mod drawing;
pub mod effect_cost;
pub mod falsify;
pub mod paper;
pub mod perception;
pub mod postgame;
pub mod reference;
pub mod statistics;
pub mod suite;
pub mod truth;
pub mod views;

pub use compare::{Comparison, Tagged, compare, mirrored, up_to_mirror};
pub use statistics::Summary;
