//! What may stay on the robot's disk: the recorder makes room, but removes nothing that no other store has
//! acknowledged.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::acknowledgement::receiver_on;
use super::deletion_rules::releasable;
use super::error::RecordingError;
use super::manifest::{EVICTED_FILE, ManifestLine};
use super::record_queue::Allowed;
use super::sessions::{Session, sessions_on};
use super::status::{RecorderStatus, Stopped};
use super::storage::{Appending, Kind, Listed, Space, Storage, read_small};
use realitysim_config::RecordingSettings;

/// Limits of the disk's use, from the settings, in bytes; 0 means no limit.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Limits {
    captures: PathBuf,
    floor_bytes: u64,
    floor_share: f64,
    session_bytes: u64,
    total_bytes: u64,
}

/// A line of `evicted.jsonl`: a segment that was removed, and the store that has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Evicted {
    /// Name of the segment.
    pub file: String,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// BLAKE3 hash of the file, hexadecimal.
    pub blake3: String,
    /// The store that has it, by its name as a receiver.
    pub receiver: String,
}

/// Share of a quota from which on frames are left out. Tags and measurements have the rest; at the quota nothing is
/// written.
const FRAMES_SHARE: f64 = 0.9;
/// Share of the floor below which nothing is recorded, not even tags.
const HARD_SHARE: f64 = 0.25;
/// Free inodes below which the disk counts as full.
const MIN_FREE_INODES: u64 = 16;
/// Most segments removed in one check, so that the recorder is not delayed.
const MAX_EVICTED_AT_ONCE: usize = 8;
/// Most sessions whose sizes are summed up.
const MAX_SESSIONS: usize = 100_000;
/// Least time between two searches through all sessions, while no segment may be removed.
const SEARCH_EVERY: Duration = Duration::from_secs(10);

impl Limits {
    pub fn new(captures: &Path, settings: &RecordingSettings) -> Self {
        Self {
            captures: captures.to_owned(),
            floor_bytes: settings.floor_mb << 20,
            floor_share: settings.floor_percent / 100.0,
            session_bytes: settings.session_mb << 20,
            total_bytes: settings.total_mb << 20,
        }
    }

    /// Free bytes that are to be kept on a disk of this size.
    fn floor(&self, space: &Space) -> u64 {
        self.floor_bytes.max((space.total_bytes as f64 * self.floor_share) as u64)
    }
}

/// Result of a check of the disk.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct SpaceCheck {
    /// What may be written.
    pub allowed: Allowed,
    /// Free bytes; `None` if the disk does not say.
    pub free_bytes: Option<u64>,
    /// Segments that were removed.
    pub evicted: Vec<Evicted>,
}

impl SpaceCheck {
    /// Writes the result into the recorder's status.
    pub fn report_to(&self, status: &mut RecorderStatus) {
        status.free_bytes = self.free_bytes;
        status.stopped = match self.allowed {
            Allowed::All => None,
            Allowed::NoFrames(cause) => Some(Stopped { cause: cause.to_owned(), frames_only: true }),
            Allowed::Nothing(cause) => Some(Stopped { cause: cause.to_owned(), frames_only: false }),
        };
        status.evicted_segments += self.evicted.len() as u64;
        status.evicted_bytes += self.evicted.iter().map(|evicted| evicted.bytes).sum::<u64>();
    }
}

/// Watches the room on the disk and removes acknowledged segments when there is too little.
pub(super) struct Retention {
    storage: Arc<dyn Storage>,
    limits: Limits,
    /// When a search found no segment that may be removed.
    last_futile_search: Option<Duration>,
}

impl Retention {
    pub fn new(storage: Arc<dyn Storage>, limits: Limits) -> Self {
        Self { storage, limits, last_futile_search: None }
    }

    /// Checks the room on the disk, and makes room as far as that is allowed.
    ///
    /// A disk that does not answer allows everything here: the recorder's own writes tell what is wrong.
    pub fn check_space(&mut self, session: Option<&Path>) -> SpaceCheck {
        let mut seen = SpaceCheck::default();
        (seen.allowed, seen.free_bytes) = self.judge(session);
        if seen.allowed == Allowed::All || !frees_by_eviction(seen.allowed) {
            return seen;
        }
        // While a prune or a sync holds the lock, nothing is removed: it might be about to delete the other copy. The
        // next check tries again.
        let Ok(Some(_turn)) = self.storage.lock(&self.limits.captures) else { return seen };
        for eviction in self.evictable_segments() {
            let Ok(evicted) = eviction.evict(self.storage.as_ref()) else { continue };
            seen.evicted.push(evicted);
            (seen.allowed, seen.free_bytes) = self.judge(session);
            if seen.allowed == Allowed::All || seen.evicted.len() >= MAX_EVICTED_AT_ONCE {
                break;
            }
        }
        seen
    }

