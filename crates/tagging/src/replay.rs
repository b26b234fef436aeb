//! Replays a log or a scene through the pipeline: every frame is tagged and written, as fast as the machine can or at
//! the log's own pace.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::budget::Decisions;
use super::checkpoint::Checkpoint;
use super::error::ReplayError;
use super::open_input::{self, BEGAN_ANEW, OpenLog};
use super::pipeline::{Pipeline, Recorded, Recording};
use super::report::{ReplayReport, file_damage};
use super::setup::Setup;
use super::warm_start::{InitialState, last_state};
use realitysim_config::Settings;
use realitysim_geometry::Pose2;
use realitysim_log_input::{InputSource, scene_source};
use realitysim_recording::{Writing, session_holding};
use realitysim_ros2::mcap_read::LogMessage;

/// What to replay, and how.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// An MCAP file, a folder of them, or a scene file (`.toml`).
    pub source: PathBuf,
    /// Folder in which the session's own folder is made.
    pub captures: PathBuf,
    /// Settings of the agent.
    pub settings: Settings,
    /// Pose of `base_footprint` in `map` to start at, in place of what the log announces.
    pub initial: Option<Pose2>,
    /// Number of threads that look at images; at least 1 is used.
    pub threads: usize,
    /// Replay at the pace at which the log was recorded.
    pub realtime: bool,
    /// Go on from the state that the last replay into `captures` left behind.
    pub warm_start: bool,
}

/// Callback that gets the number of frames done so far, and the number of all frames if it is known.
pub type Progress<'a> = &'a mut dyn FnMut(u64, Option<u64>);

/// Tags and records every frame of a log or scene.
///
/// Fails if the source cannot be opened, has no message, or breaks off; what came before the break is recorded.
pub fn replay(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    if let Some(session) = session_holding(&options.captures) {
        return Err(ReplayError::IntoCapture { captures: options.captures.clone(), session });
    }
    if InputSource::is_scene(&options.source) { replay_scene(options, progress) } else { replay_log(options, progress) }
}

fn replay_log(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    let OpenLog { setup, mut messages, checkpoint, frames, lost, warnings, decided } =
        open_input::log(&options.source, &options.settings)?;
    let mut run = Run::new(options, setup, checkpoint, decided);
    run.report.lost.extend(lost);
    run.report.warnings.extend(warnings);
    let read = messages.by_ref().map(|message| message.map_err(ReplayError::from));
    let mut report = run.through(read, &mut |done| progress(done, Some(frames)))?;
    report.damage = messages.damage().iter().map(|(file, damage)| file_damage(file, damage)).collect();
    Ok(report)
}

fn replay_scene(options: &ReplayOptions, progress: Progress) -> Result<ReplayReport, ReplayError> {
    let scene = scene_source::load(&options.source)?;
    let (setup, messages) = open_input::scene(&scene, &options.source, &options.settings)?;
    let total = Some(scene.frame_count());
    Run::new(options, setup, None, Decisions::new()).through(messages, &mut |done| progress(done, total))
}

/// A replay in progress.
struct Run {
    pipeline: Pipeline,
    report: ReplayReport,
    pace: Option<Pace>,
}

impl Run {
    fn new(options: &ReplayOptions, setup: Setup, checkpoint: Option<Checkpoint>, decided: Decisions) -> Self {
        let recording = Recording {
            captures: options.captures.clone(),
            source: options.source.file_name().map(|name| name.to_string_lossy().into_owned()),
            threads: options.threads.max(1),
            live: None,
            tags: None,
            writing: Writing::Here,
        };
        let filter = &setup.settings.filter;
        let mut report = ReplayReport {
            particles: filter.particles,
            iterations: filter.iterations,
            adaptive: filter.adaptive,
            threads: recording.threads,
            read: setup.choices.clone(),
            ..ReplayReport::default()
        };
        report.warnings.extend(setup.lens_warning.clone());
        let warm = if options.warm_start { last_state(&options.captures) } else { Ok(None) };
        let warm = warm.unwrap_or_else(|error| {
            // A robot that starts by itself must record, also when the last run has left a broken file.
            report.warnings.push(format!("{error}; {BEGAN_ANEW}, and replaces it"));
            None
        });
        let start = InitialState { checkpoint, warm, initial: options.initial, decided };
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
        let session = recorded.as_ref().and_then(|recorded| recorded.session.clone());
        let (recorded, session) = match (fed.and(ended.map_err(ReplayError::from)), recorded, session) {
            (Ok(()), Some(recorded), Some(session)) => (recorded, session),
            (Ok(()), ..) => return Err(ReplayError::NoFrame("the log has no message".to_owned())),
            (Err(error), _, None) => return Err(error),
            (Err(error), _, Some(session)) => return Err(ReplayError::Broken { source: Box::new(error), session }),
        };
        let Recorded { counts, stats, warnings, .. } = recorded;
        let mut report = self.report;
        report.warnings.extend(warnings);
        Ok(ReplayReport {
            session,
            frames: counts.written,
            tagged: counts.tagged,
            valid: counts.valid,
            thinned: counts.thinned,
            filter_ms: stats.effort.durations.quantiles(),
            capped: stats.effort.capped,
            over_budget: stats.effort.over_budget,
            wall_s: started.elapsed().as_secs_f64(),
            invalid: stats.invalid,
            first_invalid: stats.first_invalid,
            untagged: counts.untagged,
            predicted: stats.predicted,
            bad_messages: stats.bad_messages,
            late_measurements: stats.late_measurements,
            impossible_measurements: stats.impossible_measurements,
            first_bad_image: stats.first_bad_image,
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

/// Delays each message until as much time has passed since the first message as in the log.
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
