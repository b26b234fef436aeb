//! From messages to a capture: every message written, every frame tagged as soon as all is known about it.
//!
//! Whoever has messages feeds it, in the order in which they came: a replay from a log or a scene.

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
use realitysim_log_input::measurement;
use realitysim_log_input::synchroniser::Synchroniser;
use realitysim_recording::storage::Disk;
use realitysim_recording::{
    Counts, Ended, LiveInfo, RecorderStatus, STATE_FILE, SegmentState, SessionId, SessionInfo, SessionWriter, Thinning,
    Writing, folder_name, write_coverage,
};
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::{DiagnosticArray, FrameTag};
use realitysim_ros2::topics;

/// Where a pipeline writes, and how it works.
pub struct Recording {
    pub captures: PathBuf,
    /// What the messages come from, for `session.json`.
    pub source: Option<String>,
    pub threads: usize,
    /// Of a live recording.
    pub live: Option<LiveInfo>,
    /// Who wants each tag as it is made; one that does not keep up misses some.
    pub tags: Option<Sender<FrameTag>>,
    pub writing: Writing,
}

/// What a pipeline leaves behind.
pub struct Recorded {
    /// `None` if the disk did not let it become whole.
    pub session: Option<PathBuf>,
    pub counts: Counts,
    pub recorder: RecorderStatus,
    pub tally: RunStats,
    pub warnings: Vec<String>,
}

pub struct Pipeline {
    settings: Settings,
    topics: Topics,
    recording: Recording,
    lens: LensParameters,
    body_masks: Vec<Vec<u32>>,
    dimensions: FieldDimensions,
    attitude: AttitudeSource,
    synchroniser: Synchroniser,
    looking: PerceptionPool,
    tagger: Tagger,
    budget: Budget,
    session: Option<SessionWriter>,
    thinning: Thinning,
    /// What the log announces does not count then.
    initial_is_given: bool,
    /// Tagged, those before the checkpoint included: the next tag's number.
    sequence: u64,
    tally: RunStats,
    last_state_ns: i64,
    last_diagnostics_ns: i64,
    /// Frames that came while the agent waits for a pause between two frames.
    held: VecDeque<LogMessage>,
    /// Where the robot is while no frames come.
    foresight: DeadReckoning,
    eyes: Arc<FramePerception>,
    /// Of a replay: a robot has no time to look for causes.
    unplaced: Option<UnplacedFrames>,
}

/// How often, in log time, the state is saved.
const STATE_EVERY_NS: i64 = 1_000_000_000;
const DIAGNOSTICS_EVERY_NS: i64 = 1_000_000_000;
/// Why a frame has no tag: nobody can say when it was exposed.
const NO_STAMP: &str = "no_stamp";

impl Pipeline {
    pub fn new(setup: Setup, start: InitialState, recording: Recording) -> Self {
        let Setup { settings, topics, lens, dimensions, field, eyes, expected, synchroniser, attitude } = setup;
        let thinning = settings.recording.thinning.clone();
        let grid = PoseGrid::new(field.carpet_half_extent(), thinning.cell_m, usize::from(thinning.headings));
        let tagger = start.tagger(&settings, field, eyes.vision.lens());
        let budget = Budget::new(settings.filter.budget_ms, start.decided);
        let sequence = start.checkpoint.as_ref().map_or(0, |checkpoint| checkpoint.frames);
        let (state, foresight) = start.checkpoint.map_or_else(
            || (synchroniser, DeadReckoning::default()),
            |checkpoint| (checkpoint.synchroniser, checkpoint.foresight),
        );
        let mut synchroniser = Synchroniser::new(settings.frames.clone(), state);
        synchroniser.expect(expected);
        Self {
            topics,
            lens,
            body_masks: eyes.body_masks(),
            dimensions,
            attitude,
            synchroniser,
            looking: PerceptionPool::new(Arc::clone(&eyes), recording.threads),
            tagger,
            budget,
            session: None,
            thinning: Thinning::new(thinning, grid),
            initial_is_given: start.initial.is_some(),
            sequence,
            tally: RunStats::default(),
            last_state_ns: i64::MIN,
            last_diagnostics_ns: i64::MIN,
            held: VecDeque::new(),
            foresight,
            eyes,
            unplaced: recording.live.is_none().then(UnplacedFrames::default),
            settings,
            recording,
        }
    }

    /// The number that the next frame's tag gets.
    pub fn sequence(&self) -> u64 {
        self.sequence
    }

    pub fn take(&mut self, message: LogMessage) -> Result<(), AgentError> {
        if message.channel.topic == self.topics.ground_truth {
            return Ok(());
        }
        let log_time_ns = message.log_time_ns;
        if self.session.is_none() {
            self.session = Some(self.create_session(&message)?);
            // Nothing is known yet: the last agent's state is worth more.
            self.last_state_ns = log_time_ns;
        }
        self.pause_if_due(log_time_ns)?;
        let held_back = self.must_pause(log_time_ns) || !self.held.is_empty();
        if held_back && measurement::is_frame(&message.channel, &self.topics) {
            self.synchroniser.advance(log_time_ns);
            self.held.push_back(message);
        } else {
            self.record(message)?;
        }
        self.look_at_known()?;
        self.foresee(log_time_ns)
    }

