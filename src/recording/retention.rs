//! What may stay on the robot's disk: nothing goes that a dev machine has not acknowledged.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::acknowledged::acknowledged;
use super::error::RecordingError;
use super::folder::manifest_lines;
use super::manifest::{EVICTED_FILE, MANIFEST_FILE, ManifestLine, PINNED_FILE, SESSION_FILE};
use super::segment::segment_index;
use super::shared::Allowed;
use super::status::{RecorderStatus, Stopped};
use super::storage::{Appending, Listed, ListedKind, Space, Storage, read_small};
use crate::config::RecordingSettings;

/// Of the config, in bytes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Limits {
    captures: PathBuf,
    floor_bytes: u64,
    floor_share: f64,
    session_bytes: u64,
    total_bytes: u64,
}

/// A line of `evicted.jsonl`: what was removed, and who has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Evicted {
    pub file: String,
    pub bytes: u64,
    pub blake3: String,
    pub receiver: String,
}

/// Below this share of the floor nothing is recorded any more, not even tags.
const HARD_SHARE: f64 = 0.25;
/// Fewer free inodes than this count as no room.
const FEWEST_INODES: u64 = 16;
/// Segments removed at one look, so that the recorder is not kept waiting.
const MAX_EVICTED_AT_ONCE: usize = 8;
/// Sessions that are looked through.
const MAX_SESSIONS: usize = 100_000;

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

    fn floor(&self, space: &Space) -> u64 {
        self.floor_bytes.max((space.total_bytes as f64 * self.floor_share) as u64)
    }
}

/// What a look at the disk found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Seen {
    pub allowed: Allowed,
    pub free_bytes: Option<u64>,
    pub evicted: Vec<Evicted>,
}

impl Seen {
    pub fn tell(&self, status: &mut RecorderStatus) {
        status.free_bytes = self.free_bytes;
        status.stopped = match self.allowed {
            Allowed::All => None,
            Allowed::NoFrames(cause) => Some(Stopped { cause, frames_only: true }),
            Allowed::Nothing(cause) => Some(Stopped { cause, frames_only: false }),
        };
        status.evicted_segments += self.evicted.len() as u64;
        status.evicted_bytes += self.evicted.iter().map(|evicted| evicted.bytes).sum::<u64>();
    }
}

pub(super) struct Retention {
    storage: Arc<dyn Storage>,
    limits: Limits,
}

impl Retention {
    pub fn new(storage: Arc<dyn Storage>, limits: Limits) -> Self {
        Self { storage, limits }
    }

    /// Makes room if there is too little, as far as that is allowed. A disk that does not answer stops nothing here: the
    /// recorder's own writes tell what is wrong.
    pub fn look(&self, session: Option<&Path>) -> Seen {
        let mut seen = Seen::default();
        for _ in 0..MAX_EVICTED_AT_ONCE {
            let (allowed, free_bytes) = self.judge(session);
            (seen.allowed, seen.free_bytes) = (allowed, free_bytes);
            if allowed == Allowed::All || !frees_by_eviction(allowed) {
                break;
            }
            match self.evict_one() {
                Some(evicted) => seen.evicted.push(evicted),
                None => break,
            }
        }
        seen
    }

    fn judge(&self, session: Option<&Path>) -> (Allowed, Option<u64>) {
        let Limits { captures, session_bytes, total_bytes, .. } = &self.limits;
        let Ok(space) = self.storage.space(captures) else { return (Allowed::All, None) };
        let floor = self.limits.floor(&space);
        let free = space.free_bytes;
        let over = |limit: u64, used: &dyn Fn() -> u64| limit > 0 && used() >= limit;
        let allowed = if free < (floor as f64 * HARD_SHARE) as u64 {
            Allowed::Nothing("disk_full")
        } else if free < floor {
            Allowed::NoFrames("disk_full")
        } else if space.free_inodes < FEWEST_INODES {
            Allowed::NoFrames("no_inodes")
        } else if over(*total_bytes, &|| self.used()) {
            Allowed::NoFrames(TOTAL_QUOTA)
        } else if session.is_some_and(|session| over(*session_bytes, &|| self.used_by(session))) {
            Allowed::NoFrames(SESSION_QUOTA)
        } else {
            Allowed::All
        };
        (allowed, Some(free))
    }

    fn used(&self) -> u64 {
        self.sessions().iter().map(|session| self.used_by(session)).sum()
    }

    fn used_by(&self, session: &Path) -> u64 {
        let files = self.storage.list(session).unwrap_or_default();
        files.iter().filter(|file| file.kind == ListedKind::File).map(|file| file.bytes).sum()
    }

