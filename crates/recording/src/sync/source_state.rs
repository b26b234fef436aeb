//! What is known of a source: descriptions of its sessions (`known/`), segments that are not whole yet (`incoming/`),
//! and when it was last looked at.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use jiff::Timestamp;
use rustix::fs::FlockOperation;
use serde::{Deserialize, Serialize};

use super::error::{SyncError, io};
use super::source::Source;
use super::store::{MAX_SMALL_BYTES, own_file, real_folder};
use crate::sessions::sessions_in;
use crate::storage::read_plain;
use crate::{ACK_ENDING, ACK_FOLDER, SYNC_FOLDER, Session, SessionId, write_atomically};

/// The place of one source in a store. It is locked as long as this value lives.
#[derive(Debug)]
pub struct SourceState {
    /// Folder with the descriptions of the source's sessions.
    pub known: PathBuf,
    /// Folder with segments that are not whole yet.
    pub incoming: PathBuf,
    lock: File,
}

/// A source that was synced from before.
#[derive(Debug)]
pub struct KnownSource {
    /// The source, as people write it.
    pub source: String,
    /// When it was last looked at, by this machine's clock.
    pub seen: Option<Timestamp>,
    /// Its sessions as they were then.
    pub sessions: Vec<Session>,
    /// Those of its sessions that had ended then: they get no more segments.
    pub ended: BTreeSet<SessionId>,
}

/// Unlocks explicitly: closing the file is not enough while a process that was started meanwhile has inherited it.
impl Drop for SourceState {
    fn drop(&mut self) {
        let _ = self.lock.unlock();
    }
}

/// Content of `source.json`.
#[derive(Serialize, Deserialize)]
struct SourceNote {
    source: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    seen: Option<String>,
    /// Sessions that had a segment being written.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    open: Vec<String>,
}

/// File with a [`SourceNote`].
const SOURCE_FILE: &str = "source.json";
/// Longest time to wait for the rsync of a sync that was killed.
const MAX_WAIT: Duration = Duration::from_secs(5);

impl SourceState {
    /// Opens the place of a source. If another sync of the source is running, this waits for up to [`MAX_WAIT`].
    pub(super) fn open(state: &Path, source: &Source) -> Result<Self, SyncError> {
        let place = state.join(source.key());
        let (known, incoming) = (place.join("known"), place.join("incoming"));
        for folder in [&place, &known, &incoming] {
            fs::create_dir_all(folder).map_err(io(folder))?;
            real_folder(folder)?;
        }
        let path = place.join("lock");
        let lock = own_file(&path).map_err(io(&path))?;
        let began = Instant::now();
        while rustix::fs::flock(&lock, FlockOperation::NonBlockingLockExclusive).is_err() {
            if began.elapsed() > MAX_WAIT {
                return Err(SyncError::Busy(source.shown()));
            }
            std::thread::sleep(MAX_WAIT / 50);
        }
        // rsync inherits the lock: if this program is killed and rsync is not, nobody touches the files that rsync
        // still writes.
        rustix::io::fcntl_setfd(&lock, rustix::io::FdFlags::empty()).map_err(|error| io(&path)(error.into()))?;
        let source_state = Self { known, incoming, lock };
        if !place.join(SOURCE_FILE).exists() {
            source_state.note(&SourceNote { source: source.shown(), seen: None, open: Vec::new() })?;
        }
        Ok(source_state)
    }

    /// Deletes the copies of the source's acknowledgements.
    pub(super) fn forget_acknowledgements(&self) -> Result<(), SyncError> {
        for session in fs::read_dir(&self.known).into_iter().flatten().flatten() {
            let acks = session.path().join(ACK_FOLDER);
            if fs::symlink_metadata(&acks).is_ok_and(|it| it.is_dir()) {
                fs::remove_dir_all(&acks).map_err(io(&acks))?;
            }
        }
        Ok(())
    }

    /// Notes when the source was looked at, and which of its sessions were open.
    pub(super) fn note_seen(&self, source: &Source, there: &[Session]) -> Result<(), SyncError> {
        let open = there.iter().filter(|session| session.open).map(|session| session.id.as_str().to_owned());
        self.note(&SourceNote {
            source: source.shown(),
            seen: Some(Timestamp::now().to_string()),
            open: open.collect(),
        })
    }

    /// Writes `source.json`.
    fn note(&self, note: &SourceNote) -> Result<(), SyncError> {
        let text = serde_json::to_vec(note).map_err(crate::RecordingError::from)?;
        Ok(write_atomically(&self.known.with_file_name(SOURCE_FILE), &text)?)
    }

    /// Path of an empty file that replaces this store's acknowledgements at the source.
    pub(super) fn empty_acknowledgements(&self, receiver: &str) -> PathBuf {
        self.known.with_file_name(format!("{receiver}{ACK_ENDING}"))
    }
}

/// Lists the sources that a folder of captures was synced from, as they were at their last sync.
pub fn known_sources(captures: &Path) -> Vec<KnownSource> {
    let mut all = Vec::new();
    for place in fs::read_dir(captures.join(SYNC_FOLDER)).into_iter().flatten().flatten() {
        let Ok(bytes) = read_plain(&place.path().join(SOURCE_FILE), MAX_SMALL_BYTES) else { continue };
        let Ok(SourceNote { source, seen, open }) = serde_json::from_slice(&bytes) else { continue };
        let Ok((sessions, _)) = sessions_in(&place.path().join("known")) else { continue };
        // `metadata.yaml` is written last, by the recorder, by a repair, or by a sync that has everything.
        let has_ended = |it: &&Session| !open.iter().any(|id| id == it.id.as_str()) && it.has_ended;
        let ended = sessions.iter().filter(has_ended).map(|session| session.id.clone()).collect();
        all.push(KnownSource { source, seen: seen.and_then(|text| text.parse().ok()), sessions, ended });
    }
    all.sort_by(|a, b| a.source.cmp(&b.source));
    all
}
