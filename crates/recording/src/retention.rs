//! What may stay on the robot's disk: nothing goes that a dev machine has not acknowledged.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::acknowledgement::receiver_on;
use super::catalogue::{Session, sessions_on};
use super::error::RecordingError;
use super::manifest::{EVICTED_FILE, ManifestLine};
use super::record_queue::Allowed;
use super::release::releasable;
use super::status::{RecorderStatus, Stopped};
use super::storage::{Appending, Kind, Listed, Space, Storage, read_small};
use realitysim_config::RecordingSettings;

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

/// From this share of a quota on frames are left out: tags and measurements have the rest, and at the quota nothing is written.
const FRAMES_SHARE: f64 = 0.9;
/// Below this share of the floor nothing is recorded any more, not even tags.
const HARD_SHARE: f64 = 0.25;
/// Fewer free inodes than this count as no room.
const FEWEST_INODES: u64 = 16;
/// Segments removed at one look, so that the recorder is not kept waiting.
const MAX_EVICTED_AT_ONCE: usize = 8;
/// Sessions whose sizes are summed up.
const MAX_SESSIONS: usize = 100_000;
/// Where nothing may go, all sessions are looked through no more often than this.
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
    searched_in_vain: Option<Duration>,
}

impl Retention {
    pub fn new(storage: Arc<dyn Storage>, limits: Limits) -> Self {
        Self { storage, limits, searched_in_vain: None }
    }

    /// Makes room if there is too little, as far as that is allowed. A disk that does not answer stops nothing here: the
    /// recorder's own writes tell what is wrong.
    pub fn look(&mut self, session: Option<&Path>) -> Seen {
        let mut seen = Seen::default();
        (seen.allowed, seen.free_bytes) = self.judge(session);
        if seen.allowed == Allowed::All || !frees_by_eviction(seen.allowed) {
            return seen;
        }
        // While a prune or a sync has its turn here nothing goes: what it looks at would be another's last copy. At the next look.
        let Ok(Some(_turn)) = self.storage.lock(&self.limits.captures) else { return seen };
        for going in self.going() {
            let Ok(evicted) = going.evict(self.storage.as_ref()) else { continue };
            seen.evicted.push(evicted);
            (seen.allowed, seen.free_bytes) = self.judge(session);
            if seen.allowed == Allowed::All || seen.evicted.len() >= MAX_EVICTED_AT_ONCE {
                break;
            }
        }
        seen
    }

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
        } else if space.free_inodes < FEWEST_INODES {
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

    fn used(&self) -> u64 {
        let folders = self.storage.list(&self.limits.captures).unwrap_or_default().into_iter();
        let folders = folders.filter(|entry| entry.kind == Kind::Folder).take(MAX_SESSIONS);
        folders.map(|entry| self.used_by(&self.limits.captures.join(entry.name))).sum()
    }

    fn used_by(&self, session: &Path) -> u64 {
        self.storage.list(session).unwrap_or_default().iter().filter_map(Listed::bytes).sum()
    }

    /// Segments that may go, in the order in which they do.
    fn going(&mut self) -> VecDeque<Going> {
        let now = self.storage.now();
        if self.searched_in_vain.is_some_and(|searched| now.saturating_sub(searched) < SEARCH_EVERY) {
            return VecDeque::new();
        }
        let captures = &self.limits.captures;
        let sessions = sessions_on(self.storage.as_ref(), captures).map(|(sessions, _)| sessions).unwrap_or_default();
        let own = receiver_on(self.storage.as_ref(), captures);
        let going = releasable(&sessions, own.as_deref()).into_iter().flat_map(|of| {
            let going = |(line, receiver)| Going::new(of.session, line, receiver);
            of.segments.into_iter().map(going).collect::<Vec<_>>()
        });
        let going: VecDeque<Going> = going.take(2 * MAX_EVICTED_AT_ONCE).collect();
        self.searched_in_vain = going.is_empty().then_some(now);
        going
    }
}

const TOTAL_QUOTA: &str = "total_quota";
const SESSION_QUOTA: &str = "session_quota";

/// More room for one session is not made by removing others.
fn frees_by_eviction(allowed: Allowed) -> bool {
    !matches!(allowed, Allowed::NoFrames(SESSION_QUOTA) | Allowed::Nothing(SESSION_QUOTA))
}

/// Of a limit; 0 is none.
fn share(limit: u64, used: impl FnOnce() -> u64) -> f64 {
    if limit == 0 { 0.0 } else { used() as f64 / limit as f64 }
}

/// A segment that may go.
struct Going {
    session: PathBuf,
    evicted: Evicted,
}

impl Going {
    fn new(session: &Session, line: &ManifestLine, receiver: &str) -> Self {
        let evicted = Evicted {
            file: line.name.clone(),
            bytes: line.bytes,
            blake3: line.blake3.clone(),
            receiver: receiver.to_owned(),
        };
        Self { session: session.folder.clone(), evicted }
    }

    /// Whatever fails, nothing is lost: it is noted first, and a file that is still there is not gone.
    fn evict(self, storage: &dyn Storage) -> Result<Evicted, RecordingError> {
        note(storage, &self.session, &self.evicted)?;
        let path = self.session.join(&self.evicted.file);
        let removed = storage.remove(&path).and_then(|()| storage.sync_folder(&self.session));
        removed.map_err(|source| RecordingError::io(&path, source))?;
        Ok(self.evicted)
    }
}

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
