//! The paper's experiments on rendered scenes: Fig. 9, Table 2, Fig. 10.
//!
//! [`reproduce`] runs them; [`charts`] draws them. What the paper reports stands in [`PAPER_GAUSS`] and its siblings.

pub mod charts;
mod experiment;
mod method;
mod scenes;

pub use experiment::{Paper, PaperError, Plan, Progress, Run, reproduce};
pub use method::{METHODS, Method};

/// What the paper reports for 800 particles: mean error in cm, seconds a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reported {
    pub error_cm: f64,
    pub seconds: f64,
}

/// Table 2.
pub const PAPER_PARTICLES: usize = 800;
pub const PAPER_GAUSS: Reported = Reported { error_cm: 18.1, seconds: 0.85 };
pub const PAPER_DISTANCE: Reported = Reported { error_cm: 18.5, seconds: 1.76 };
/// Fig. 10.
pub const PAPER_WALK_CM: f64 = 18.51;
