//! A log or a scene through the agent: every frame tagged and written, as fast as the machine can or paced by stamps.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use thiserror::Error;

use super::checkpoint::{Checkpoint, CheckpointError};
use super::report::{FileDamage, Quantiles, ReplayReport, file_damage, quantiles};
use super::setup::{self, Eyes, Prelude, SetupError};
use super::stages::{Looked, Looking, NotSeen};
use super::tagger::Tagger;
use crate::config::Settings;
use crate::geometry::{Field, FieldDimensions, Lens, Pose2};
use crate::localization::LocalizerState;
use crate::recording::{Counts, RecordingError, SessionInfo, SessionWriter, write_atomically};
use crate::ros2::mcap_read::{LogMessage, Selection, Survey};
use crate::ros2::messages::{DiagnosticArray, DiagnosticStatus, KeyValue};
use crate::sensors::intake;
use crate::sensors::log::{self, CHECKPOINT_NAME, LogError, LogSource};
use crate::sensors::scene::{self, SceneSource, SceneSourceError, header};
use crate::sensors::synchroniser::{Frame, InitialPose, Synchroniser};
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
    Recording(#[from] RecordingError),
    #[error("{path}: {source}")]
    Checkpoint { path: PathBuf, source: CheckpointError },
    #[error("no frame could be used: {0}")]
    NoFrame(String),
}

/// The state that an agent leaves behind for its next start.
pub const STATE_FILE: &str = "last_state.bin";
/// How often, in log time, that file is written.
const STATE_EVERY_NS: i64 = 1_000_000_000;
const DIAGNOSTICS_EVERY_NS: i64 = 1_000_000_000;

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
            .map_err(|error| setup_error(options, error))?;
    let frames = surveys.iter().flat_map(|survey| &survey.topics).filter(|topic| topic.topic == prelude.topics.image);
    let total = frames.map(|topic| topic.messages).sum();
    let checkpoint = segment_checkpoint(&files, &surveys)?;
    let mut source = LogSource::new(files, Selection::All);
    let mut agent = Agent::new(options, &prelude, checkpoint)?;
    for message in source.by_ref() {
        agent.take(message?, &mut |done| progress(done, Some(total)))?;
    }
    let damage = source.damage().iter().map(|(file, damage)| file_damage(file, damage)).collect();
    agent.finish(damage, &mut |done| progress(done, Some(total)))
}

fn replay_scene(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    let path = options.source.to_string_lossy();
    let scene = scene::load(&path)?;
    let mut options = options.clone();
    options.settings.field = scene.file().scene.field.clone();
    options.settings.camera.fov_deg = options.settings.camera.fov_deg.or(scene.lens().parameters().fov_deg);
    let mut source = SceneSource::new(&scene);
    // Constants come first: they are all that the agent must know beforehand.
    let mut first: Vec<LogMessage> = Vec::new();
    let (mut types, mut has_image) = (TopicTypes::new(), false);
    while !has_image {
        let Some(message) = source.next() else { break };
        let message = message?;
        types.insert(message.channel.topic.clone(), message.channel.type_name.clone());
        has_image = message.channel.type_name.ends_with("Image");
        first.push(message);
    }
    let known = first.clone();
    let prelude =
        Prelude::read(&options.settings, &types, move |_| Box::new(known.clone().into_iter().map(Ok::<_, LogError>)))
            .map_err(|error| setup_error(&options, error))?;
    let total = Some(scene.frame_count());
    let mut agent = Agent::new(&options, &prelude, None)?;
    for message in first.into_iter().map(Ok).chain(source) {
        agent.take(message?, &mut |done| progress(done, total))?;
    }
    agent.finish(Vec::new(), &mut |done| progress(done, total))
}

/// Says in which log or scene something is wrong, if it is there.
fn setup_error(options: &ReplayOptions, error: SetupError) -> ReplayError {
    match error {
        SetupError::Log(error) => ReplayError::Log(error),
        SetupError::Config(_) | SetupError::BodyMask { .. } => ReplayError::Setup(error),
        error => ReplayError::Source { path: options.source.clone(), source: Box::new(error) },
    }
}

/// A segment of a capture brings the filter's state along.
fn segment_checkpoint(files: &[PathBuf], surveys: &[Survey]) -> Result<Option<Checkpoint>, ReplayError> {
    let (Some(path), Some(survey)) = (files.first(), surveys.first()) else { return Ok(None) };
    let Some(bytes) = log::checkpoint(path, survey)? else { return Ok(None) };
    let decoded = Checkpoint::decode(&bytes);
    decoded.map(Some).map_err(|source| ReplayError::Checkpoint { path: path.clone(), source })
}

