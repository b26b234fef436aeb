//! Where the filter goes on from, and what it leaves behind for the next start.

use std::io::{self, Read};
use std::path::Path;

use super::budget::Decisions;
use super::checkpoint::{Checkpoint, MAX_BYTES};
use super::dead_reckoning::DeadReckoning;
use super::tagger::Tagger;
use realitysim_config::{Settings, plain_file};
use realitysim_geometry::{Field, Lens, Pose2};
use realitysim_localization::LocalizerState;
use realitysim_log_input::synchroniser::{InitialPose, SynchroniserState};
use realitysim_recording::STATE_FILE;

/// What is known when the first message comes.
#[derive(Clone, Debug, Default)]
pub struct InitialState {
    /// Of the segment that is replayed: exact.
    pub checkpoint: Option<Checkpoint>,
    /// Of the last agent: the robot may have been carried since.
    pub warm: Option<WarmState>,
    /// In place of what the log announces.
    pub initial: Option<Pose2>,
    /// Of the agent that recorded what is replayed.
    pub decided: Decisions,
}

/// What an agent leaves to the next one.
#[derive(Clone, Debug, PartialEq)]
pub struct WarmState {
    state: LocalizerState,
    /// A place that somebody said, after what the state is of.
    told: Option<InitialPose>,
}

impl WarmState {
    /// What was foreseen without frames knows more than what the last one left.
    pub(super) fn new(foresight: DeadReckoning, tagger: LocalizerState, synchroniser: &SynchroniserState) -> Self {
        match foresight.state() {
            Some(state) => Self { state, told: None },
            None => Self { state: tagger, told: synchroniser.pending() },
        }
    }
}

impl InitialState {
    pub(super) fn tagger(&self, settings: &Settings, field: Field, lens: &Lens) -> Tagger {
        let exact = self.checkpoint.as_ref().map(|checkpoint| checkpoint.tagger.clone());
        let mut tagger = match &self.warm {
            Some(warm) => Tagger::new(settings, field, lens, warm.state.clone()),
            None => Tagger::new(settings, field, lens, exact.unwrap_or_default()),
        };
        if let Some(warm) = &self.warm {
            tagger.resume();
            warm.told.iter().for_each(|told| tagger.start_at(told));
        }
        if let Some(map_from_footprint) = self.initial {
            tagger.start_at(&InitialPose { map_from_footprint, xy_m: None, yaw_rad: None });
        }
        tagger
    }
}

/// The state that the last agent left in `captures`, or why there is none to go on from. A first start has none.
pub fn last_state(captures: &Path) -> Result<Option<WarmState>, String> {
    let path = captures.join(STATE_FILE);
    let why = |what: String| format!("{}: {what}", path.display());
    let file = match plain_file::open(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        file => file.map_err(|error| why(error.to_string()))?,
    };
    let mut bytes = Vec::new();
    file.take(MAX_BYTES as u64).read_to_end(&mut bytes).map_err(|error| why(error.to_string()))?;
    let saved = Checkpoint::decode(&bytes).map_err(|error| why(error.to_string()))?;
    Ok(Some(WarmState::new(saved.foresight, saved.tagger, &saved.synchroniser)))
}
