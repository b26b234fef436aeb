//! Suites: logs and scenes, each with limits that its tags must keep. What `realitysim check` runs.
//!
//! [`Suite`] is the file with its [`Case`]s and [`Limits`], [`run`](fn@run) runs it, [`judge`](fn@judge) and
//! [`judge_poses`] compare one case with the truth.

mod file;
mod judge;
mod limits;
mod run;
mod timing;

pub use file::{Case, Suite, SuiteError};
pub use judge::{Judged, Recovery, judge, judge_poses};
pub use limits::{Broken, LOWER_LIMITS, Limits};
pub use run::{CaseReport, Options, Outcome, Watcher, run};
