//! All cases: side by side first, those with a limit of time alone afterwards.

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
use realitysim_log_input::scene_source::{self, SceneSourceError};
use realitysim_recording::{Loss, Readout, ReadoutError, read_tags};
use realitysim_tagging::{FrameCacheOptions, ReplayError, ReplayOptions, replay};

#[derive(Clone, Debug)]
pub struct Options {
    /// Where captures go, a folder for each case.
    pub captures: PathBuf,
    /// Cases at a time.
    pub jobs: usize,
}

#[derive(Clone, Debug, Serialize)]
pub struct CaseReport {
    pub name: String,
    pub source: PathBuf,
    pub outcome: Outcome,
    #[serde(flatten)]
    pub judged: Judged,
    /// None without a limit of time.
    pub p99_ratio: Option<f64>,
    pub broken: Vec<Broken>,
    /// Against the case's reference, if it has one.
    pub reference: Option<Verdict>,
    /// Why there is nothing to judge.
    pub error: Option<String>,
    /// What of the logs could not be read: it was not judged.
    pub lost: Vec<Loss>,
    /// Why what was judged may not be what it is taken for.
    pub warnings: Vec<String>,
    /// Its tags, if it was replayed.
    pub capture: Option<PathBuf>,
    pub wall_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    Kept,
    Broken,
    Failed,
}

/// Told whenever something is done: how many cases, of how many, and the one that is.
pub trait Watcher: Sync {
    fn done(&self, done: usize, total: usize, report: &CaseReport);

    /// A case is about to run alone.
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

/// In the order of the suite.
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
    /// Nothing stands against it.
    pub fn passed(&self) -> bool {
        self.outcome == Outcome::Kept && self.lost.is_empty()
    }

    fn found<T>(&mut self, read: Readout<T>) -> Vec<T> {
        self.lose(read.losses);
        self.warnings.extend(read.warnings);
        read.found
    }

    /// A file may be read more than once.
    fn lose(&mut self, losses: Vec<Loss>) {
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
    // Before long work. What cannot be read then will not be later.
    let reference = case.reference.as_deref().map(Reference::load).transpose()?;
    // A log that is only held to a reference need not know the truth.
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
    report.lose(replayed.unread());
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

/// Of the log that the judged process was given: the one with the truth, as a rule; else of its output. Where neither has
/// images that matters only if there is a limit on them.
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

fn truth_of(case: &Case, settings: &Settings, report: &mut CaseReport) -> Result<Vec<(i64, Isometry)>, CaseError> {
    if case.truth.is_none() && case.source.extension().is_some_and(|ending| ending == "toml") {
        return Ok(truth::of_scene(&scene_source::load(&case.source)?));
    }
    let log = case.truth.as_ref().unwrap_or(&case.source);
    Ok(report.found(read_truth(log, &settings.topics.ground_truth)?))
}

/// Nothing else runs meanwhile.
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
