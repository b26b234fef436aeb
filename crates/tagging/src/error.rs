//! Why the pipeline cannot go on, and why a log or scene cannot go through it.

use std::path::PathBuf;

use thiserror::Error;

use super::checkpoint::CheckpointError;
use super::setup::SetupError;
use realitysim_log_input::log::LogError;
use realitysim_log_input::scene_source::SceneSourceError;
use realitysim_recording::{Loss, RecordingError};

#[derive(Debug, Error)]
pub enum AgentError {
    #[error(transparent)]
    Recording(#[from] RecordingError),
    #[error("{path}: {source}")]
    Checkpoint { path: PathBuf, source: CheckpointError },
}

#[derive(Debug, Error)]
pub enum ReplayError {
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// What the log lacks or says wrongly; what the config says wrongly names its own file.
    #[error("{path}: {source}{}", told(lost))]
    Source { path: PathBuf, source: Box<SetupError>, lost: Vec<Loss> },
    #[error(
        "{captures}: the folder belongs to the capture {session}, to which nothing is added: name another with --output"
    )]
    IntoCapture { captures: PathBuf, session: PathBuf },
    #[error(transparent)]
    Log(#[from] LogError),
    #[error(transparent)]
    Scene(#[from] SceneSourceError),
    #[error(transparent)]
    Agent(#[from] AgentError),
    #[error("{path}: no segment of this capture is left{}", told(lost))]
    NoSegment { path: PathBuf, lost: Vec<Loss> },
    #[error("no frame could be used: {0}")]
    NoFrame(String),
    #[error("{source}; what came before is recorded in {session}")]
    Broken { source: Box<ReplayError>, session: PathBuf },
}

fn told(lost: &[Loss]) -> String {
    match lost {
        [] => String::new(),
        [loss] => format!("; it is not whole, which may be why: {loss}"),
        [first, rest @ ..] => format!("; it is not whole, which may be why: {first}; and {} more", rest.len()),
    }
}
