//! The pipeline from messages to a capture: every message is written, and every frame is tagged as soon as the
//! measurements around its exposure are there.
//!
//! Messages are fed in the order of arrival, by a replay from a log or a scene, or by the live recorder.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::Sender;

use super::budget::Budget;
use super::checkpoint::Checkpoint;
use super::dead_reckoning::DeadReckoning;
use super::diagnosis::{DiagnosisInput, UnplacedFrames};
use super::error::AgentError;
use super::inter_session::IdleOdometry;
use super::perception_pool::{PerceivedFrame, PerceptionPool};
use super::run_stats::RunStats;
use super::setup::{FramePerception, Setup};
use super::tagger::Tagger;
use super::warm_start::InitialState;
use super::warnings::{self, AttitudeSource};
use realitysim_config::{Settings, Topics};
use realitysim_geometry::{Field, FieldDimensions, Isometry, LensParameters, PoseGrid};
use realitysim_log_input::topic_resolution::TopicChoice;
use realitysim_log_input::{FrameAssembler, measurement};
use realitysim_recording::storage::Disk;
use realitysim_recording::{
    Counts, Ended, LiveInfo, RecorderStatus, STATE_FILE, SegmentState, SessionId, SessionInfo, SessionWriter, Thinning,
    Writing, folder_name, write_coverage,
};
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::{DiagnosticArray, FrameTag};
use realitysim_ros2::topics;

/// Where and how a pipeline records.
pub struct Recording {
    /// Folder in which the session's own folder is made.
    pub captures: PathBuf,
    /// Name of the source of the messages, for `session.json`.
    pub source: Option<String>,
    /// Number of threads that look at images.
    pub threads: usize,
    /// Facts of a live recording; `None` for a replay.
    pub live: Option<LiveInfo>,
    /// Receives each tag as it is made. A receiver that does not keep up misses tags.
    pub tags: Option<Sender<FrameTag>>,
    /// The thread that writes files: the caller's, or one of its own.
    pub writing: Writing,
}

/// The result of a finished pipeline.
pub struct Recorded {
    /// Folder of the session; `None` if the disk failed before the session was whole.
    pub session: Option<PathBuf>,
    /// What became of the frames.
    pub counts: Counts,
    /// State of the recorder at the end.
    pub recorder: RecorderStatus,
    /// Statistics of the tags and of the messages that could not be used.
    pub stats: RunStats,
    /// Findings that a user will want to know, as sentences.
    pub warnings: Vec<String>,
}

/// The chain from message to tag and capture.
pub struct Pipeline {
    settings: Settings,
    topics: Topics,
    recording: Recording,
    lens: LensParameters,
    body_masks: Vec<Vec<u32>>,
    dimensions: FieldDimensions,
    attitude: AttitudeSource,
    choices: Vec<TopicChoice>,
    assembler: FrameAssembler,
    perception_pool: PerceptionPool,
    tagger: Tagger,
    budget: Budget,
    session: Option<SessionWriter>,
    thinning: Thinning,
    /// The next tag's number: frames tagged so far, those before the checkpoint included.
    sequence: u64,
    stats: RunStats,
    last_state_ns: i64,
    last_diagnostics_ns: i64,
    /// Frames held back until no frame is under way, so that a segment or the saved state can end between two frames.
    held: VecDeque<LogMessage>,
    dead_reckoning: DeadReckoning,
    perception: Arc<FramePerception>,
    /// Samples for the diagnosis at the end; only in a replay, because a robot has no time for it.
    unplaced: Option<UnplacedFrames>,
    /// The latest tagged frame's message and its tag, for somebody who watches.
    latest: Option<(LogMessage, FrameTag)>,
}

/// Interval of log time at which the state is saved.
const STATE_EVERY_NS: i64 = 1_000_000_000;
/// Interval of log time at which diagnostics are written.
const DIAGNOSTICS_EVERY_NS: i64 = 1_000_000_000;
/// The cause of a frame without a tag whose stamp cannot be read.
const NO_STAMP: &str = "no_stamp";

