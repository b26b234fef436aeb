//! The state that the filter starts from, and the state that it leaves for the next start.

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
    /// Checkpoint of the segment that is replayed, from which the tags are exactly those recorded.
    pub checkpoint: Option<Checkpoint>,
    /// State that the last agent left. The robot may have been carried since.
    pub warm: Option<WarmState>,
    /// Pose of `base_footprint` in `map` to start at, in place of what the log announces.
    pub initial: Option<Pose2>,
    /// Stops of the time budget that the recording agent stored with its tags.
    pub decided: Decisions,
}

/// The state that an agent leaves to the next one.
#[derive(Clone, Debug, PartialEq)]
pub struct WarmState {
    state: LocalizerState,
    /// A pose announced later than the time of the state.
    announced: Option<InitialPose>,
}

impl WarmState {
    /// The state of the dead reckoning if poses were being predicted, otherwise that after the last frame.
    pub(super) fn new(dead_reckoning: DeadReckoning, tagger: LocalizerState, synchroniser: &SynchroniserState) -> Self {
        match dead_reckoning.state() {
            Some(state) => Self { state, announced: None },
            None => Self { state: tagger, announced: synchroniser.pending() },
        }
    }
}

impl InitialState {
    /// A tagger that starts from this state. A given initial pose takes precedence, then the last agent's state.
    pub(super) fn tagger(&self, settings: &Settings, field: Field, lens: &Lens) -> Tagger {
        let exact = self.checkpoint.as_ref().map(|checkpoint| checkpoint.tagger.clone());
        let mut tagger = match &self.warm {
            Some(warm) => Tagger::new(settings, field, lens, warm.state.clone()),
            None => Tagger::new(settings, field, lens, exact.unwrap_or_default()),
        };
        if let Some(warm) = &self.warm {
            tagger.resume();
            warm.announced.iter().for_each(|pose| tagger.start_at(pose));
        }
        if let Some(map_from_footprint) = self.initial {
            tagger.start_at(&InitialPose { map_from_footprint, xy_m: None, yaw_rad: None });
        }
        tagger
    }
}

/// The state that the last agent left in the folder `captures`; `None` if there is none, as before a first start.
///
/// The error says why the file cannot be used.
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
    Ok(Some(WarmState::new(saved.dead_reckoning, saved.tagger, &saved.synchroniser)))
}
