//! Does a step with many sessions, some at a time.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use super::report::{State, UnitReport};
use super::result_folder::{ResultFolder, UnitRecord};
use super::session_name;
use super::step::Step;
use crate::cli::{error_text, output};
use crate::tagging::in_parallel;

/// Does a step with sessions, `workers` at a time, and returns what became of each, in their order.
pub(super) fn run_all(step: &Step, sessions: &[PathBuf], results: &Path, workers: usize) -> Vec<UnitReport> {
    let watch = Watch { bar: Mutex::new((output::Progress::new(step.doing()), 0)), all: sessions.len() };
    let done = AtomicUsize::new(0);
    let reports = in_parallel(workers, sessions.len(), |number| {
        let report = run_unit(step, &sessions[number], results, &mut watch.of_unit());
        watch.tell(done.fetch_add(1, Ordering::Relaxed) + 1, &report);
        report
    });
    watch.finish();
    reports
}

fn run_unit(step: &Step, session: &Path, results: &Path, progress: &mut dyn FnMut(u64)) -> UnitReport {
    let started = Instant::now();
    let (state, folder, record, error) = match result_of(step, session, results, progress) {
        Ok((state, folder, record)) => (state, Some(folder), Some(record), None),
        Err(error) => (State::Failed, None, None, Some(output::reword_system_errors(&error_text(&error)))),
    };
    let (summary, losses) = record.map_or_else(Default::default, |record| (record.summary, record.losses));
    let wall_s = started.elapsed().as_secs_f64();
    UnitReport { session: session_name(session), state, folder, summary, losses, error, wall_s }
}

/// The result of a session, made if it is not there.
fn result_of(
    step: &Step,
    session: &Path,
    results: &Path,
    progress: &mut dyn FnMut(u64),
) -> anyhow::Result<(State, PathBuf, UnitRecord)> {
    let folder = ResultFolder::of(step, session, results)?;
    if let Some(record) = folder.read()? {
        return Ok((State::Present, folder.path, record));
    }
    match folder.make(step, session, progress) {
        Ok(record) => Ok((State::Done, folder.path, record)),
        // Another process may have been faster, and have taken this one's folder away for one that nobody holds.
        Err(error) => match folder.read() {
            Ok(Some(record)) => Ok((State::Present, folder.path, record)),
            _ => Err(error),
        },
    }
}

/// A bar that counts the frames of all sessions together.
struct Watch {
    /// The bar and the number of frames done.
    bar: Mutex<(output::Progress, u64)>,
    all: usize,
}

impl Watch {
    /// The callback of one session.
    fn of_unit(&self) -> impl FnMut(u64) {
        let mut before = 0;
        move |done| {
            let mut bar = self.bar.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            bar.1 += done.saturating_sub(before);
            before = before.max(done);
            let frames = bar.1;
            bar.0.set(frames, None);
        }
    }

    fn tell(&self, done: usize, report: &UnitReport) {
        let bar = self.bar.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let UnitReport { session, state, wall_s, .. } = report;
        bar.0.line(&format!("{done}/{}  {session}  {} ({wall_s:.1} s)", self.all, state.word()));
    }

    fn finish(&self) {
        self.bar.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).0.finish();
    }
}
