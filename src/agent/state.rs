//! Where the filter goes on from, and what it leaves behind for the next start.

use std::path::Path;

use super::checkpoint::Checkpoint;
use super::error::AgentError;
use super::tagger::Tagger;
use crate::config::Settings;
use crate::geometry::{Field, Lens, Pose2};
use crate::localization::LocalizerState;
use crate::recording::write_atomically;
use crate::sensors::synchroniser::InitialPose;

/// The state that an agent leaves behind, in the folder of all captures.
pub const STATE_FILE: &str = "last_state.bin";

/// What is known when the first message comes.
#[derive(Clone, Debug, Default)]
pub struct Start {
    /// Of the segment that is replayed: exact.
    pub checkpoint: Option<Checkpoint>,
    /// Of the last agent: the robot may have been carried since.
    pub warm: Option<LocalizerState>,
    /// In place of what the log announces.
    pub initial: Option<Pose2>,
}

impl Start {
    pub(super) fn tagger(&self, settings: &Settings, field: Field, lens: &Lens) -> Tagger {
        let exact = self.checkpoint.as_ref().map(|checkpoint| checkpoint.tagger.clone());
        let mut tagger = match &self.warm {
            Some(warm) => Tagger::new(settings, field, lens, warm.clone()),
            None => Tagger::new(settings, field, lens, exact.unwrap_or_default()),
        };
        if self.warm.is_some() {
            tagger.resume();
        }
        if let Some(map_from_footprint) = self.initial {
            tagger.start_at(&InitialPose { map_from_footprint, xy_m: None, yaw_rad: None });
        }
        tagger
    }
}

/// The state that the last agent left in `captures`. A first start has nothing to go on from.
pub fn read_state(captures: &Path) -> Result<Option<LocalizerState>, AgentError> {
    let path = captures.join(STATE_FILE);
    let Ok(bytes) = std::fs::read(&path) else { return Ok(None) };
    match Checkpoint::decode(&bytes) {
        Ok(saved) => Ok(Some(saved.tagger)),
        Err(source) => Err(AgentError::Checkpoint { path, source }),
    }
}

pub(super) fn write_state(captures: &Path, checkpoint: &[u8]) -> Result<(), AgentError> {
    Ok(write_atomically(&captures.join(STATE_FILE), checkpoint)?)
}
