//! Why the pipeline cannot go on.

use std::path::PathBuf;

use thiserror::Error;

use super::checkpoint::CheckpointError;
use crate::recording::RecordingError;

#[derive(Debug, Error)]
pub enum AgentError {
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error("{path}: {source}")]
    Checkpoint { path: PathBuf, source: CheckpointError },
}
