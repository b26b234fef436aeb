//! Reading of tags and other messages back out of a capture.

use std::path::{Path, PathBuf};

use thiserror::Error;

use super::folder::{Loss, missing_parts};
use realitysim_log_input::log::{LogError, LogSource, files_of};
use realitysim_ros2::cdr::CdrError;
use realitysim_ros2::mcap_read::{Damage, LogMessage, Selection};
use realitysim_ros2::messages::{FrameTag, Message};
use realitysim_ros2::topics;

/// Why nothing could be read of a topic.
#[derive(Debug, Error)]
pub enum ReadoutError {
    /// The log could not be opened or read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log has no message of the topic.
    #[error("{path}: no message on {topic}: {hint}{}", loss.as_ref().map(|l| format!(" ({l})")).unwrap_or_default())]
    NoMessages {
        /// The log.
        path: String,
        /// The topic.
        topic: String,
        /// What may have been meant instead.
        hint: Box<str>,
        /// The first part that is missing of the log, if there is one.
        loss: Option<Loss>,
    },
    /// A message could not be decoded.
    #[error("{path}: {topic}: {source}")]
    Message {
        /// The log.
        path: String,
        /// The topic.
        topic: String,
        /// Error of the decoder.
        source: CdrError,
    },
}

/// What could be read of a log, and what is lost of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Readout<T> {
    /// What was read, in the order of the log.
    pub found: Vec<T>,
    /// Parts of the log that cannot be read.
    pub losses: Vec<Loss>,
    /// Reasons why what was read may not be what it is taken for.
    pub warnings: Vec<String>,
}

/// Reads all tags of a capture (a folder or one of its segments), in the order of the frames.
pub fn read_tags(path: &Path) -> Result<Readout<FrameTag>, ReadoutError> {
    let hint = || "is it a capture, and of a time with frames? `realitysim replay` makes one".to_owned();
    let read = read_topic(path, topics::FRAME_TAG, hint)?;
    let tag = |message: &LogMessage| {
        FrameTag::decode(&message.data).map_err(|source| ReadoutError::Message {
            path: path.display().to_string(),
            topic: topics::FRAME_TAG.to_owned(),
            source,
        })
    };
    let found = read.found.iter().map(tag).collect::<Result<_, _>>()?;
    Ok(Readout { found, losses: read.losses, warnings: read.warnings })
}

/// Reads all messages of one topic of a log or capture, whatever their type.
///
/// A log without any is an error, which ends with `hint`.
pub fn read_topic(path: &Path, name: &str, hint: impl FnOnce() -> String) -> Result<Readout<LogMessage>, ReadoutError> {
    let mut source = LogSource::with_outputs(files_of(path)?, Selection::topics([name]));
    let found = source.by_ref().collect::<Result<Vec<_>, _>>()?;
    let losses = losses(path, source.damage());
    if !found.is_empty() {
        return Ok(Readout { found, losses, warnings: Vec::new() });
    }
    Err(ReadoutError::NoMessages {
        path: path.display().to_string(),
        topic: name.to_owned(),
        hint: hint().into_boxed_str(),
        loss: losses.into_iter().next(),
    })
}

/// What is missing of a capture according to its manifest, together with the damage that its readers met.
pub fn losses(path: &Path, damage: &[(PathBuf, Damage)]) -> Vec<Loss> {
    let mut losses = missing_parts(path);
    damage.iter().for_each(|(file, damage)| Loss::of_damage(file, damage).join(&mut losses));
    losses
}
