//! A log or a scene, opened: what must be known before its first frame, then its messages.

use std::path::{Path, PathBuf};

use super::budget::Decisions;
use super::checkpoint::{Checkpoint, CheckpointError};
use super::error::ReplayError;
use super::log_scan::StreamInfo;
use super::setup::{Setup, SetupError};
use realitysim_config::Settings;
use realitysim_log_input::log::{self as logs, LogError, LogSource, StoredCheckpoint};
use realitysim_log_input::scene_source::SceneSource;
use realitysim_log_input::topic_resolution;
use realitysim_recording::{Loss, missing_parts};
use realitysim_ros2::mcap_read::{LogMessage, Selection, Survey};
use realitysim_ros2::messages::{CompressedImage, FrameTag, Message, Odometry};
use realitysim_ros2::topics::{self, CHECKPOINT_ATTACHMENT};
use realitysim_scene::Scene;

pub struct OpenLog {
    pub setup: Setup,
    pub messages: LogSource,
    /// Of a capture's segment.
    pub checkpoint: Option<Checkpoint>,
    /// How many there should be.
    pub frames: u64,
    /// What is known to be missing before anything is read.
    pub lost: Vec<Loss>,
    pub warnings: Vec<String>,
    /// What the recording agent's clock decided, if a budget is set.
    pub decided: Decisions,
}

pub fn log(path: &Path, settings: &Settings) -> Result<OpenLog, ReplayError> {
    let missing = missing_parts(path);
    let files = logs::files_of(path).map_err(|error| match error {
        LogError::NoFiles { path, .. } if !missing.is_empty() => ReplayError::NoSegment { path, lost: missing.clone() },
        error => error.into(),
    })?;
    let surveys = logs::surveys(&files)?;
    let stored = stored_state(&files, &surveys)?;
    let mut types = logs::topic_types(&surveys);
    let lacks_images = topic_resolution::image(&settings.topics.image, &types).is_err();
    let lacks_odometry = !types.values().any(|types| types.contains(Odometry::TYPE));
    if stored.is_of_capture {
        // Of a time when the camera or the odometry sent nothing, for which recording did not end; what else was measured then is
        // whole.
        let mut expect = |topic: &str, name: &str| types.entry(topic.to_owned()).or_default().insert(name.to_owned());
        if lacks_images {
            expect(&settings.topics.image, CompressedImage::TYPE);
        }
        if lacks_odometry {
            expect(&settings.topics.odometry, Odometry::TYPE);
        }
    }
    let lost = || {
        let damaged = files.iter().zip(&surveys).filter(|(_, survey)| !survey.damage.is_none());
        let damaged = damaged.map(|(file, survey)| Loss::of_damage(file, &survey.damage));
        missing.iter().cloned().chain(damaged).collect()
    };
    let all = files.clone();
    let prelude = StreamInfo::read(settings, &types, move |selection| Box::new(LogSource::new(all.clone(), selection)))
        .map_err(|error| setup_error(path, error, lost()))?;
    let frames = surveys.iter().flat_map(|survey| &survey.topics).filter(|topic| topic.topic == prelude.topics.image);
    let frames = frames.map(|topic| topic.messages).sum();
    let setup = Setup::new(settings.clone(), prelude).map_err(|error| setup_error(path, error, lost()))?;
    Ok(OpenLog {
        setup,
        checkpoint: stored.checkpoint,
        frames,
        lost: missing.into_iter().chain(stored.loss).collect(),
        warnings: stored.warning.into_iter().collect(),
        decided: if settings.filter.budget_ms > 0.0 { decisions(&files) } else { Decisions::new() },
        messages: LogSource::new(files, Selection::All),
    })
}

/// With all messages of the scene; `name` is for messages to people.
pub(super) fn scene<'a>(
    scene: &'a Scene,
    name: &Path,
    settings: &Settings,
) -> Result<(Setup, impl Iterator<Item = Result<LogMessage, ReplayError>> + use<'a>), ReplayError> {
    let mut settings = settings.clone();
    settings.field = scene.file().scene.field.clone();
    let mut source = SceneSource::new(scene);
    // Constants come first: they are all that the agent must know beforehand.
    let mut first: Vec<LogMessage> = Vec::new();
    let types = SceneSource::topic_types(scene);
    let mut has_image = false;
    while !has_image {
        let Some(message) = source.next() else { break };
        let message = message?;
        has_image = message.channel.type_name.ends_with("Image");
        first.push(message);
    }
    let known = first.clone();
    let setup =
        StreamInfo::read(&settings, &types, move |_| Box::new(known.clone().into_iter().map(Ok::<_, LogError>)))
            .and_then(|prelude| Setup::new(settings, prelude))
            .map_err(|error| setup_error(name, error, Vec::new()))?;
    let messages = first.into_iter().map(Ok).chain(source.map(|message| message.map_err(ReplayError::from)));
    Ok((setup, messages))
}

/// Says in which log or scene something is wrong, if it is there, and what of it was lost.
fn setup_error(source: &Path, error: SetupError, lost: Vec<Loss>) -> ReplayError {
    match error {
        SetupError::Log(error) => ReplayError::Log(error),
        SetupError::Config(_) | SetupError::BodyMask { .. } | SetupError::Fov(_) => ReplayError::Setup(error),
        error => ReplayError::Source { path: source.to_owned(), source: Box::new(error), lost },
    }
}

/// Frames remembered: ten hours at 30 Hz, 40 MB. Later ones are decided by the clock.
const MAX_DECISIONS: usize = 1 << 20;

/// Of a log that is no capture, nothing. What cannot be read will be told when the log is replayed.
fn decisions(files: &[PathBuf]) -> Decisions {
    let tags = LogSource::with_outputs(files.to_vec(), Selection::topics([topics::FRAME_TAG]));
    let tags = tags.flatten().filter_map(|message| FrameTag::decode(&message.data).ok());
    let decided = tags.map(|tag| (tag.header.stamp.to_nanoseconds(), tag.capped.then_some(tag.stopped_at)));
    decided.take(MAX_DECISIONS).collect()
}

/// What a segment of a capture brings along of the filter's state, or why that is of no use.
#[derive(Default)]
struct StoredState {
    is_of_capture: bool,
    checkpoint: Option<Checkpoint>,
    loss: Option<Loss>,
    warning: Option<String>,
}

fn stored_state(files: &[PathBuf], surveys: &[Survey]) -> Result<StoredState, ReplayError> {
    let (Some(path), Some(survey)) = (files.first(), surveys.first()) else { return Ok(StoredState::default()) };
    let decoded = match logs::checkpoint(path, survey)? {
        StoredCheckpoint::None => return Ok(StoredState::default()),
        StoredCheckpoint::Damaged => Err(CheckpointError::Damaged),
        StoredCheckpoint::Bytes(bytes) => Checkpoint::decode(&bytes),
    };
    let of_capture = StoredState { is_of_capture: true, ..StoredState::default() };
    let error = match decoded {
        Ok(checkpoint) => return Ok(StoredState { checkpoint: Some(checkpoint), ..of_capture }),
        Err(error) => error,
    };
    let what = format!("its attachment {CHECKPOINT_ATTACHMENT}: {error}; {BEGAN_ANEW}");
    Ok(match error {
        // Not lost, only of another time.
        CheckpointError::Version { .. } => {
            StoredState { warning: Some(format!("{}: {what}", path.display())), ..of_capture }
        }
        _ => StoredState { loss: Some(Loss::new(path, what)), ..of_capture },
    })
}

pub(super) const BEGAN_ANEW: &str = "the filter began without it";