    /// Frames that never became messages.
    pub fn drop_frames(&mut self, cause: &str, count: u64) -> Result<(), AgentError> {
        let Some(session) = &mut self.session else { return Ok(()) };
        Ok(session.drop_frames(cause, count)?)
    }

    /// What a live recording has to say beside its messages; nothing before the first of them.
    pub fn note(&mut self, log_time_ns: i64, report: &DiagnosticArray) -> Result<(), AgentError> {
        let Some(session) = &mut self.session else { return Ok(()) };
        Ok(session.diagnostics(log_time_ns, report)?)
    }

    /// What became of the frames so far, and how the recorder is, once it has begun.
    pub fn recorder(&self) -> Option<(Counts, RecorderStatus)> {
        self.session.as_ref().map(SessionWriter::account)
    }

    /// Counts the rounds of the recorder's thread, if there is one.
    pub fn recorder_rounds(&self) -> Option<u64> {
        self.session.as_ref().and_then(SessionWriter::rounds)
    }

    /// Of which poses there are images.
    pub fn coverage(&self) -> &PoseGrid {
        self.thinning.coverage()
    }

    /// Nothing more will come: what is there becomes a whole capture, whatever went wrong, if it can. `None` if nothing
    /// came at all.
    pub fn finish(mut self) -> (Option<Recorded>, Result<(), AgentError>) {
        self.conclude()
    }

