//! The agent: what comes from the sensors goes through the filter into the capture.

pub mod checkpoint;
mod error;
pub mod footage;
mod pipeline;
mod prelude;
pub mod replay;
mod report;
mod setup;
pub mod single;
mod stages;
mod state;
pub mod tagger;
mod tally;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use error::AgentError;
pub use footage::{Attempt, Footage, FootageOptions};
pub use replay::{ReplayError, ReplayOptions, replay};
pub use report::ReplayReport;
pub use setup::SetupError;
pub use tagger::Tagger;
