//! A suite: logs and scenes, each with limits that its tags must keep. What `realitysim check` runs.

mod file;
mod judge;
mod limits;
mod run;
mod timing;

pub use file::{Case, Suite, SuiteError};
pub use judge::{Judged, Recovery, judge};
pub use limits::{Broken, Limits};
pub use run::{CaseReport, Options, Outcome, Watcher, run};
