//! How good views are: rendered truth, real pairs of images, and the numbers.

mod detector;
mod experiment;
mod lawn;
mod pairs;

pub use detector::{Detection, Detector};
pub use experiment::{Displacement, Plan, Row, Scores, displacements};
pub use lawn::Lawn;
pub use pairs::{Pair, PairError, pairs};
