//! How good views are: rendered truth, real pairs of images, and the numbers.

mod detector;
mod experiment;
mod pairs;
mod truth_renderer;

pub use detector::{Detection, Detector};
pub use experiment::{Displacement, Plan, Row, Scores, displacements};
pub use pairs::{Pair, PairError, pairs};
pub use truth_renderer::TruthRenderer;
