//! The journal of a repair: what is about to be cut off is noted first.
//!
//! A repair that is killed halfway leaves files that look whole; the next one reads from the journal what they have
//! lost.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::super::error::RecordingError;
use super::super::storage::{Storage, read_small, write_atomically};

/// File in the session's folder while it is being repaired.
pub(crate) const JOURNAL_FILE: &str = "repairing.json";
/// Largest journal, bytes: a segment takes some hundred bytes of it.
const MAX_NOTES_BYTES: u64 = 4 << 20;

/// What a segment loses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Cut {
    /// Bytes that cannot be kept.
    pub(super) bytes: u64,
    /// What is damaged, in words.
    pub(super) damage: Option<String>,
}

impl Cut {
    /// Describes the loss for people.
    pub(super) fn describe(&self) -> String {
        let what = self.damage.as_ref().map_or(String::new(), |damage| format!(" ({damage})"));
        format!("{} bytes of it could not be kept{what}", self.bytes)
    }
}

/// The journal of the repair of one session.
pub(super) struct RepairJournal<'a> {
    storage: &'a dyn Storage,
    path: PathBuf,
    cuts: BTreeMap<String, Cut>,
}

impl<'a> RepairJournal<'a> {
    /// Reads the journal of a repair that did not come to its end; a file that makes no sense counts as empty.
    pub(super) fn read(storage: &'a dyn Storage, session: &Path) -> Self {
        let path = session.join(JOURNAL_FILE);
        let text = read_small(storage, &path, MAX_NOTES_BYTES).ok().flatten();
        let cuts = text.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        Self { storage, path, cuts }
    }

    /// Loss that is noted for a segment.
    pub(super) fn of(&self, segment: &str) -> Option<&Cut> {
        self.cuts.get(segment)
    }

    /// All losses, by segment.
    pub(super) fn all(&self) -> impl Iterator<Item = (&str, &Cut)> {
        self.cuts.iter().map(|(segment, cut)| (segment.as_str(), cut))
    }

    /// Notes a loss before anything is touched, and returns it, or the larger one that is noted already.
    ///
    /// A disk without room for the journal stops no repair: then the loss of a repair that is killed is not reported.
    pub(super) fn note(&mut self, segment: &str, cut: Cut) -> Result<Cut, RecordingError> {
        match self.cuts.get(segment) {
            Some(known) if known.bytes >= cut.bytes => return Ok(known.clone()),
            _ if cut.bytes == 0 => return Ok(cut),
            _ => drop(self.cuts.insert(segment.to_owned(), cut.clone())),
        }
        let _ = write_atomically(self.storage, &self.path, &serde_json::to_vec(&self.cuts)?);
        Ok(cut)
    }

    /// Removes the journal, once the manifest says everything that it notes.
    pub(super) fn forget(self) -> Result<(), RecordingError> {
        if read_small(self.storage, &self.path, u64::MAX).is_ok_and(|text| text.is_none()) {
            return Ok(());
        }
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let removed = self.storage.remove(&self.path).and_then(|()| self.storage.sync_folder(folder));
        removed.map_err(|source| RecordingError::io(&self.path, source))
    }
}