    /// Oldest first: a session's name begins with its time.
    fn sessions(&self) -> Vec<PathBuf> {
        let captures = &self.limits.captures;
        let folders = self.storage.list(captures).unwrap_or_default().into_iter();
        let folders = folders.filter(|entry| entry.kind == ListedKind::Folder).take(MAX_SESSIONS);
        folders.map(|entry| captures.join(entry.name)).collect()
    }

    /// The oldest segment that may go: of a session that is pinned only if no other is left.
    fn evict_one(&self) -> Option<Evicted> {
        let sessions: Vec<_> = self.sessions().into_iter().map(|path| Candidates::of(&self.storage, path)).collect();
        let (pinned, others): (Vec<_>, Vec<_>) = sessions.into_iter().flatten().partition(|session| session.pinned);
        others.iter().chain(&pinned).find_map(|session| session.evict_oldest(&self.storage))
    }
}

const TOTAL_QUOTA: &str = "total_quota";
const SESSION_QUOTA: &str = "session_quota";

/// More room for one session is not made by removing others.
fn frees_by_eviction(allowed: Allowed) -> bool {
    allowed != Allowed::NoFrames(SESSION_QUOTA)
}

/// Segments of one session that a dev machine has.
struct Candidates {
    session: PathBuf,
    pinned: bool,
    segments: Vec<(ManifestLine, String)>,
}

impl Candidates {
    fn of(storage: &Arc<dyn Storage>, session: PathBuf) -> Option<Self> {
        let files = storage.list(&session).ok()?;
        let is_file = |name: &str| find(&files, name).is_some();
        if !is_file(SESSION_FILE) || !is_file(MANIFEST_FILE) {
            return None;
        }
        let receivers = acknowledged(storage.as_ref(), &session);
        if receivers.is_empty() {
            return None;
        }
        let lines = manifest_lines(storage.as_ref(), &session).ok()?;
        let mut segments = Vec::new();
        for line in lines {
            // Only what this program has written and still stands there as it was.
            let there = find(&files, &line.name).is_some_and(|file| file.bytes == line.bytes);
            let receiver = receivers.get(&(line.name.clone(), line.blake3.clone(), line.bytes));
            if let (true, Some(receiver), Some(_)) = (there, receiver, segment_index(&line.name)) {
                segments.push((line, receiver.clone()));
            }
        }
        segments.sort_by_key(|(line, _)| segment_index(&line.name));
        Some(Self { pinned: is_file(PINNED_FILE), session, segments })
    }

    fn evict_oldest(&self, storage: &Arc<dyn Storage>) -> Option<Evicted> {
        self.segments.iter().find_map(|(line, receiver)| {
            let evicted = Evicted {
                file: line.name.clone(),
                bytes: line.bytes,
                blake3: line.blake3.clone(),
                receiver: receiver.clone(),
            };
            // Whatever fails, nothing is lost: it is noted first, and a file that is still there is not gone.
            note(storage, &self.session, &evicted).ok()?;
            storage.remove(&self.session.join(&line.name)).ok()?;
            storage.sync_folder(&self.session).ok()?;
            Some(evicted)
        })
    }
}

fn find<'a>(files: &'a [Listed], name: &str) -> Option<&'a Listed> {
    files.iter().find(|file| file.name == name && file.kind == ListedKind::File)
}

fn note(storage: &Arc<dyn Storage>, session: &Path, evicted: &Evicted) -> Result<(), RecordingError> {
    let path = session.join(EVICTED_FILE);
    let failed = |source| RecordingError::io(&path, source);
    if evicted_segments(storage.as_ref(), session).contains_key(&evicted.file) {
        return Ok(());
    }
    let mut text = serde_json::to_vec(evicted)?;
    text.push(b'\n');
    let file = match storage.append(&path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => storage.create(&path),
        file => file,
    };
    let file = file.map_err(failed)?;
    // Behind a line that was torn.
    let text = [b"\n".as_slice(), &text].concat();
    std::io::Write::write_all(&mut Appending(Arc::clone(&file)), &text).and_then(|()| file.sync()).map_err(failed)?;
    storage.sync_folder(session).map_err(failed)
}

/// A larger file of this kind is not read to its end.
const MAX_EVICTED_BYTES: u64 = 16 << 20;

/// What was removed from a session because somebody has it.
pub(super) fn evicted_segments(storage: &dyn Storage, session: &Path) -> BTreeMap<String, Evicted> {
    let bytes = read_small(storage, &session.join(EVICTED_FILE), MAX_EVICTED_BYTES).ok().flatten().unwrap_or_default();
    let lines = bytes.split(|byte| *byte == b'\n');
    let evicted = lines.filter_map(|line| serde_json::from_slice::<Evicted>(line).ok());
    evicted.map(|evicted| (evicted.file.clone(), evicted)).collect()
}
