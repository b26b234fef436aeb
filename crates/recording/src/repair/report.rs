//! Report of a repair.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use super::super::folder::Loss;
use super::super::sessions::SetAside;

/// What was done to one session.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Repaired {
    /// Folder of the session.
    pub session: PathBuf,
    /// Whether the session is being recorded: then nothing was touched.
    pub in_use: bool,
    /// Segments that were finished.
    pub finished: Vec<String>,
    /// Unfinished files without a message that were removed.
    pub removed: Vec<String>,
    /// Segments that were added to the manifest.
    pub listed: Vec<String>,
    /// Whether the manifest was written anew.
    pub manifest_rewritten: bool,
    /// Whether `metadata.yaml` was written anew.
    pub metadata_rewritten: bool,
    /// What stays in the folder, some of it under another name, for people to look at, and why.
    pub set_aside: Vec<SetAside>,
    /// What could not be kept.
    pub lost: Vec<Loss>,
    /// What is not as the manifest says and cannot be mended; it is left as it is.
    pub wrong: Vec<Loss>,
}

impl Repaired {
    /// Whether the repair changed nothing.
    pub fn changed_nothing(&self) -> bool {
        let wrong = self.wrong.clone();
        *self == Self { session: self.session.clone(), in_use: self.in_use, wrong, ..Self::default() }
    }
}

/// Says it in words, over several lines.
impl fmt::Display for Repaired {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { session, in_use, finished, removed, listed, set_aside, lost, wrong, .. } = self;
        let state = match (in_use, self.changed_nothing()) {
            (true, _) => "is being recorded",
            (false, _) if !wrong.is_empty() => "not whole",
            (false, true) => "whole",
            (false, false) => "repaired",
        };
        write!(f, "{}: {state}", session.display())?;
        let parts = [("finished", finished), ("without a message, removed", removed), ("now in the manifest", listed)];
        for (what, names) in parts.into_iter().filter(|(_, names)| !names.is_empty()) {
            write!(f, "\n  {what}: {}", names.join(", "))?;
        }
        set_aside.iter().try_for_each(|aside| write!(f, "\n  set aside: {aside}"))?;
        lost.iter().try_for_each(|loss| write!(f, "\n  lost: {loss}"))?;
        wrong.iter().try_for_each(|wrong| write!(f, "\n  {wrong}"))
    }
}
