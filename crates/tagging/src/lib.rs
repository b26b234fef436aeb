//! The agent: what comes from the sensors goes through the filter into the capture.

pub mod between;
mod budget;
pub mod checkpoint;
pub mod cut;
mod diagnosis;
pub mod durations;
mod effort;
pub mod error;
pub mod explaining;
pub mod footage;
pub mod foresight;
pub mod opened;
pub mod pipeline;
pub mod prelude;
pub mod refining;
pub mod replay;
mod report;
pub mod setup;
pub mod single;
mod stages;
pub mod state;
pub mod tagger;
mod tally;
pub mod warnings;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use error::{AgentError, ReplayError};
pub use footage::{Attempt, Claims, Footage, FootageOptions};
pub use replay::{ReplayOptions, replay};
pub use report::ReplayReport;
pub use setup::SetupError;
pub use tagger::Tagger;
