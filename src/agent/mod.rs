//! The agent: what comes from the sensors goes through the filter into the capture.

pub mod checkpoint;
pub mod replay;
mod report;
mod setup;
pub mod single;
mod stages;
pub mod tagger;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use replay::{ReplayError, ReplayOptions, replay};
pub use report::ReplayReport;
pub use setup::SetupError;
pub use tagger::Tagger;
