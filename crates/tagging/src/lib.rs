//! The agent: what comes from the sensors goes through the filter into the capture.

mod budget;
pub mod checkpoint;
pub mod cut;
pub mod dead_reckoning;
mod diagnosis;
pub mod durations;
pub mod error;
pub mod explanation;
mod filter_stats;
pub mod frame_cache;
pub mod input_source;
pub mod inter_session;
pub mod log_scan;
pub mod offline_refinement;
mod perception_pool;
pub mod pipeline;
pub mod replay;
mod report;
mod run_stats;
pub mod setup;
pub mod single_image;
pub mod tagger;
pub mod warm_start;
pub mod warnings;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use error::{AgentError, ReplayError};
pub use frame_cache::{Claims, FrameCache, FrameCacheOptions, Trial};
pub use replay::{ReplayOptions, replay};
pub use report::ReplayReport;
pub use setup::SetupError;
pub use tagger::Tagger;
