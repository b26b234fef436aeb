//! What became of the sessions of a job, for people and for programs.

use std::path::PathBuf;

use serde::Serialize;
use serde_json::Value;

use super::super::{Outcome, output};

/// What a job has done.
#[derive(Serialize)]
pub(super) struct Report {
    pub(super) step: &'static str,
    pub(super) shard: String,
    /// Number of sessions in the folder, those of other shards included.
    pub(super) sessions: usize,
    /// Folder of the results.
    pub(super) results: PathBuf,
    pub(super) units: Vec<UnitReport>,
}

/// What became of one session.
#[derive(Serialize)]
pub(super) struct UnitReport {
    pub(super) session: String,
    pub(super) state: State,
    /// Folder of its result; `None` if it failed.
    pub(super) folder: Option<PathBuf>,
    pub(super) summary: Value,
    pub(super) losses: Vec<String>,
    pub(super) error: Option<String>,
    pub(super) wall_s: f64,
}

/// State of a session's result.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum State {
    /// It was made now.
    Done,
    /// It was there before.
    Present,
    /// There is none.
    Failed,
}

impl State {
    pub(super) fn word(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Present => "was there",
            Self::Failed => "FAILED",
        }
    }
}

impl Report {
    pub(super) fn outcome(&self) -> Outcome {
        let failed = self.units.iter().any(|unit| unit.state == State::Failed);
        match (failed, self.units.iter().all(|unit| unit.losses.is_empty())) {
            (true, _) => Outcome::NotReached,
            (false, false) => Outcome::DataLost,
            (false, true) => Outcome::Whole,
        }
    }

    pub(super) fn print(&self, json: bool) -> anyhow::Result<()> {
        for unit in &self.units {
            let problems = unit.error.iter().chain(&unit.losses);
            problems.for_each(|problem| output::say(&format!("{}: {problem}", unit.session)));
        }
        if json { output::json(self) } else { output::lines(&self.for_people()) }
    }

    fn for_people(&self) -> String {
        let width = self.units.iter().map(|unit| unit.session.chars().count()).max().unwrap_or(0);
        let line = |unit: &UnitReport| {
            let what = unit.error.clone().unwrap_or_else(|| in_words(&unit.summary));
            format!("{:<width$}  {:<9}  {what}\n", unit.session, unit.state.word())
        };
        let lines: String = self.units.iter().map(line).collect();
        let count = |state: State| self.units.iter().filter(|unit| unit.state == state).count();
        let [done, present, failed] = [State::Done, State::Present, State::Failed].map(count);
        let (step, shard, results) = (self.step, &self.shard, self.results.display());
        format!(
            "{lines}{step}: {done} done, {present} there before, {failed} failed; shard {shard} has {} of {} sessions; {results}",
            self.units.len(),
            self.sessions
        )
    }
}

/// The numbers of a summary on one line.
fn in_words(summary: &Value) -> String {
    let Some(fields) = summary.as_object() else { return String::new() };
    let is_shown = |value: &Value| value.is_number() || value.is_boolean();
    let shown = fields.iter().filter(|(_, value)| is_shown(value)).map(|(name, value)| format!("{name} {value}"));
    shown.collect::<Vec<_>>().join(", ")
}