impl Pipeline {
    /// A pipeline that has not taken a message. The session's folder is made with the first message.
    pub fn new(setup: Setup, start: InitialState, recording: Recording) -> Self {
        let (known, dead_reckoning) = start.checkpoint.as_ref().map_or_else(Default::default, |checkpoint| {
            (Some(checkpoint.synchroniser.clone()), checkpoint.dead_reckoning.clone())
        });
        let assembler = setup.assembler(known, start.initial.is_some());
        let Setup { settings, topics, lens, dimensions, field, perception, attitude, choices, .. } = setup;
        let thinning = settings.recording.thinning.clone();
        let grid = PoseGrid::new(field.carpet_half_extent(), thinning.cell_m, usize::from(thinning.headings));
        let tagger = start.tagger(&settings, field, perception.vision.lens());
        let budget = Budget::new(settings.filter.budget_ms, start.decided);
        let sequence = start.checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.frames);
        Self {
            topics,
            lens,
            body_masks: perception.body_masks(),
            dimensions,
            attitude,
            choices,
            assembler,
            perception_pool: PerceptionPool::new(Arc::clone(&perception), recording.threads),
            tagger,
            budget,
            session: None,
            thinning: Thinning::new(thinning, grid),
            sequence,
            stats: RunStats::default(),
            last_state_ns: i64::MIN,
            last_diagnostics_ns: i64::MIN,
            held: VecDeque::new(),
            dead_reckoning,
            perception,
            unplaced: recording.live.is_none().then(UnplacedFrames::default),
            latest: None,
            settings,
            recording,
        }
    }

    /// The number that the next frame's tag gets, counted from 0.
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    /// Takes the next message, in the order of arrival: records it, and tags the frames that have become ready.
    ///
    /// Messages of the ground truth are ignored.
    pub fn take(&mut self, message: LogMessage) -> Result<(), AgentError> {
        if message.channel.topic == self.topics.ground_truth {
            return Ok(());
        }
        let log_time_ns = message.log_time_ns;
        if self.session.is_none() {
            self.session = Some(self.create_session(&message)?);
            // The state that the last agent saved is not replaced at once: nothing is known yet.
            self.last_state_ns = log_time_ns;
        }
        self.pause_if_due(log_time_ns)?;
        let held_back = self.must_pause(log_time_ns) || !self.held.is_empty();
        if held_back && measurement::is_frame(&message.channel, &self.topics) {
            self.assembler.synchroniser.advance(log_time_ns);
            self.held.push_back(message);
        } else {
            self.record(message)?;
        }
        self.process_ready_frames()?;
        self.predict_if_due(log_time_ns)
    }

    /// Counts frames that were lost before they became messages, with the cause.
    pub fn drop_frames(&mut self, cause: &str, count: u64) -> Result<(), AgentError> {
        let Some(session) = &mut self.session else { return Ok(()) };
        Ok(session.drop_frames(cause, count)?)
    }

    /// Records diagnostics of a live recording. Before the first message it does nothing.
    pub fn note(&mut self, log_time_ns: i64, report: &DiagnosticArray) -> Result<(), AgentError> {
        let Some(session) = &mut self.session else { return Ok(()) };
        Ok(session.diagnostics(log_time_ns, report)?)
    }

    /// The frame counts so far and the recorder's state; `None` before the first message.
    pub fn recorder(&self) -> Option<(Counts, RecorderStatus)> {
        self.session.as_ref().map(SessionWriter::account)
    }

    /// The number of rounds that the recorder's thread has made, if there is one: a sign of life for the watchdog.
    pub fn recorder_rounds(&self) -> Option<u64> {
        self.session.as_ref().and_then(SessionWriter::rounds)
    }

    /// The grid of poses that images have been recorded at.
    pub fn coverage(&self) -> &PoseGrid {
        self.thinning.coverage()
    }

    /// Ends the recording: tags the remaining frames and completes the capture, as far as possible after an error.
    ///
    /// The first value is `None` if no message came.
    pub fn finish(mut self) -> (Option<Recorded>, Result<(), AgentError>) {
        self.conclude()
    }

    /// Like [`Self::finish`], and returns what follows odometry until another session begins.
    pub fn pause(mut self) -> (Option<Recorded>, Result<(), AgentError>, IdleOdometry) {
        let (recorded, ended) = self.conclude();
        let Self { topics, assembler, tagger, dead_reckoning, .. } = self;
        (recorded, ended, IdleOdometry { topics, assembler, tagger, dead_reckoning })
    }

    fn conclude(&mut self) -> (Option<Recorded>, Result<(), AgentError>) {
        let ended = self.end();
        let Some(session) = self.session.take() else { return (None, ended) };
        let Ended { folder, counts, status: recorder } = session.finish();
        let (session, ended) = match folder {
            Ok(folder) => (Some(folder), ended),
            Err(error) => (None, ended.and(Err(error.into()))),
        };
        if let Some(session) = &session {
            // An error is ignored: without the file the coverage is computed from the tags.
            let _ = write_coverage(session, self.thinning.coverage(), counts.valid);
        }
        self.count_measurements();
        let warnings = self.warnings();
        let stats = core::mem::take(&mut self.stats);
        (Some(Recorded { session, counts, recorder, stats, warnings }), ended)
    }

    /// The warnings of the run. They count the tags that were made, also those that the disk has not kept.
    fn warnings(&self) -> Vec<String> {
        let Self { stats, settings, .. } = self;
        let Settings { field, filter, frames, topics, .. } = settings;
        let heard = self.assembler.synchroniser.knows_attitude();
        let all = [
            self.attitude.warning(stats.without_tilt, stats.tags, heard, frames),
            warnings::made_attitude(&self.topics.imu, self.assembler.synchroniser.makes_attitude()),
            warnings::without_stamps(&self.choices),
            warnings::unplaced(field, &stats.invalid, stats.tags, || self.cause()),
            warnings::no_picture(&stats.invalid, stats.tags),
            warnings::never_upright(&topics.imu, &stats.invalid, stats.tags),
            warnings::small_budget(filter.budget_ms, &stats.effort, stats.tags),
            self.tagger.lens_off().as_ref().and_then(warnings::wrong_lens),
            warnings::impossible_measurements(stats.impossible_measurements),
            warnings::unusable_weights(stats.unusable_weights),
            warnings::begun_anew(stats.begun_anew),
        ];
        all.into_iter().flatten().collect()
    }

    /// The most probable cause of frames that could not be placed on the field.
    fn cause(&self) -> String {
        let Self { settings, topics, perception, .. } = self;
        let Some((unplaced, field)) = self.unplaced.as_ref().zip(Field::new(self.dimensions.clone()).ok()) else {
            return warnings::possible_causes(settings.filter.budget_ms);
        };
        let given = DiagnosisInput { settings, topics, field: &field, perception, threads: self.recording.threads };
        given.cause(unplaced).unwrap_or_else(|| {
            "these are too few to find out why, or the field is too large to try causes on it".to_owned()
        })
    }

    fn end(&mut self) -> Result<(), AgentError> {
        self.assembler.synchroniser.finish();
        self.process_ready_frames()?;
        self.release_held()?;
        self.process_ready_frames()?;
        self.drain()?;
        if self.session.is_some() { self.save_state() } else { Ok(()) }
    }

    /// Writes a message and passes its measurement to the assembler of frames.
    fn record(&mut self, message: LogMessage) -> Result<(), AgentError> {
        let topics = &self.topics;
        let is_frame = measurement::is_frame(&message.channel, topics);
        let latched = message.channel.topic == topics.tf_static || message.channel.topic == topics.camera_info;
        let input = self.assembler.read(&message);
        // With thinning, a frame is written or dropped when its tag is known; one that can have no tag is written at once.
        let waits = is_frame && input.is_ok() && self.thinning.thins();
        if let (Some(session), false) = (&mut self.session, waits) {
            session.pass(&message, is_frame, latched)?;
        }
        match input {
            Ok(input) => self.assembler.push(&message, input),
            Err(error) if is_frame => {
                self.stats.note_bad_frame(&message, &error);
                if let Some(session) = &mut self.session {
                    session.leave_untagged(NO_STAMP)?;
                }
            }
            Err(_) => self.stats.bad_messages += 1,
        }
        Ok(())
    }

    /// Sends frames whose measurements are complete to the perception threads, and tags those that come back.
    fn process_ready_frames(&mut self) -> Result<(), AgentError> {
        while let Some(mut frame) = self.assembler.pop() {
            self.dead_reckoning.end_with(&mut frame, &mut self.tagger, &self.assembler.synchroniser);
            if let Some(looked) = self.perception_pool.push(frame) {
                self.tag(looked)?;
            }
        }
        Ok(())
    }

    /// Writes a pose predicted from odometry if no frame has come for long enough.
    fn predict_if_due(&mut self, log_time_ns: i64) -> Result<(), AgentError> {
        if !(self.assembler.synchroniser.is_idle() && self.held.is_empty()) {
            return Ok(());
        }
        let Some(stamp_ns) = self.dead_reckoning.next_due_ns(&self.assembler.synchroniser, log_time_ns) else {
            return Ok(());
        };
        self.drain()?;
        let Some(mut tag) = self.dead_reckoning.predict(stamp_ns, &mut self.tagger, &self.assembler.synchroniser)
        else {
            return Ok(());
        };
        tag.sequence = self.sequence;
        self.add_clocks_and_send(&mut tag, stamp_ns);
        self.stats.predicted += 1;
        match &mut self.session {
            Some(session) => Ok(session.predicted_tag(log_time_ns, &tag)?),
            None => Ok(()),
        }
    }

    /// Adds the stamps of the other clocks (UTC, kernel) to the tag and sends it to the receiver of live tags.
    fn add_clocks_and_send(&self, tag: &mut FrameTag, stamp_ns: i64) {
        let live = self.recording.live.as_ref();
        tag.utc_offset_ns = live.map_or(0, |live| live.utc_offset_ns);
        tag.kernel_stamp_ns = stamp_ns + live.map_or(0, |live| live.camera_delay_ns - live.utc_offset_ns);
        if let Some(tags) = &self.recording.tags {
            let _ = tags.try_send(tag.clone());
        }
    }

    /// Tags all frames that the perception threads still have.
    fn drain(&mut self) -> Result<(), AgentError> {
        while let Some(looked) = self.perception_pool.pop() {
            self.tag(looked)?;
        }
        Ok(())
    }

    /// Tags one frame, records the tag, and with thinning the frame's message if it is kept.
    fn tag(&mut self, looked: PerceivedFrame) -> Result<(), AgentError> {
        let PerceivedFrame { frame, seen, look_ms } = looked;
        let start = Instant::now();
        let mut allowance = self.budget.frame(frame.stamp_ns, look_ms);
        let mut tag = match &seen {
            Ok(seen) => {
                let mut has_time = |weighed| allowance.has_time(weighed);
                self.tagger.tag(frame.stamp_ns, &frame.robot, seen, &mut has_time)
            }
            Err(unseen) => {
                self.stats.note_unseen(&frame, unseen, self.sequence);
                self.tagger.tag_blind(frame.stamp_ns, &frame.robot, unseen.rejection())
            }
        };
        tag.sequence = self.sequence;
        tag.elapsed_ms = look_ms + start.elapsed().as_secs_f64() * 1e3;
        tag.stopped_at = allowance.stopped_at().unwrap_or(0);
        self.budget.learn(&allowance);
        if let (Some(unplaced), Ok(_), true) = (&mut self.unplaced, &seen, warnings::is_unplaced(&tag.reason)) {
            unplaced.note(&frame);
        }
        if let Ok(seen) = seen {
            self.perception_pool.give_back(seen);
        }
        self.add_clocks_and_send(&mut tag, frame.stamp_ns);
        self.sequence += 1;
        self.stats.unusable_weights = self.tagger.unusable_weights();
        self.stats.begun_anew = self.tagger.begun_anew();
        self.stats.note_tag(&frame.robot, &tag, self.settings.filter.budget_ms);
        let log_time_ns = frame.message.log_time_ns;
        let pose = tag.valid.then(|| Isometry::from(tag.pose.pose));
        let keeps = self.thinning.keeps(frame.stamp_ns, pose.as_ref(), tag.pose.sigma_xy_m());
        if let Some(session) = &mut self.session {
            match (self.thinning.thins(), keeps) {
                (true, true) => session.pass(&frame.message, true, false)?,
                (true, false) => session.thin_frame()?,
                (false, _) => {}
            }
            session.tag(log_time_ns, &self.settings.frames.map, &tag)?;
        }
        self.latest = Some((frame.message, tag));
        self.report_diagnostics(log_time_ns)
    }

    /// The latest tagged frame's message and its tag.
    pub fn latest(&self) -> Option<&(LogMessage, FrameTag)> {
        self.latest.as_ref()
    }

    /// The field that the frames are tagged on.
    pub fn field(&self) -> &FieldDimensions {
        &self.dimensions
    }

    /// Whether a segment is full or the state is due to be saved. Both wait until no frame is under way, so that the
    /// checkpoint is exact.
    fn must_pause(&self, log_time_ns: i64) -> bool {
        self.is_segment_full(log_time_ns) || self.is_state_due(log_time_ns)
    }

    fn is_segment_full(&self, log_time_ns: i64) -> bool {
        self.session.as_ref().is_some_and(|session| session.is_segment_full(log_time_ns))
    }

    fn is_state_due(&self, log_time_ns: i64) -> bool {
        log_time_ns.saturating_sub(self.last_state_ns) >= STATE_EVERY_NS
    }

    /// Begins a new segment or saves the state, if one is due and no frame is waiting.
    ///
    /// If measurements arrive later than the next frame, there is always a frame waiting. Therefore further frames are
    /// held back until there is none, which takes milliseconds.
    fn pause_if_due(&mut self, log_time_ns: i64) -> Result<(), AgentError> {
        if !self.must_pause(log_time_ns) || !self.assembler.synchroniser.is_idle() {
            return Ok(());
        }
        self.drain()?;
        if self.is_segment_full(log_time_ns) {
            let state = self.segment_state(log_time_ns)?;
            if let Some(session) = &mut self.session {
                session.next_segment(state)?;
            }
        }
        if self.is_state_due(log_time_ns) {
            self.last_state_ns = log_time_ns;
            self.save_state()?;
        }
        self.release_held()
    }

    fn release_held(&mut self) -> Result<(), AgentError> {
        while let Some(message) = self.held.pop_front() {
            self.record(message)?;
        }
        Ok(())
    }

    fn segment_state(&self, log_time_ns: i64) -> Result<SegmentState, AgentError> {
        Ok(SegmentState { log_time_ns, name: topics::CHECKPOINT_ATTACHMENT, state: self.checkpoint()? })
    }

    fn checkpoint(&self) -> Result<Vec<u8>, AgentError> {
        let checkpoint = Checkpoint {
            tagger: self.tagger.state(),
            synchroniser: self.assembler.synchroniser.state().clone(),
            dead_reckoning: self.dead_reckoning.clone(),
            frames: self.sequence,
        };
        checkpoint.encode().map_err(|source| AgentError::Checkpoint { path: STATE_FILE.into(), source })
    }

    fn save_state(&mut self) -> Result<(), AgentError> {
        let state = self.checkpoint()?;
        let Some(session) = &mut self.session else { return Ok(()) };
        Ok(session.replace(self.recording.captures.join(STATE_FILE), state)?)
    }

    fn create_session(&self, first: &LogMessage) -> Result<SessionWriter, AgentError> {
        let settings = &self.settings;
        let started = jiff::Timestamp::from_nanosecond(i128::from(first.log_time_ns)).unwrap_or_default();
        let name = folder_name(started, &settings.robot);
        let info = SessionInfo {
            format: realitysim_recording::FORMAT_VERSION,
            id: Some(SessionId::new().as_str().to_owned()),
            software: concat!("realitysim ", env!("CARGO_PKG_VERSION")).to_owned(),
            robot: settings.robot.clone(),
            started: started.to_string(),
            source: self.recording.source.clone(),
            // With the topics that were found, so that a reader of the capture need not resolve them again.
            settings: Settings { topics: self.topics.clone(), ..settings.clone() },
            field: self.dimensions.clone(),
            lens: self.lens.clone(),
            body_masks: self.body_masks.clone(),
            live: self.recording.live.clone(),
        };
        let Recording { captures, writing, .. } = &self.recording;
        let state = self.segment_state(first.log_time_ns)?;
        Ok(SessionWriter::create(Arc::new(Disk), captures, &name, &info, state, *writing)?)
    }

    fn count_measurements(&mut self) {
        self.stats.late_measurements = self.assembler.synchroniser.too_late();
        self.stats.impossible_measurements = self.assembler.synchroniser.impossible();
    }

    fn report_diagnostics(&mut self, log_time_ns: i64) -> Result<(), AgentError> {
        if log_time_ns.saturating_sub(self.last_diagnostics_ns) < DIAGNOSTICS_EVERY_NS {
            return Ok(());
        }
        self.last_diagnostics_ns = log_time_ns;
        self.count_measurements();
        let Some(session) = &mut self.session else { return Ok(()) };
        let Settings { robot, filter, .. } = &self.settings;
        let report =
            self.stats.diagnostics(log_time_ns, robot, &session.counts(), session.status().conserved, filter.budget_ms);
        Ok(session.diagnostics(log_time_ns, &report)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::open_input;
    use realitysim_log_input::scene_source;

    const SCENE: &str = include_str!("../../../tests/replay/scene.toml");
    const LENS: &str = include_str!("../../../tests/replay/lens.toml");

    /// The scene has no IMU, so the warning about the unknown tilt states the number of frames.
    #[test]
    fn warnings_count_the_frames_tagged_and_not_those_kept_on_disk() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("scene.toml");
        let without_imu = SCENE.split("[imu]").next().expect("a scene").replace("[-1.1, 0.3]", "[-1.6, 0.2]");
        std::fs::write(&path, without_imu).expect("written");
        std::fs::write(folder.path().join("lens.toml"), LENS).expect("written");
        let scene = scene_source::load(&path).expect("a scene");
        // With segments of one second the disk has confirmed at least the first of two segments.
        let mut settings = Settings::default();
        settings.recording.segment_s = 1;
        let (setup, messages) = open_input::scene(&scene, &path, &settings).expect("opened");
        let captures = folder.path().join("captures");
        let recording = Recording {
            captures: captures.clone(),
            source: None,
            threads: 1,
            live: None,
            tags: None,
            writing: Writing::Here,
        };
        let mut pipeline = Pipeline::new(setup, InitialState::default(), recording);
        for message in messages {
            pipeline.take(message.expect("a message")).expect("taken");
        }
        // The recorded folder is removed: the recorder begins another one, and the tags of the first are lost.
        for entry in std::fs::read_dir(&captures).expect("there") {
            let session = entry.expect("an entry").path();
            if session.is_dir() {
                std::fs::remove_dir_all(session).expect("removed");
            }
        }
        let frames = pipeline.sequence();
        let (recorded, _) = pipeline.finish();
        let recorded = recorded.expect("something came");
        let warning = recorded.warnings.iter().find(|warning| warning.contains("as if the torso stood upright"));
        let warning = warning.unwrap_or_else(|| panic!("{:?}", recorded.warnings));
        assert!(recorded.counts.tagged < frames, "the disk has lost some: {:?}", recorded.counts);
        assert!(recorded.stats.tags >= frames && frames > 3, "{} of {frames}", recorded.stats.tags);
        let all = recorded.stats.tags;
        assert!(warning.starts_with(&format!("{all} of {all} frames")), "{warning}");
    }
}
