//! Opens a log or a scene: what must be known before the first frame, then the messages.

use std::path::{Path, PathBuf};

use super::budget::Decisions;
use super::checkpoint::{Checkpoint, CheckpointError};
use super::error::ReplayError;
use super::log_scan::StreamInfo;
use super::setup::{Setup, SetupError};
use realitysim_config::{Settings, Topics};
use realitysim_log_input::log::{self as logs, LogError, LogSource, StoredCheckpoint};
use realitysim_log_input::scene_source::SceneSource;
use realitysim_log_input::topic_resolution;
use realitysim_recording::{Loss, missing_parts};
use realitysim_ros2::mcap_read::{LogMessage, Selection, Survey};
use realitysim_ros2::messages::{CompressedImage, FrameTag, Message, Odometry};
use realitysim_ros2::topics::{self, CHECKPOINT_ATTACHMENT};
use realitysim_scene::Scene;

/// A log that is ready to be read.
pub struct OpenLog {
    /// Topics, lens, field and transforms.
    pub setup: Setup,
    /// The log's messages.
    pub messages: LogSource,
    /// Checkpoint at the beginning of the log, if it is a segment of a capture.
    pub checkpoint: Option<Checkpoint>,
    /// Number of frames that the log states.
    pub frames: u64,
    /// Parts of the log that are known to be missing before a message is read.
    pub lost: Vec<Loss>,
    /// Findings that a user will want to know, as sentences.
    pub warnings: Vec<String>,
    /// Recorded stops of the time budget; empty if the settings have no budget.
    pub decided: Decisions,
}

/// Opens an MCAP file, a folder of them, or a capture.
///
/// Fails if there is no file, if a file cannot be read, or if topics, lens, field or mount cannot be determined.
pub fn log(path: &Path, settings: &Settings) -> Result<OpenLog, ReplayError> {
    let missing = missing_parts(path);
    let files = logs::files_of(path).map_err(|error| match error {
        LogError::NoFiles { path, .. } if !missing.is_empty() => ReplayError::NoSegment { path, lost: missing.clone() },
        error => error.into(),
    })?;
    let surveys = logs::surveys(&files)?;
    let stored = stored_state(&files, &surveys)?;
    let mut types = logs::topic_types(&surveys);
    let wanted = &settings.topics.image;
    let is_asked_for = *wanted != Topics::default().image;
    let lacks_images = topic_resolution::image(wanted, &types).is_err()
        && (is_asked_for || topic_resolution::images(&types).is_empty());
    let lacks_odometry = !topic_resolution::has_odometry(&settings.topics.odometry, &types);
    if stored.is_of_capture {
        // The camera or the odometry may have sent nothing during this segment. The other measurements are still of use.
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
    let clocks = prelude.warnings.clone();
    let setup = Setup::new(settings.clone(), prelude).map_err(|error| setup_error(path, error, lost()))?;
    Ok(OpenLog {
        setup,
        checkpoint: stored.checkpoint,
        frames,
        lost: missing.into_iter().chain(stored.loss).collect(),
        warnings: stored.warning.into_iter().chain(clocks).collect(),
        decided: if settings.filter.budget_ms > 0.0 { decisions(&files) } else { Decisions::new() },
        messages: LogSource::new(files, Selection::All),
    })
}

/// The setup of a scene and all its messages. `name` is for error texts.
pub(super) fn scene<'a>(
    scene: &'a Scene,
    name: &Path,
    settings: &Settings,
) -> Result<(Setup, impl Iterator<Item = Result<LogMessage, ReplayError>> + use<'a>), ReplayError> {
    let mut settings = settings.clone();
    settings.field = scene.file().scene.field.clone();
    settings.field_size_m = None;
    let mut source = SceneSource::new(scene);
    // The constants come before the first image; they are all that must be known beforehand.
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

/// Adds the log or scene and its losses to an error that lies in the log or scene.
fn setup_error(source: &Path, error: SetupError, lost: Vec<Loss>) -> ReplayError {
    match error {
        SetupError::Log(error) => ReplayError::Log(error),
        SetupError::Config(_) | SetupError::BodyMask { .. } | SetupError::Fov(_) => ReplayError::Setup(error),
        error => ReplayError::Source { path: source.to_owned(), source: Box::new(error), lost },
    }
}

/// Most frames whose recorded stops are remembered: ten hours at 30 Hz, 40 MB. The clock decides for later frames.
const MAX_DECISIONS: usize = 1 << 20;

/// The recorded stops of the time budget, from the tags in the files; empty if the log is not a capture.
///
/// Messages that cannot be read are skipped here; the replay reports them.
fn decisions(files: &[PathBuf]) -> Decisions {
    let tags = LogSource::with_outputs(files.to_vec(), Selection::topics([topics::FRAME_TAG]));
    let tags = tags.flatten().filter_map(|message| FrameTag::decode(&message.data).ok());
    let decided = tags.map(|tag| (tag.header.stamp.to_nanoseconds(), tag.capped.then_some(tag.stopped_at)));
    decided.take(MAX_DECISIONS).collect()
}

/// The checkpoint that a segment of a capture holds, or why it cannot be used.
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
        // A checkpoint of another version is not a loss of data.
        CheckpointError::Version { .. } => {
            StoredState { warning: Some(format!("{}: {what}", path.display())), ..of_capture }
        }
        _ => StoredState { loss: Some(Loss::new(path, what)), ..of_capture },
    })
}

/// End of the message about a checkpoint or state file that cannot be used.
pub(super) const BEGAN_ANEW: &str = "the filter began without it";
