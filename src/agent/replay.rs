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
use super::state::{Start, read_state};
use crate::config::Settings;
use crate::geometry::Pose2;
use crate::ros2::mcap_read::{LogMessage, Selection, Survey};
use crate::scene::Scene;
use crate::sensors::log::{self, LogError, LogSource};
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
    #[error("{path}: {source}")]
    Source { path: PathBuf, source: Box<SetupError> },
    #[error(transparent)]
    Log(#[from] LogError),
    #[error(transparent)]
    Scene(#[from] SceneSourceError),
    #[error(transparent)]
    Agent(#[from] AgentError),
    #[error("{path}: {source}")]
    Checkpoint { path: PathBuf, source: CheckpointError },
    #[error("no frame could be used: {0}")]
    NoFrame(String),
}

/// Frames done so far, and how many there are if that is known.
pub type Progress<'a> = &'a mut dyn FnMut(u64, Option<u64>);

pub fn replay(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    if options.source.extension().is_some_and(|ending| ending == "toml") {
        replay_scene(options, progress)
    } else {
        replay_log(options, progress)
    }
}

fn replay_log(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    let files = log::files_of(&options.source)?;
    let surveys = log::surveys(&files)?;
    let types = log::topic_types(&surveys);
    let all = files.clone();
    let prelude =
        Prelude::read(&options.settings, &types, move |selection| Box::new(LogSource::new(all.clone(), selection)))
            .map_err(|error| setup_error(&options.source, error))?;
    let frames = surveys.iter().flat_map(|survey| &survey.topics).filter(|topic| topic.topic == prelude.topics.image);
    let total = frames.map(|topic| topic.messages).sum();
    let checkpoint = segment_checkpoint(&files, &surveys)?;
    let mut source = LogSource::new(files, Selection::All);
    let run = Run::new(options, options.settings.clone(), prelude, checkpoint)?;
    let messages = source.by_ref().map(|message| message.map_err(ReplayError::from));
    let mut report = run.through(messages, &mut |done| progress(done, Some(total)))?;
    report.damage = source.damage().iter().map(|(file, damage)| file_damage(file, damage)).collect();
    Ok(report)
}

fn replay_scene(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    let path = options.source.to_string_lossy();
    let scene = scene::load(&path)?;
    let settings = scene_settings(&scene, &options.settings);
    let mut source = SceneSource::new(&scene);
    let (first, types) = scene_beginning(&mut source)?;
    let known = first.clone();
    let prelude = Prelude::read(&settings, &types, move |_| Box::new(known.clone().into_iter().map(Ok::<_, LogError>)))
        .map_err(|error| setup_error(&options.source, error))?;
    let total = Some(scene.frame_count());
    let messages = first.into_iter().map(Ok).chain(source.map(|message| message.map_err(ReplayError::from)));
    Run::new(options, settings, prelude, None)?.through(messages, &mut |done| progress(done, total))
}

/// A scene brings its field, and knows its lens's angle of view.
pub(super) fn scene_settings(scene: &Scene, settings: &Settings) -> Settings {
    let mut settings = settings.clone();
    settings.field = scene.file().scene.field.clone();
    settings.camera.fov_deg = settings.camera.fov_deg.or(scene.lens().parameters().fov_deg);
    settings
}

/// Up to the first image. Constants come first: they are all that the agent must know beforehand.
pub(super) fn scene_beginning(source: &mut SceneSource) -> Result<(Vec<LogMessage>, TopicTypes), SceneSourceError> {
    let mut first: Vec<LogMessage> = Vec::new();
    let (mut types, mut has_image) = (TopicTypes::new(), false);
    while !has_image {
        let Some(message) = source.next() else { break };
        let message = message?;
        types.insert(message.channel.topic.clone(), message.channel.type_name.clone());
        has_image = message.channel.type_name.ends_with("Image");
        first.push(message);
    }
    Ok((first, types))
}

/// Says in which log or scene something is wrong, if it is there.
pub(super) fn setup_error(source: &Path, error: SetupError) -> ReplayError {
    match error {
        SetupError::Log(error) => ReplayError::Log(error),
        SetupError::Config(_) | SetupError::BodyMask { .. } => ReplayError::Setup(error),
        error => ReplayError::Source { path: source.to_owned(), source: Box::new(error) },
    }
}

/// A segment of a capture brings the filter's state along.
pub(super) fn segment_checkpoint(files: &[PathBuf], surveys: &[Survey]) -> Result<Option<Checkpoint>, ReplayError> {
    let (Some(path), Some(survey)) = (files.first(), surveys.first()) else { return Ok(None) };
    let Some(bytes) = log::checkpoint(path, survey)? else { return Ok(None) };
    let decoded = Checkpoint::decode(&bytes);
    decoded.map(Some).map_err(|source| ReplayError::Checkpoint { path: path.clone(), source })
}

/// A pipeline at the pace that was asked for, and what its report says from the start.
struct Run {
    pipeline: Pipeline,
    report: ReplayReport,
    pace: Option<Pace>,
}

impl Run {
    fn new(
        options: &ReplayOptions,
        settings: Settings,
        prelude: Prelude,
        checkpoint: Option<Checkpoint>,
    ) -> Result<Self, ReplayError> {
        let setup = Setup::new(settings, prelude).map_err(|error| setup_error(&options.source, error))?;
        let warm = if options.warm_start { read_state(&options.captures)? } else { None };
        let recording = Recording {
            captures: options.captures.clone(),
            source: options.source.file_name().map(|name| name.to_string_lossy().into_owned()),
            threads: options.threads.max(1),
        };
        let filter = &setup.settings.filter;
        let report = ReplayReport {
            particles: filter.particles,
            iterations: filter.iterations,
            threads: recording.threads,
            ..ReplayReport::default()
        };
        let start = Start { checkpoint, warm, initial: options.initial };
        let pace = options.realtime.then(Pace::default);
        Ok(Self { pipeline: Pipeline::new(setup, start, recording), report, pace })
    }

    fn through(
        mut self,
        messages: impl Iterator<Item = Result<LogMessage, ReplayError>>,
        progress: &mut dyn FnMut(u64),
    ) -> Result<ReplayReport, ReplayError> {
        let started = Instant::now();
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
        let Recorded { session, counts, mut tally } =
            self.pipeline.finish()?.ok_or_else(|| ReplayError::NoFrame("the log has no message".to_owned()))?;
        Ok(ReplayReport {
            session,
            frames: counts.written,
            tagged: counts.tagged,
            valid: counts.valid,
            filter_ms: tally.filter_ms(),
            wall_s: started.elapsed().as_secs_f64(),
            invalid: tally.invalid,
            bad_messages: tally.bad_messages,
            first_bad_image: tally.first_bad_image,
            ..self.report
        })
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
