//! Runs of a suite: all cases in parallel first, then those with a limit on time one at a time.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use serde::Serialize;
use thiserror::Error;

use super::file::{Case, Suite};
use super::judge::{Judged, judge, judge_poses};
use super::limits::Broken;
use super::timing::p99_ratio;
use crate::capture::{EvaluationError, read_frame_times, read_poses, read_truth, tagged};
use crate::compare::Tagged;
use crate::reference::{self, Frames, Identity, Reference, ReferenceError, Verdict, settings_that_matter};
use crate::truth;
use realitysim_config::{ConfigError, Settings};
use realitysim_geometry::Isometry;
use realitysim_log_input::InputSource;
use realitysim_log_input::scene_source::{self, SceneSourceError};
use realitysim_recording::{Loss, Readout, ReadoutError, read_tags};
use realitysim_tagging::{FrameCacheOptions, ReplayError, ReplayOptions, replay};

/// Options of a run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder for the captures; each case gets a folder in it.
    pub captures: PathBuf,
    /// Number of cases that run at the same time.
    pub jobs: usize,
}

/// Result of one case.
#[derive(Clone, Debug, Serialize)]
pub struct CaseReport {
    /// Name of the case.
    pub name: String,
    /// Log or scene of the case.
    pub source: PathBuf,
    /// Whether the case kept its limits.
    pub outcome: Outcome,
    /// Errors, share of valid tags and recoveries.
    #[serde(flatten)]
    pub judged: Judged,
    /// 99 % quantile of the time for a frame in units of the calibration loop; `None` without a limit on time.
    pub p99_ratio: Option<f64>,
    /// Limits that were broken.
    pub broken: Vec<Broken>,
    /// Comparison with the reference of the case, if it has one.
    pub reference: Option<Verdict>,
    /// Reason why the case failed, if it did.
    pub error: Option<String>,
    /// Parts of the logs that could not be read and were not judged.
    pub lost: Vec<Loss>,
    /// Reasons why the judged poses may not be what they are taken for.
    pub warnings: Vec<String>,
    /// Folder with the tags, if the case was replayed.
    pub capture: Option<PathBuf>,
    /// Time for replay and judgement, seconds.
    pub wall_s: f64,
}

/// Result of a case in one word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// All limits were kept.
    Kept,
    /// A limit was broken, or tags differ from the reference.
    Broken,
    /// The case could not be run or judged.
    Failed,
}

/// Receiver of the progress of a run; called from several threads.
pub trait Watcher: Sync {
    /// Tells that a case is done, as the `done`th of `total`.
    fn done(&self, done: usize, total: usize, report: &CaseReport);

    /// Tells that a case is about to run alone, to be timed.
    fn timing(&self, name: &str);
}

