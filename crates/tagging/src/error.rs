//! Errors of the pipeline and of replays.

use std::path::PathBuf;

use thiserror::Error;

use super::checkpoint::CheckpointError;
use super::setup::SetupError;
use realitysim_log_input::log::LogError;
use realitysim_log_input::scene_source::SceneSourceError;
use realitysim_recording::{Loss, RecordingError};

/// Why the pipeline cannot go on.
#[derive(Debug, Error)]
pub enum AgentError {
    /// The capture cannot be written.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// The state of the filter cannot be encoded.
    #[error("{path}: {source}")]
    Checkpoint {
        /// Name of the state file.
        path: PathBuf,
        /// What went wrong.
        source: CheckpointError,
    },
}

/// Why a log or scene cannot be replayed.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// The settings are wrong; the error names their file.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The log or scene lacks something or says something wrong.
    #[error("{path}: {source}{}", describe_losses(lost))]
    Source {
        /// The log or scene.
        path: PathBuf,
        /// What is wrong.
        source: Box<SetupError>,
        /// Losses of the log, which may be the cause.
        lost: Vec<Loss>,
    },
    /// The folder for captures is itself a part of a capture.
    #[error(
        "{captures}: the folder belongs to the capture {session}, to which nothing is added: name another with --output"
    )]
    IntoCapture {
        /// The folder for captures.
        captures: PathBuf,
        /// The capture that it belongs to.
        session: PathBuf,
    },
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The scene cannot be read or is wrong.
    #[error(transparent)]
    Scene(#[from] SceneSourceError),
    /// The pipeline cannot go on.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// All segments of a capture are missing.
    #[error("{path}: no segment of this capture is left{}", describe_losses(lost))]
    NoSegment {
        /// The capture.
        path: PathBuf,
        /// The missing segments.
        lost: Vec<Loss>,
    },
    /// There is no frame, or none that can be used; the text says why.
    #[error("no frame could be used: {0}")]
    NoFrame(String),
    /// The replay broke off; what came before is recorded.
    #[error("{source}; what came before is recorded in {session}")]
    Broken {
        /// Why it broke off.
        source: Box<ReplayError>,
        /// Folder of the session with what came before.
        session: PathBuf,
    },
}

/// The losses as the end of an error text: the first one, and how many more there are.
fn describe_losses(lost: &[Loss]) -> String {
    match lost {
        [] => String::new(),
        [loss] => format!("; it is not whole, which may be why: {loss}"),
        [first, rest @ ..] => format!("; it is not whole, which may be why: {first}; and {} more", rest.len()),
    }
}