    /// Compares free room and quotas with their limits.
    fn judge(&self, session: Option<&Path>) -> (Allowed, Option<u64>) {
        let Limits { captures, session_bytes, total_bytes, .. } = &self.limits;
        let Ok(space) = self.storage.space(captures) else { return (Allowed::All, None) };
        let floor = self.limits.floor(&space);
        let free = space.free_bytes;
        let of_all = share(*total_bytes, || self.used());
        let of_session = session.map_or(0.0, |session| share(*session_bytes, || self.used_by(session)));
        let allowed = if free < (floor as f64 * HARD_SHARE) as u64 {
            Allowed::Nothing("disk_full")
        } else if of_all >= 1.0 {
            Allowed::Nothing(TOTAL_QUOTA)
        } else if of_session >= 1.0 {
            Allowed::Nothing(SESSION_QUOTA)
        } else if free < floor {
            Allowed::NoFrames("disk_full")
        } else if space.free_inodes < MIN_FREE_INODES {
            Allowed::NoFrames("no_inodes")
        } else if of_all >= FRAMES_SHARE {
            Allowed::NoFrames(TOTAL_QUOTA)
        } else if of_session >= FRAMES_SHARE {
            Allowed::NoFrames(SESSION_QUOTA)
        } else {
            Allowed::All
        };
        (allowed, Some(free))
    }

    /// Bytes of all sessions.
    fn used(&self) -> u64 {
        let folders = self.storage.list(&self.limits.captures).unwrap_or_default().into_iter();
        let folders = folders.filter(|entry| entry.kind == Kind::Folder).take(MAX_SESSIONS);
        folders.map(|entry| self.used_by(&self.limits.captures.join(entry.name))).sum()
    }

    /// Bytes of one session.
    fn used_by(&self, session: &Path) -> u64 {
        self.storage.list(session).unwrap_or_default().iter().filter_map(Listed::bytes).sum()
    }

    /// Segments that may be removed, in the order of removal.
    fn evictable_segments(&mut self) -> VecDeque<Eviction> {
        let now = self.storage.now();
        if self.last_futile_search.is_some_and(|searched| now.saturating_sub(searched) < SEARCH_EVERY) {
            return VecDeque::new();
        }
        let captures = &self.limits.captures;
        let sessions = sessions_on(self.storage.as_ref(), captures).map(|(sessions, _)| sessions).unwrap_or_default();
        let own = receiver_on(self.storage.as_ref(), captures);
        let going = releasable(&sessions, own.as_deref()).into_iter().flat_map(|of| {
            let going = |(line, receiver)| Eviction::new(of.session, line, receiver);
            of.segments.into_iter().map(going).collect::<Vec<_>>()
        });
        let going: VecDeque<Eviction> = going.take(2 * MAX_EVICTED_AT_ONCE).collect();
        self.last_futile_search = going.is_empty().then_some(now);
        going
    }
}

const TOTAL_QUOTA: &str = "total_quota";
const SESSION_QUOTA: &str = "session_quota";

/// Whether removing other sessions' segments can help; it does not help against the quota of one session.
fn frees_by_eviction(allowed: Allowed) -> bool {
    !matches!(allowed, Allowed::NoFrames(SESSION_QUOTA) | Allowed::Nothing(SESSION_QUOTA))
}

/// Used share of a limit; 0 where there is no limit.
fn share(limit: u64, used: impl FnOnce() -> u64) -> f64 {
    if limit == 0 { 0.0 } else { used() as f64 / limit as f64 }
}

/// A segment that may be removed.
struct Eviction {
    session: PathBuf,
    evicted: Evicted,
}

impl Eviction {
    fn new(session: &Session, line: &ManifestLine, receiver: &str) -> Self {
        let evicted = Evicted {
            file: line.name.clone(),
            bytes: line.bytes,
            blake3: line.blake3.clone(),
            receiver: receiver.to_owned(),
        };
        Self { session: session.folder.clone(), evicted }
    }

    /// Notes the removal, then removes the file. If either fails, nothing is lost: a file that is still there does
    /// not count as removed.
    fn evict(self, storage: &dyn Storage) -> Result<Evicted, RecordingError> {
        note(storage, &self.session, &self.evicted)?;
        let path = self.session.join(&self.evicted.file);
        let removed = storage.remove(&path).and_then(|()| storage.sync_folder(&self.session));
        removed.map_err(|source| RecordingError::io(&path, source))?;
        Ok(self.evicted)
    }
}

/// Appends a line to `evicted.jsonl`, if it is not there already.
fn note(storage: &dyn Storage, session: &Path, evicted: &Evicted) -> Result<(), RecordingError> {
    let path = session.join(EVICTED_FILE);
    let failed = |source| RecordingError::io(&path, source);
    if evicted_segments(storage, session).get(&evicted.file) == Some(evicted) {
        return Ok(());
    }
    let mut text = serde_json::to_vec(evicted)?;
    text.push(b'\n');
    let file = match storage.append(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => storage.create(&path),
        file => file,
    };
    let file = file.map_err(failed)?;
    // The line feed in front ends a line that a power cut has torn.
    let text = [b"\n".as_slice(), &text].concat();
    std::io::Write::write_all(&mut Appending(Arc::clone(&file)), &text).and_then(|()| file.sync()).map_err(failed)?;
    storage.sync_folder(session).map_err(failed)
}

/// Largest `evicted.jsonl` that is read, bytes.
const MAX_EVICTED_BYTES: u64 = 16 << 20;

/// Segments of a session that were removed because another store has them.
pub(super) fn evicted_segments(storage: &dyn Storage, session: &Path) -> BTreeMap<String, Evicted> {
    let bytes = read_small(storage, &session.join(EVICTED_FILE), MAX_EVICTED_BYTES).ok().flatten().unwrap_or_default();
    let lines = bytes.split(|byte| *byte == b'\n');
    let evicted = lines.filter_map(|line| serde_json::from_slice::<Evicted>(line).ok());
    evicted.map(|evicted| (evicted.file.clone(), evicted)).collect()
}
