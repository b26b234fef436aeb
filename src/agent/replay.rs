//! A log or a scene through the pipeline: every frame tagged and written, as fast as the machine can or at the log's
//! own pace.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use thiserror::Error;

use super::checkpoint::{Checkpoint, CheckpointError};
use super::error::AgentError;
use super::pipeline::{Pipeline, Recorded, Recording};
use super::prelude::Prelude;
use super::report::{ReplayReport, file_damage};
use super::setup::{Setup, SetupError};
use super::state::{Start, last_state};
use crate::config::Settings;
use crate::geometry::Pose2;
use crate::recording::{Loss, missing_parts, session_holding};
use crate::ros2::mcap_read::{LogMessage, Selection, Survey};
use crate::sensors::log::{self, CHECKPOINT_NAME, LogError, LogSource, StoredCheckpoint};
use crate::sensors::scene::{self, SceneSource, SceneSourceError};
use crate::sensors::topics::TopicTypes;

#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// An MCAP file, a folder of them, or a scene file (`.toml`).
    pub source: PathBuf,
    pub captures: PathBuf,
    pub settings: Settings,
    /// In place of what the log announces.
    pub initial: Option<Pose2>,
    pub threads: usize,
    /// Wait so that frames come as fast as they were taken.
    pub realtime: bool,
    /// Go on from the state that the last replay into `captures` left behind.
    pub warm_start: bool,
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

/// Frames done so far, and how many there are if that is known.
pub type Progress<'a> = &'a mut dyn FnMut(u64, Option<u64>);

pub fn replay(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    if let Some(session) = session_holding(&options.captures) {
        return Err(ReplayError::IntoCapture { captures: options.captures.clone(), session });
    }
    if options.source.extension().is_some_and(|ending| ending == "toml") {
        replay_scene(options, progress)
    } else {
        replay_log(options, progress)
    }
}

fn replay_log(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    let missing = missing_parts(&options.source);
    let files = log::files_of(&options.source).map_err(|error| match error {
        LogError::NoFiles { path } if !missing.is_empty() => ReplayError::NoSegment { path, lost: missing.clone() },
        error => error.into(),
    })?;
    let surveys = log::surveys(&files)?;
    let types = log::topic_types(&surveys);
    let lost = || {
        let damaged = files.iter().zip(&surveys).filter(|(_, survey)| !survey.damage.is_none());
        let damaged = damaged.map(|(file, survey)| Loss::of_damage(file, &survey.damage));
        missing.iter().cloned().chain(damaged).collect()
    };
    let all = files.clone();
    let prelude =
        Prelude::read(&options.settings, &types, move |selection| Box::new(LogSource::new(all.clone(), selection)))
            .map_err(|error| setup_error(&options.source, error, lost()))?;
    let frames = surveys.iter().flat_map(|survey| &survey.topics).filter(|topic| topic.topic == prelude.topics.image);
    let total = frames.map(|topic| topic.messages).sum();
    let stored = stored_state(&files, &surveys)?;
    let setup =
        Setup::new(options.settings.clone(), prelude).map_err(|error| setup_error(&options.source, error, lost()))?;
    let mut source = LogSource::new(files, Selection::All);
    let messages = source.by_ref().map(|message| message.map_err(ReplayError::from));
    let mut run = Run::new(options, setup, stored.checkpoint);
    run.report.lost.extend(missing.into_iter().chain(stored.loss));
    run.report.warnings.extend(stored.warning);
    let mut report = run.through(messages, &mut |done| progress(done, Some(total)))?;
    report.damage = source.damage().iter().map(|(file, damage)| file_damage(file, damage)).collect();
    Ok(report)
}

fn replay_scene(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    let path = options.source.to_string_lossy();
    let scene = scene::load(&path)?;
    let mut settings = options.settings.clone();
    settings.field = scene.file().scene.field.clone();
    let mut source = SceneSource::new(&scene);
    // Constants come first: they are all that the agent must know beforehand.
    let mut first: Vec<LogMessage> = Vec::new();
    let (mut types, mut has_image) = (TopicTypes::new(), false);
    while !has_image {
        let Some(message) = source.next() else { break };
        let message = message?;
        let kinds = types.entry(message.channel.topic.clone()).or_default();
        kinds.insert(message.channel.type_name.clone());
        has_image = message.channel.type_name.ends_with("Image");
        first.push(message);
    }
    let known = first.clone();
    let setup = Prelude::read(&settings, &types, move |_| Box::new(known.clone().into_iter().map(Ok::<_, LogError>)))
        .and_then(|prelude| Setup::new(settings, prelude))
        .map_err(|error| setup_error(&options.source, error, Vec::new()))?;
    let total = Some(scene.frame_count());
    let messages = first.into_iter().map(Ok).chain(source.map(|message| message.map_err(ReplayError::from)));
    Run::new(options, setup, None).through(messages, &mut |done| progress(done, total))
}

/// Says in which log or scene something is wrong, if it is there, and what of it was lost.
fn setup_error(source: &Path, error: SetupError, lost: Vec<Loss>) -> ReplayError {
    match error {
        SetupError::Log(error) => ReplayError::Log(error),
        SetupError::Config(_) | SetupError::BodyMask { .. } => ReplayError::Setup(error),
        error => ReplayError::Source { path: source.to_owned(), source: Box::new(error), lost },
    }
}

