//! Evaluation of synthesized views: against rendered truth ([`displacements`]), against real pairs of images
//! ([`pairs`](fn@pairs)), and with the line detector ([`Detector`]).

mod detector;
mod experiment;
mod pairs;
mod truth_renderer;

pub use detector::{Detection, Detector};
pub use experiment::{Displacement, Plan, Row, Scores, displacements};
pub use pairs::{Pair, PairError, pairs};
pub use truth_renderer::TruthRenderer;
