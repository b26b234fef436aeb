//! The paper's experiments repeated on rendered scenes: Fig. 9, Table 2 and Fig. 10.
//!
//! [`reproduce`] runs them, and [`charts`](mod@charts) draws them. Results of the paper are constants such as
//! [`PAPER_GAUSS`].

pub mod charts;
mod experiment;
mod method;
mod scenes;

pub use experiment::{Paper, PaperError, Plan, Progress, Run, reproduce};
pub use method::{METHODS, Method};

/// Result that the paper reports for 800 particles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reported {
    /// Mean position error, centimetres.
    pub error_cm: f64,
    /// Time for a frame, seconds.
    pub seconds: f64,
}

/// Number of particles in Table 2 of the paper.
pub const PAPER_PARTICLES: usize = 800;
/// Result of the Gauss observation model in Table 2 of the paper.
pub const PAPER_GAUSS: Reported = Reported { error_cm: 18.1, seconds: 0.85 };
/// Result of the distance observation model in Table 2 of the paper.
pub const PAPER_DISTANCE: Reported = Reported { error_cm: 18.5, seconds: 1.76 };
/// Mean position error of the walk in Fig. 10 of the paper, centimetres.
pub const PAPER_WALK_CM: f64 = 18.51;