/// What a segment of a capture brings along of the filter's state, or why that is of no use.
#[derive(Default)]
struct StoredState {
    checkpoint: Option<Checkpoint>,
    loss: Option<Loss>,
    warning: Option<String>,
}

fn stored_state(files: &[PathBuf], surveys: &[Survey]) -> Result<StoredState, ReplayError> {
    let (Some(path), Some(survey)) = (files.first(), surveys.first()) else { return Ok(StoredState::default()) };
    let decoded = match log::checkpoint(path, survey)? {
        StoredCheckpoint::None => return Ok(StoredState::default()),
        StoredCheckpoint::Damaged => Err(CheckpointError::Damaged),
        StoredCheckpoint::Bytes(bytes) => Checkpoint::decode(&bytes),
    };
    let error = match decoded {
        Ok(checkpoint) => return Ok(StoredState { checkpoint: Some(checkpoint), ..StoredState::default() }),
        Err(error) => error,
    };
    let what = format!("its attachment {CHECKPOINT_NAME}: {error}; {BEGAN_ANEW}");
    Ok(match error {
        // Not lost, only of another time.
        CheckpointError::Version { .. } => {
            StoredState { warning: Some(format!("{}: {what}", path.display())), ..StoredState::default() }
        }
        _ => StoredState { loss: Some(Loss::new(path, what)), ..StoredState::default() },
    })
}

const BEGAN_ANEW: &str = "the filter began without it";

/// A pipeline at the pace that was asked for, and what its report says from the start.
struct Run {
    pipeline: Pipeline,
    report: ReplayReport,
    pace: Option<Pace>,
}

impl Run {
    fn new(options: &ReplayOptions, setup: Setup, checkpoint: Option<Checkpoint>) -> Self {
        let recording = Recording {
            captures: options.captures.clone(),
            source: options.source.file_name().map(|name| name.to_string_lossy().into_owned()),
            threads: options.threads.max(1),
        };
        let filter = &setup.settings.filter;
        let mut report = ReplayReport {
            particles: filter.particles,
            iterations: filter.iterations,
            threads: recording.threads,
            ..ReplayReport::default()
        };
        let warm = if options.warm_start { last_state(&options.captures) } else { Ok(None) };
        let warm = warm.unwrap_or_else(|error| {
            // A robot that starts by itself must record, whatever its last end has left of the file.
            report.warnings.push(format!("{error}; {BEGAN_ANEW}, and replaces it"));
            None
        });
        let start = Start { checkpoint, warm, initial: options.initial };
        let pace = options.realtime.then(Pace::default);
        Self { pipeline: Pipeline::new(setup, start, recording), report, pace }
    }

    fn through(
        mut self,
        messages: impl Iterator<Item = Result<LogMessage, ReplayError>>,
        progress: &mut dyn FnMut(u64),
    ) -> Result<ReplayReport, ReplayError> {
        let started = Instant::now();
        let fed = self.feed(messages, progress);
        let (recorded, ended) = self.pipeline.finish();
        let recorded = match (fed.and(ended.map_err(ReplayError::from)), recorded) {
            (Ok(()), Some(recorded)) => recorded,
            (Ok(()), None) => return Err(ReplayError::NoFrame("the log has no message".to_owned())),
            (Err(error), None) => return Err(error),
            (Err(error), Some(Recorded { session, .. })) => {
                return Err(ReplayError::Broken { source: Box::new(error), session });
            }
        };
        let Recorded { session, counts, tally, late_measurements, warnings } = recorded;
        let mut report = self.report;
        report.warnings.extend(warnings);
        Ok(ReplayReport {
            session,
            frames: counts.written,
            tagged: counts.tagged,
            valid: counts.valid,
            filter_ms: tally.durations.quantiles(),
            wall_s: started.elapsed().as_secs_f64(),
            invalid: tally.invalid,
            untagged: counts.untagged,
            bad_messages: tally.bad_messages,
            late_measurements,
            first_bad_image: tally.first_bad_image,
            ..report
        })
    }

    fn feed(
        &mut self,
        messages: impl Iterator<Item = Result<LogMessage, ReplayError>>,
        progress: &mut dyn FnMut(u64),
    ) -> Result<(), ReplayError> {
        for message in messages {
            let message = message?;
            if let Some(pace) = &mut self.pace {
                pace.wait_for(message.log_time_ns);
            }
            let before = self.pipeline.sequence();
            self.pipeline.take(message)?;
            if self.pipeline.sequence() > before {
                progress(self.pipeline.sequence());
            }
        }
        Ok(())
    }
}

/// Lets messages through no earlier after the first than they were logged after it.
#[derive(Default)]
struct Pace {
    first: Option<(i64, Instant)>,
}

impl Pace {
    fn wait_for(&mut self, log_time_ns: i64) {
        let (first_ns, started) = *self.first.get_or_insert_with(|| (log_time_ns, Instant::now()));
        let due = Duration::from_nanos(log_time_ns.saturating_sub(first_ns).max(0) as u64);
        std::thread::sleep(due.saturating_sub(started.elapsed()));
    }
}
