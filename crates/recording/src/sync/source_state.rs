//! What is known of a source: what its sessions say of themselves (`known/`), what is not whole yet (`incoming/`), and when it
//! was last looked at.

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
use crate::catalogue::sessions_in;
use crate::storage::read_plain;
use crate::{ACK_ENDING, ACK_FOLDER, SYNC_FOLDER, Session, SessionId, write_atomically};

/// One source's place; nobody else has it as long as this lives.
#[derive(Debug)]
pub struct SourceState {
    pub known: PathBuf,
    pub incoming: PathBuf,
    _lock: File,
}

/// A source that was synced from before.
#[derive(Debug)]
pub struct KnownSource {
    pub source: String,
    /// When it was last looked at, by this machine's clock.
    pub seen: Option<Timestamp>,
    /// As they were then.
    pub sessions: Vec<Session>,
    /// Those that were ended then: no segment comes any more.
    pub ended: BTreeSet<SessionId>,
}

#[derive(Serialize, Deserialize)]
struct SourceNote {
    source: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    seen: Option<String>,
    /// Sessions with a segment that was being written.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    open: Vec<String>,
}

const SOURCE_FILE: &str = "source.json";
/// For what a sync that was killed left running.
const MAX_WAIT: Duration = Duration::from_secs(5);

impl SourceState {
    /// Waits for a sync of the same source to end, but not for long.
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
        // rsync inherits it: if we are killed and it is not, nobody touches the files that it still writes.
        rustix::io::fcntl_setfd(&lock, rustix::io::FdFlags::empty()).map_err(|error| io(&path)(error.into()))?;
        let desk = Self { known, incoming, _lock: lock };
        if !place.join(SOURCE_FILE).exists() {
            desk.note(&SourceNote { source: source.shown(), seen: None, open: Vec::new() })?;
        }
        Ok(desk)
    }

    /// What the source was known to have been told.
    pub(super) fn forget_acknowledgements(&self) -> Result<(), SyncError> {
        for session in fs::read_dir(&self.known).into_iter().flatten().flatten() {
            let acks = session.path().join(ACK_FOLDER);
            if fs::symlink_metadata(&acks).is_ok_and(|it| it.is_dir()) {
                fs::remove_dir_all(&acks).map_err(io(&acks))?;
            }
        }
        Ok(())
    }

    /// What the source looked like just now.
    pub(super) fn note_seen(&self, source: &Source, there: &[Session]) -> Result<(), SyncError> {
        let open = there.iter().filter(|session| session.open).map(|session| session.id.as_str().to_owned());
        self.note(&SourceNote {
            source: source.shown(),
            seen: Some(Timestamp::now().to_string()),
            open: open.collect(),
        })
    }

    fn note(&self, note: &SourceNote) -> Result<(), SyncError> {
        let text = serde_json::to_vec(note).map_err(crate::RecordingError::from)?;
        Ok(write_atomically(&self.known.with_file_name(SOURCE_FILE), &text)?)
    }

    /// An empty file of the name of our acknowledgements.
    pub(super) fn nothing(&self, receiver: &str) -> PathBuf {
        self.known.with_file_name(format!("{receiver}{ACK_ENDING}"))
    }
}

/// What was known at the last sync of each source that this folder was filled from; nothing of a folder that was not.
pub fn known_sources(captures: &Path) -> Vec<KnownSource> {
    let mut all = Vec::new();
    for place in fs::read_dir(captures.join(SYNC_FOLDER)).into_iter().flatten().flatten() {
        let Ok(bytes) = read_plain(&place.path().join(SOURCE_FILE), MAX_SMALL_BYTES) else { continue };
        let Ok(SourceNote { source, seen, open }) = serde_json::from_slice(&bytes) else { continue };
        let Ok((sessions, _)) = sessions_in(&place.path().join("known")) else { continue };
        // Written last of all, by whoever recorded, repaired or fetched the whole of it.
        let has_ended = |it: &&Session| !open.iter().any(|id| id == it.id.as_str()) && it.has_ended;
        let ended = sessions.iter().filter(has_ended).map(|session| session.id.clone()).collect();
        all.push(KnownSource { source, seen: seen.and_then(|text| text.parse().ok()), sessions, ended });
    }
    all.sort_by(|a, b| a.source.cmp(&b.source));
    all
}