#[derive(Debug, Error)]
enum CaseError {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Scene(#[from] SceneSourceError),
    #[error(transparent)]
    Replay(#[from] ReplayError),
    #[error(transparent)]
    Evaluation(#[from] EvaluationError),
    #[error(transparent)]
    Tags(#[from] ReadoutError),
    #[error("limits.valid_share is of the camera's frames: {0}; let source or truth be a log that has them")]
    NoFrames(EvaluationError),
    #[error(transparent)]
    Reference(#[from] ReferenceError),
}

/// Runs all cases and returns their reports in the order of the suite.
pub fn run(suite: &Suite, options: &Options, watcher: &dyn Watcher) -> Vec<CaseReport> {
    let cases = &suite.cases;
    let next = AtomicUsize::new(0);
    let finished: Mutex<Vec<(usize, CaseReport)>> = Mutex::new(Vec::new());
    let work = || {
        let take = || {
            let index = next.fetch_add(1, Ordering::Relaxed);
            cases.get(index).map(|case| (index, case))
        };
        while let Some((index, case)) = take() {
            let report = run_case(case, &options.captures.join(format!("{index:03}")));
            let mut finished = finished.lock().unwrap_or_else(PoisonError::into_inner);
            watcher.done(finished.len() + 1, cases.len(), &report);
            finished.push((index, report));
        }
    };
    std::thread::scope(|scope| (0..options.jobs.clamp(1, cases.len())).for_each(|_| drop(scope.spawn(work))));
    let mut finished = finished.into_inner().unwrap_or_else(PoisonError::into_inner);
    finished.sort_by_key(|(index, _)| *index);
    let mut reports: Vec<CaseReport> = finished.into_iter().map(|(_, report)| report).collect();
    for (case, report) in cases.iter().zip(&mut reports) {
        measure_time(case, report, watcher);
    }
    reports
}

fn run_case(case: &Case, captures: &Path) -> CaseReport {
    let started = Instant::now();
    let mut report = CaseReport {
        name: case.name.clone(),
        source: case.source.clone(),
        outcome: Outcome::Kept,
        judged: Judged::default(),
        p99_ratio: None,
        broken: Vec::new(),
        reference: None,
        error: None,
        lost: Vec::new(),
        warnings: Vec::new(),
        capture: None,
        wall_s: 0.0,
    };
    match judge_case(case, captures, &mut report) {
        Ok(judged) => {
            report.broken = case.limits.broken(&judged);
            report.judged = judged;
            if !report.broken.is_empty() || report.reference.as_ref().is_some_and(|verdict| !verdict.same) {
                report.outcome = Outcome::Broken;
            }
        }
        Err(error) => report.fail(&error),
    }
    report.wall_s = started.elapsed().as_secs_f64();
    report
}

impl CaseReport {
    /// Returns whether all limits were kept and all logs were read completely.
    pub fn passed(&self) -> bool {
        self.outcome == Outcome::Kept && self.lost.is_empty()
    }

    /// Takes what was read from a log, and notes its losses and warnings.
    fn found<T>(&mut self, read: Readout<T>) -> Vec<T> {
        self.note_losses(read.losses);
        self.warnings.extend(read.warnings);
        read.found
    }

    /// Notes losses, each file once: a file may be read more than once.
    fn note_losses(&mut self, losses: Vec<Loss>) {
        for loss in losses {
            if !self.lost.iter().any(|known| known.file == loss.file) {
                self.lost.push(loss);
            }
        }
    }

    fn fail(&mut self, error: &dyn core::fmt::Display) {
        self.outcome = Outcome::Failed;
        self.error = Some(error.to_string());
    }
}

fn judge_case(case: &Case, captures: &Path, report: &mut CaseReport) -> Result<Judged, CaseError> {
    let settings = settings(case)?;
    // The reference is read before the long work, so that an unreadable one is refused at once.
    let reference = case.reference.as_deref().map(Reference::load).transpose()?;
    // A case that is only compared with a reference needs no truth.
    let truth = if case.limits.ask_for_truth() { truth_of(case, &settings, report)? } else { Vec::new() };
    if let Some(topic) = &case.poses {
        let poses = report.found(read_poses(&case.source, topic)?);
        let frames = frame_times(case, &settings, report)?;
        return Ok(judge_poses(case, &poses, &frames, &truth));
    }
    let options = ReplayOptions {
        source: case.source.clone(),
        captures: captures.to_owned(),
        settings,
        initial: None,
        threads: 1,
        realtime: false,
        warm_start: false,
    };
    let replayed = replay(&options, &mut |_, _| ())?;
    report.capture = Some(replayed.session.clone());
    report.note_losses(replayed.unread());
    let tags = read_tags(&replayed.session)?.found;
    if let (Some(reference), Some(path)) = (reference, &case.reference) {
        let identity = Identity::of(&case.source, &replayed.session, None)?;
        let settings = settings_that_matter(&replayed.session)?;
        let file = path.display().to_string();
        report.reference = Some(reference::compare(&reference, &file, &identity, &settings, &Frames::of(&tags))?);
    }
    let tags: Vec<Tagged> = tags.iter().map(tagged).collect();
    Ok(judge(case, &tags, &truth))
}

fn settings(case: &Case) -> Result<Settings, ConfigError> {
    case.config.as_ref().map_or_else(|| Ok(Settings::default()), |path| Settings::load(&path.to_string_lossy()))
}

/// Reads the times of the frames from the log that the judged program was given: as a rule the one with the truth, else
/// the source.
///
/// Logs without images are an error only if there is a limit on the share of valid frames.
fn frame_times(case: &Case, settings: &Settings, report: &mut CaseReport) -> Result<Vec<i64>, CaseError> {
    let logs = case.truth.iter().chain([&case.source]);
    let mut refused = None;
    for log in logs {
        match read_frame_times(log, &settings.topics) {
            Ok(read) => return Ok(report.found(read)),
            Err(error) => refused = refused.or(Some(error)),
        }
    }
    match refused {
        Some(error) if case.limits.valid_share.is_some() => Err(CaseError::NoFrames(error)),
        _ => Ok(Vec::new()),
    }
}

/// Returns the true poses: those of the scene, or those in the log.
fn truth_of(case: &Case, settings: &Settings, report: &mut CaseReport) -> Result<Vec<(i64, Isometry)>, CaseError> {
    if case.truth.is_none() && InputSource::is_scene(&case.source) {
        return Ok(truth::of_scene(&scene_source::load(&case.source)?));
    }
    let log = case.truth.as_ref().unwrap_or(&case.source);
    Ok(report.found(read_truth(log, &settings.topics.ground_truth)?))
}

/// Measures the time for a frame if the case has a limit on it, while no other case runs.
fn measure_time(case: &Case, report: &mut CaseReport, watcher: &dyn Watcher) {
    if case.limits.p99_ratio.is_none() || report.outcome == Outcome::Failed {
        return;
    }
    watcher.timing(&case.name);
    let measured = settings(case).map_err(CaseError::from).and_then(|settings| {
        let options = FrameCacheOptions {
            source: case.source.clone(),
            settings: settings.clone(),
            initial: None,
            from_s: 0.0,
            for_s: None,
        };
        Ok(p99_ratio(&options, &settings)?)
    });
    match measured {
        Ok(ratio) => {
            report.p99_ratio = Some(ratio);
            if let Some(broken) = case.limits.too_slow(ratio) {
                report.broken.push(broken);
                report.outcome = Outcome::Broken;
            }
        }
        Err(error) => report.fail(&error),
    }
}