    /// The same, and what goes on until another session begins.
    pub fn pause(mut self) -> (Option<Recorded>, Result<(), AgentError>, IdleOdometry) {
        let (recorded, ended) = self.conclude();
        let Self { topics, settings, synchroniser, tagger, foresight, .. } = self;
        (recorded, ended, IdleOdometry { topics, head: settings.head, synchroniser, tagger, foresight })
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
            // Without it the same is read from the tags.
            let _ = write_coverage(session, self.thinning.coverage(), counts.valid);
        }
        self.count_measurements();
        let warnings = self.warnings();
        let tally = core::mem::take(&mut self.tally);
        (Some(Recorded { session, counts, recorder, tally, warnings }), ended)
    }

    /// By what was tagged, not by what the disk has kept of it.
    fn warnings(&self) -> Vec<String> {
        let Self { tally, settings, .. } = self;
        let Settings { field, filter, frames, topics, .. } = settings;
        let heard = self.synchroniser.knows_attitude();
        let all = [
            self.attitude.warning(tally.without_tilt, tally.tags, heard, frames),
            warnings::unplaced(field, &tally.invalid, tally.tags, || self.cause()),
            warnings::no_picture(&tally.invalid, tally.tags),
            warnings::never_upright(&topics.imu, &tally.invalid, tally.tags),
            warnings::small_budget(filter.budget_ms, &tally.effort, tally.tags),
            self.tagger.lens_off().as_ref().and_then(warnings::wrong_lens),
            warnings::impossible_measurements(tally.impossible_measurements),
            warnings::unusable_weights(tally.unusable_weights),
            warnings::begun_anew(tally.begun_anew),
        ];
        all.into_iter().flatten().collect()
    }

    /// Why frames could not be placed.
    fn cause(&self) -> String {
        let Self { settings, topics, eyes, .. } = self;
        let Some((unplaced, field)) = self.unplaced.as_ref().zip(Field::new(self.dimensions.clone()).ok()) else {
            return warnings::possible_causes(settings.filter.budget_ms);
        };
        let given = DiagnosisInput { settings, topics, field: &field, eyes, threads: self.recording.threads };
        given.cause(unplaced).unwrap_or_else(|| "these are too few to find out why".to_owned())
    }

    fn end(&mut self) -> Result<(), AgentError> {
        self.synchroniser.finish();
        self.look_at_known()?;
        self.release_held()?;
        self.look_at_known()?;
        self.drain()?;
        if self.session.is_some() { self.save_state() } else { Ok(()) }
    }

    /// Writes a message and takes what it measures.
    fn record(&mut self, message: LogMessage) -> Result<(), AgentError> {
        let topics = &self.topics;
        let is_frame = measurement::is_frame(&message.channel, topics);
        let latched = message.channel.topic == topics.tf_static || message.channel.topic == topics.camera_info;
        let input = measurement::read(&message, topics, &self.settings.head);
        // Whether a frame is worth its bytes is known with its tag; one that can have none is written as it comes.
        let waits = is_frame && input.is_ok() && self.thinning.thins();
        if let (Some(session), false) = (&mut self.session, waits) {
            session.pass(&message, is_frame, latched)?;
        }
        match input {
            Ok(measurement::Measurement::InitialPose { .. }) if self.initial_is_given => {}
            Ok(input) => self.synchroniser.push(&message, input),
            Err(error) if is_frame => {
                self.tally.note_bad_frame(&message, &error);
                if let Some(session) = &mut self.session {
                    session.leave_untagged(NO_STAMP)?;
                }
            }
            Err(_) => self.tally.bad_messages += 1,
        }
        Ok(())
    }

    fn look_at_known(&mut self) -> Result<(), AgentError> {
        while let Some(mut frame) = self.synchroniser.pop() {
            self.foresight.meet(&mut frame, &mut self.tagger, &self.synchroniser);
            if let Some(looked) = self.looking.push(frame) {
                self.tag(looked)?;
            }
        }
        Ok(())
    }

    /// While no frame comes, odometry says where the robot is.
    fn foresee(&mut self, log_time_ns: i64) -> Result<(), AgentError> {
        if !(self.synchroniser.is_idle() && self.held.is_empty()) {
            return Ok(());
        }
        let Some(stamp_ns) = self.foresight.due(&self.synchroniser, log_time_ns) else { return Ok(()) };
        self.drain()?;
        let Some(mut tag) = self.foresight.look(stamp_ns, &mut self.tagger, &self.synchroniser) else { return Ok(()) };
        tag.sequence = self.sequence;
        self.stamp(&mut tag, stamp_ns);
        self.tally.predicted += 1;
        match &mut self.session {
            Some(session) => Ok(session.predicted_tag(log_time_ns, &tag)?),
            None => Ok(()),
        }
    }

    /// By the other clocks, and off to whoever listens.
    fn stamp(&self, tag: &mut FrameTag, stamp_ns: i64) {
        let live = self.recording.live.as_ref();
        tag.utc_offset_ns = live.map_or(0, |live| live.utc_offset_ns);
        tag.kernel_stamp_ns = stamp_ns + live.map_or(0, |live| live.camera_delay_ns - live.utc_offset_ns);
        if let Some(tags) = &self.recording.tags {
            let _ = tags.try_send(tag.clone());
        }
    }

    fn drain(&mut self) -> Result<(), AgentError> {
        while let Some(looked) = self.looking.pop() {
            self.tag(looked)?;
        }
        Ok(())
    }

    fn tag(&mut self, looked: PerceivedFrame) -> Result<(), AgentError> {
        let PerceivedFrame { frame, seen, look_ms } = looked;
        let start = Instant::now();
        let mut allowance = self.budget.frame(frame.stamp_ns, look_ms);
        let mut tag = match &seen {
            Ok(seen) => {
                let mut may_go_on = |weighed| allowance.may_go_on(weighed);
                self.tagger.tag(frame.stamp_ns, &frame.robot, seen, &mut may_go_on)
            }
            Err(unseen) => {
                self.tally.note_unseen(&frame, unseen, self.sequence);
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
            self.looking.give_back(seen);
        }
        self.stamp(&mut tag, frame.stamp_ns);
        self.sequence += 1;
        self.tally.unusable_weights = self.tagger.unusable_weights();
        self.tally.begun_anew = self.tagger.begun_anew();
        self.tally.note_tag(&frame.robot, &tag, self.settings.filter.budget_ms);
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
        self.report_diagnostics(log_time_ns)
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
    fn pause_if_due(&mut self, log_time_ns: i64) -> Result<(), AgentError> {
        if !self.must_pause(log_time_ns) || !self.synchroniser.is_idle() {
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
            synchroniser: self.synchroniser.state().clone(),
            foresight: self.foresight.clone(),
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
            // With the topics that were found: whoever reads the capture need not look for them again.
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
        self.tally.late_measurements = self.synchroniser.too_late();
        self.tally.impossible_measurements = self.synchroniser.impossible();
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
            self.tally.diagnostics(log_time_ns, robot, &session.counts(), session.status().conserved, filter.budget_ms);
        Ok(session.diagnostics(log_time_ns, &report)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input_source;
    use realitysim_log_input::scene_source;

    const SCENE: &str = include_str!("../../../tests/replay/scene.toml");
    const LENS: &str = include_str!("../../../tests/replay/lens.toml");

    /// Nothing says how its torso is tilted, which is told with the number of frames that it costs.
    #[test]
    fn warnings_count_the_frames_that_were_tagged_and_not_those_that_the_disk_has_kept() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("scene.toml");
        let without_imu = SCENE.split("[imu]").next().expect("a scene").replace("[-1.1, 0.3]", "[-1.6, 0.2]");
        std::fs::write(&path, without_imu).expect("written");
        std::fs::write(folder.path().join("lens.toml"), LENS).expect("written");
        let scene = scene_source::load(&path).expect("a scene");
        // What the disk has confirmed is in the first of two segments at least.
        let mut settings = Settings::default();
        settings.recording.segment_s = 1;
        let (setup, messages) = input_source::scene(&scene, &path, &settings).expect("opened");
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
        // Somebody removes what was recorded: another folder is begun, and the tags of the first are lost.
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
        assert!(recorded.tally.tags >= frames && frames > 3, "{} of {frames}", recorded.tally.tags);
        let all = recorded.tally.tags;
        assert!(warning.starts_with(&format!("{all} of {all} frames")), "{warning}");
    }
}