/// Takes messages in the order of the log, writes them, and tags each frame as soon as all is known about it.
struct Agent<'a> {
    options: &'a ReplayOptions,
    prelude: &'a Prelude,
    lens: Lens,
    dimensions: FieldDimensions,
    synchroniser: Synchroniser,
    looking: Looking,
    tagger: Tagger,
    session: Option<SessionWriter>,
    frames: u64,
    milliseconds: Vec<f32>,
    report: ReplayReport,
    started: Instant,
    first_log_ns: Option<i64>,
    last_state_ns: i64,
    last_diagnostics_ns: i64,
    /// Frames that came while the agent waits for a pause between two frames.
    held: VecDeque<LogMessage>,
}

impl<'a> Agent<'a> {
    fn new(
        options: &'a ReplayOptions,
        prelude: &'a Prelude,
        checkpoint: Option<Checkpoint>,
    ) -> Result<Self, ReplayError> {
        let settings = &options.settings;
        let lens = setup::lens(settings, prelude).map_err(|error| setup_error(options, error))?;
        let (field, dimensions) = setup::field(settings)?;
        let eyes = Arc::new(Eyes::new(settings, lens.clone())?);
        let tagger = first_tagger(options, field, &lens, checkpoint.as_ref())?;
        let frames = checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.frames);
        let state = checkpoint.map_or_else(|| prelude.synchroniser.clone(), |checkpoint| checkpoint.synchroniser);
        let mut synchroniser = Synchroniser::new(settings.frames.clone(), state);
        synchroniser.expect(prelude.expected);
        let threads = options.threads.max(1);
        let report = ReplayReport {
            session: PathBuf::new(),
            frames: 0,
            tagged: 0,
            valid: 0,
            particles: settings.filter.particles,
            iterations: settings.filter.iterations,
            threads,
            filter_ms: Quantiles::default(),
            wall_s: 0.0,
            invalid: Default::default(),
            bad_messages: 0,
            first_bad_image: None,
            damage: Vec::new(),
        };
        Ok(Self {
            options,
            prelude,
            lens,
            dimensions,
            synchroniser,
            looking: Looking::new(eyes, threads),
            tagger,
            session: None,
            frames,
            milliseconds: Vec::new(),
            report,
            started: Instant::now(),
            first_log_ns: None,
            last_state_ns: i64::MIN,
            last_diagnostics_ns: i64::MIN,
            held: VecDeque::new(),
        })
    }

    fn take(&mut self, message: LogMessage, progress: &mut dyn FnMut(u64)) -> Result<(), ReplayError> {
        let topics = &self.prelude.topics;
        if message.channel.topic == topics.ground_truth {
            return Ok(());
        }
        let log_time_ns = message.log_time_ns;
        self.pace(log_time_ns);
        if self.session.is_none() {
            let mut session = self.create_session(&message)?;
            session.attach(message.log_time_ns, CHECKPOINT_NAME, &self.checkpoint()?)?;
            self.session = Some(session);
        }
        self.pause_if_due(log_time_ns, progress)?;
        let held_back = self.must_pause(log_time_ns) || !self.held.is_empty();
        if held_back && message.channel.topic == topics.image {
            self.synchroniser.advance(log_time_ns);
            self.held.push_back(message);
        } else {
            self.record(message)?;
        }
        self.look_at_known(progress)
    }

    fn look_at_known(&mut self, progress: &mut dyn FnMut(u64)) -> Result<(), ReplayError> {
        while let Some(frame) = self.synchroniser.pop() {
            self.look(frame, progress)?;
        }
        Ok(())
    }

    /// Writes a message and takes what it measures.
    fn record(&mut self, message: LogMessage) -> Result<(), ReplayError> {
        let topics = &self.prelude.topics;
        let is_frame = message.channel.topic == topics.image;
        let latched = message.channel.topic == topics.tf_static || message.channel.topic == topics.camera_info;
        if let Some(session) = &mut self.session {
            session.pass(&message, is_frame, latched)?;
        }
        match intake::read(&message, topics, &self.options.settings.head) {
            Ok(intake::Input::InitialPose { .. }) if self.options.initial.is_some() => {}
            Ok(input) => self.synchroniser.push(&message, input),
            Err(_) => self.report.bad_messages += 1,
        }
        Ok(())
    }

    fn finish(mut self, damage: Vec<FileDamage>, progress: &mut dyn FnMut(u64)) -> Result<ReplayReport, ReplayError> {
        self.synchroniser.finish();
        self.look_at_known(progress)?;
        self.release_held()?;
        self.look_at_known(progress)?;
        self.drain(progress)?;
        let Some(session) = self.session.take() else {
            return Err(ReplayError::NoFrame("the log has no message".to_owned()));
        };
        self.save_state()?;
        let (folder, counts) = session.finish()?;
        let Counts { written, tagged, valid, .. } = counts;
        self.report.session = folder;
        (self.report.frames, self.report.tagged, self.report.valid) = (written, tagged, valid);
        self.report.filter_ms = quantiles(&mut self.milliseconds);
        self.report.wall_s = self.started.elapsed().as_secs_f64();
        self.report.damage = damage;
        Ok(self.report)
    }

    fn look(&mut self, frame: Frame, progress: &mut dyn FnMut(u64)) -> Result<(), ReplayError> {
        match self.looking.push(frame) {
            Some(looked) => self.tag(looked, progress),
            None => Ok(()),
        }
    }

    fn drain(&mut self, progress: &mut dyn FnMut(u64)) -> Result<(), ReplayError> {
        while let Some(looked) = self.looking.pop() {
            self.tag(looked, progress)?;
        }
        Ok(())
    }

    fn tag(&mut self, looked: Looked, progress: &mut dyn FnMut(u64)) -> Result<(), ReplayError> {
        let Looked { frame, seen, look_ms } = looked;
        let start = Instant::now();
        let mut tag = match &seen {
            Ok(seen) => self.tagger.tag(frame.stamp_ns, &frame.robot, seen),
            Err(reason) => {
                self.note_bad_image(&frame, reason);
                let short = match reason {
                    NotSeen::Decode(_) => "image_broken",
                    NotSeen::Size { .. } => "image_size",
                    NotSeen::NoPlace => "no_transform",
                };
                self.tagger.tag_blind(frame.stamp_ns, &frame.robot, short)
            }
        };
        tag.sequence = self.frames;
        tag.elapsed_ms = look_ms + start.elapsed().as_secs_f64() * 1e3;
        tag.kernel_stamp_ns = frame.stamp_ns;
        self.frames += 1;
        self.milliseconds.push(tag.elapsed_ms as f32);
        if !tag.valid {
            *self.report.invalid.entry(tag.reason.clone()).or_default() += 1;
        }
        let log_time_ns = frame.message.log_time_ns;
        if let Some(session) = &mut self.session {
            session.tag(log_time_ns, &self.options.settings.frames.map, &tag)?;
        }
        self.report_diagnostics(log_time_ns)?;
        progress(self.frames);
        Ok(())
    }

    /// A segment is full, or the state is to be saved: both only where no frame is under way, so that they are exact.
    fn must_pause(&self, log_time_ns: i64) -> bool {
        self.is_segment_full(log_time_ns) || self.is_state_due(log_time_ns)
    }

    fn is_segment_full(&self, log_time_ns: i64) -> bool {
        self.session.as_ref().is_some_and(|session| session.is_segment_full(log_time_ns))
    }

    fn is_state_due(&self, log_time_ns: i64) -> bool {
        log_time_ns.saturating_sub(self.last_state_ns) >= STATE_EVERY_NS
    }

    /// Where measurements come later than the next frame there is always a frame waiting: further ones are held back
    /// until there is none, which is a matter of milliseconds.
    fn pause_if_due(&mut self, log_time_ns: i64, progress: &mut dyn FnMut(u64)) -> Result<(), ReplayError> {
        if !self.must_pause(log_time_ns) || !self.synchroniser.is_idle() {
            return Ok(());
        }
        self.drain(progress)?;
        if self.is_segment_full(log_time_ns) {
            let checkpoint = self.checkpoint()?;
            if let Some(session) = &mut self.session {
                session.next_segment(log_time_ns, CHECKPOINT_NAME, &checkpoint)?;
            }
        }
        if self.is_state_due(log_time_ns) {
            self.last_state_ns = log_time_ns;
            self.save_state()?;
        }
        self.release_held()
    }

    fn release_held(&mut self) -> Result<(), ReplayError> {
        while let Some(message) = self.held.pop_front() {
            self.record(message)?;
        }
        Ok(())
    }

    fn checkpoint(&self) -> Result<Vec<u8>, ReplayError> {
        let checkpoint = Checkpoint {
            tagger: self.tagger.state(),
            synchroniser: self.synchroniser.state().clone(),
            frames: self.frames,
        };
        checkpoint.encode().map_err(|source| ReplayError::Checkpoint { path: STATE_FILE.into(), source })
    }

    fn save_state(&self) -> Result<(), ReplayError> {
        Ok(write_atomically(&self.options.captures.join(STATE_FILE), &self.checkpoint()?)?)
    }

    fn create_session(&self, first: &LogMessage) -> Result<SessionWriter, ReplayError> {
        let settings = &self.options.settings;
        let started = jiff::Timestamp::from_nanosecond(i128::from(first.log_time_ns)).unwrap_or_default();
        let name = format!("{}-{}", started.strftime("%Y-%m-%dT%H-%M-%SZ"), settings.robot);
        let info = SessionInfo {
            format: crate::recording::FORMAT_VERSION,
            software: concat!("realitysim ", env!("CARGO_PKG_VERSION")).to_owned(),
            robot: settings.robot.clone(),
            started: started.to_string(),
            source: self.options.source.file_name().map(|name| name.to_string_lossy().into_owned()),
            settings: settings.clone(),
            field: self.dimensions.clone(),
            lens: self.lens.parameters().clone(),
        };
        Ok(SessionWriter::create(&self.options.captures, &name, &info, settings.recording.clone())?)
    }

    fn report_diagnostics(&mut self, log_time_ns: i64) -> Result<(), ReplayError> {
        if log_time_ns.saturating_sub(self.last_diagnostics_ns) < DIAGNOSTICS_EVERY_NS {
            return Ok(());
        }
        self.last_diagnostics_ns = log_time_ns;
        let Some(session) = &mut self.session else { return Ok(()) };
        let counts = session.counts();
        let value = |key: &str, value: u64| KeyValue { key: key.to_owned(), value: value.to_string() };
        let mut values = vec![
            value("frames_captured", counts.captured),
            value("frames_written", counts.written),
            value("frames_tagged", counts.tagged),
            value("frames_valid", counts.valid),
            value("bad_messages", self.report.bad_messages),
        ];
        values.extend(counts.dropped.iter().map(|(cause, count)| value(&format!("dropped_{cause}"), *count)));
        let conserved = counts.is_conserved();
        let status = DiagnosticStatus {
            level: if conserved { DiagnosticStatus::OK } else { DiagnosticStatus::ERROR },
            name: format!("{}recorder", log::DIAGNOSTICS_NAME),
            message: if conserved { "captured = written + dropped" } else { "frames are unaccounted for" }.to_owned(),
            hardware_id: self.options.settings.robot.clone(),
            values,
        };
        let report = DiagnosticArray { header: header(log_time_ns, ""), status: vec![status] };
        Ok(session.diagnostics(log_time_ns, &report)?)
    }

    fn note_bad_image(&mut self, frame: &Frame, reason: &NotSeen) {
        self.report.first_bad_image.get_or_insert_with(|| {
            let what = match reason {
                NotSeen::Decode(error) => error.to_string(),
                NotSeen::Size { image, lens } => {
                    format!("{} x {} pixels, but the lens has {} x {}", image[0], image[1], lens[0], lens[1])
                }
                NotSeen::NoPlace => match &frame.robot.place {
                    Err(error) => error.to_string(),
                    Ok(_) => String::new(),
                },
            };
            format!("{}, frame {}: {what}", frame.message.channel.topic, self.frames)
        });
    }

    fn pace(&mut self, log_time_ns: i64) {
        let first = *self.first_log_ns.get_or_insert(log_time_ns);
        if self.options.realtime {
            let due = Duration::from_nanos(log_time_ns.saturating_sub(first).max(0) as u64);
            std::thread::sleep(due.saturating_sub(self.started.elapsed()));
        }
    }
}

/// The filter's start: a segment's checkpoint, the last agent's state, or nothing.
fn first_tagger(
    options: &ReplayOptions,
    field: Field,
    lens: &Lens,
    checkpoint: Option<&Checkpoint>,
) -> Result<Tagger, ReplayError> {
    let settings = &options.settings;
    let state = checkpoint.map_or_else(LocalizerState::default, |checkpoint| checkpoint.tagger.clone());
    let mut tagger = Tagger::new(settings, field.clone(), lens.clone(), state);
    let path = options.captures.join(STATE_FILE);
    // A first start has nothing to go on from.
    let saved = if options.warm_start { std::fs::read(&path).ok() } else { None };
    if let Some(bytes) = saved {
        let saved = Checkpoint::decode(&bytes).map_err(|source| ReplayError::Checkpoint { path, source })?;
        tagger = Tagger::new(settings, field, lens.clone(), saved.tagger);
        tagger.resume();
    }
    if let Some(map_from_footprint) = options.initial {
        tagger.start_at(&InitialPose { map_from_footprint, xy_m: None, yaw_rad: None });
    }
    Ok(tagger)
}
