//! What is about to be cut off, written down first: a repair that is killed half-way leaves files that look whole, and the
//! next one tells what they have lost all the same.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::super::error::RecordingError;
use super::super::storage::{Storage, read_small, write_atomically};

/// In the session's folder while it is being repaired.
pub(crate) const NOTES_FILE: &str = "repairing.json";
/// A segment takes some hundred bytes of it.
const MAX_NOTES_BYTES: u64 = 4 << 20;

/// What a segment loses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Cut {
    pub(super) bytes: u64,
    pub(super) damage: Option<String>,
}

impl Cut {
    pub(super) fn said(&self) -> String {
        let what = self.damage.as_ref().map_or(String::new(), |damage| format!(" ({damage})"));
        format!("{} bytes of it could not be kept{what}", self.bytes)
    }
}

pub(super) struct Notes<'a> {
    storage: &'a dyn Storage,
    path: PathBuf,
    cuts: BTreeMap<String, Cut>,
}

impl<'a> Notes<'a> {
    /// Of a repair that did not come to its end. What is no such file says nothing.
    pub(super) fn read(storage: &'a dyn Storage, session: &Path) -> Self {
        let path = session.join(NOTES_FILE);
        let text = read_small(storage, &path, MAX_NOTES_BYTES).ok().flatten();
        let cuts = text.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default();
        Self { storage, path, cuts }
    }

    pub(super) fn of(&self, segment: &str) -> Option<&Cut> {
        self.cuts.get(segment)
    }

    /// By segment.
    pub(super) fn all(&self) -> impl Iterator<Item = (&str, &Cut)> {
        self.cuts.iter().map(|(segment, cut)| (segment.as_str(), cut))
    }

    /// The larger of what is noted and of `cut`, which is noted before anything is touched. A disk without room for a note
    /// stops no repair: then what a killed one has cut is not told.
    pub(super) fn note(&mut self, segment: &str, cut: Cut) -> Result<Cut, RecordingError> {
        match self.cuts.get(segment) {
            Some(known) if known.bytes >= cut.bytes => return Ok(known.clone()),
            _ if cut.bytes == 0 => return Ok(cut),
            _ => drop(self.cuts.insert(segment.to_owned(), cut.clone())),
        }
        let _ = write_atomically(self.storage, &self.path, &serde_json::to_vec(&self.cuts)?);
        Ok(cut)
    }

    /// All that is noted stands in the manifest.
    pub(super) fn forget(self) -> Result<(), RecordingError> {
        if read_small(self.storage, &self.path, u64::MAX).is_ok_and(|text| text.is_none()) {
            return Ok(());
        }
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let removed = self.storage.remove(&self.path).and_then(|()| self.storage.sync_folder(folder));
        removed.map_err(|source| RecordingError::io(&self.path, source))
    }
}
