//! The agent: what comes from the sensors goes through the filter into the capture.

mod between;
mod budget;
pub mod checkpoint;
pub mod cut;
mod diagnosis;
pub mod doctor;
mod durations;
mod effort;
mod error;
pub mod explaining;
pub mod footage;
pub mod foresight;
pub mod live;
mod opened;
mod pipeline;
mod prelude;
pub mod refining;
pub mod replay;
mod report;
mod setup;
pub mod single;
mod soak;
mod stages;
pub mod state;
pub mod tagger;
mod tally;
mod warnings;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use error::{AgentError, ReplayError};
pub use footage::{Attempt, Claims, Footage, FootageOptions};
pub use replay::{ReplayOptions, replay};
pub use report::ReplayReport;
pub use setup::SetupError;
pub use soak::{SoakOptions, SoakReport, soak};
pub use tagger::Tagger;
