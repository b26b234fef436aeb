//! Sessions as they are found in a folder of captures.
//!
//! Others may have moved, renamed, edited or partly deleted them, or put foreign files among them. So nothing is
//! trusted: no link is followed, nothing is changed, and what is not understood is named and set aside.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::acknowledgement::{ACK_ENDING, ACK_FOLDER, Acknowledged, Acknowledgement, is_receiver};
use super::coverage::COVERAGE_FILE;
use super::distinct_folders::is_probe;
use super::identity::{Head, SessionId};
use super::manifest::{
    EVICTED_FILE, MANIFEST_FILE, METADATA_FILE, ManifestLine, PIN_FILE, RECEIVED_FILE, REFINED_FOLDER, SESSION_FILE,
};
use super::repair::{COPY, JOURNAL_FILE, is_damaged_name};
use super::retention::{Evicted, evicted_segments};
use super::segment::{ACTIVE, is_segment_name};
pub use super::storage::Kind;
use super::storage::{Disk, Listed, Storage, read_whole};

/// Something that was found and is not used.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct SetAside {
    /// File or folder.
    pub path: PathBuf,
    /// Reason why it is not used.
    pub why: String,
}

impl SetAside {
    /// Sets a path aside for a reason.
    pub fn new(path: impl Into<PathBuf>, why: impl Into<String>) -> Self {
        Self { path: path.into(), why: why.into() }
    }
}

impl fmt::Display for SetAside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.why)
    }
}

/// A session's folder as it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Session {
    /// The folder.
    pub folder: PathBuf,
    /// Name of the folder.
    pub name: String,
    /// What `session.json` says of robot, start and format.
    pub head: Head,
    /// Content of `session.json`, unchanged.
    pub head_bytes: Vec<u8>,
    /// Identity of the session.
    pub id: SessionId,
    /// Finished segments, in the order of the manifest, each once.
    pub lines: Vec<ManifestLine>,
    /// Number of further lines of the manifest that are damaged, incomplete, or contradict each other.
    pub doubted: u64,
    /// Whether `metadata.yaml` is there, which is written last: every segment was in the manifest once.
    pub has_ended: bool,
    /// Sizes of plain files that have a segment's name, bytes.
    pub segments: BTreeMap<String, u64>,
    /// Segments that this program has removed to make room, and who has them.
    pub evicted: BTreeMap<String, Evicted>,
    /// Whether a segment is being written, or was when the power failed.
    pub open: bool,
    /// Whether the session is pinned.
    pub pinned: bool,
    /// Whether the folder holds a result of `refine`, which no sync copies.
    pub is_refined: bool,
    /// How the session came here; `None` if it was recorded here.
    pub received: Option<Received>,
    /// What other stores have of the session.
    pub acknowledged: Acknowledged,
    /// What is not understood in the folder.
    pub set_aside: Vec<SetAside>,
}

/// Content of `received.json`: how a session came here.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Received {
    /// Number of copies between the recorder and this one: 1 if it was synced from the recorder's own folder, 2 if
    /// from a copy of that, and so on.
    pub hops: u32,
    /// Name, as a receiver, of the folder that received the session; its acknowledgement stands for this very copy.
    #[serde(default)]
    pub receiver: String,
}

/// Largest manifest, bytes: it has some hundred bytes a segment.
const MAX_MANIFEST_BYTES: u64 = 64 << 20;
/// Most segments of a session: a week of half-minute segments. What a manifest lists beyond is not believed.
const MAX_SEGMENTS: usize = 20_000;
/// Largest `session.json`, bytes: it holds a config, a field and a lens.
const MAX_HEAD_BYTES: u64 = 4 << 20;
/// Largest `received.json`, bytes: a number and a name.
const MAX_RECEIVED_BYTES: u64 = 1024;
/// Most files of acknowledgements of a session: more than any team has receivers.
const MAX_RECEIVERS: usize = 256;
/// Longest name, bytes: file systems allow no longer one.
const MAX_NAME_BYTES: usize = 255;

/// Reads all sessions in a folder of captures, by name, and lists what is no session.
pub fn sessions_in(captures: &Path) -> io::Result<(Vec<Session>, Vec<SetAside>)> {
    sessions_on(&Disk, captures)
}

/// Reads the session of this name in a folder of captures, and no other; `None` if there is none.
///
/// The name is looked up among the folder's entries: it is never made a part of a path, so that it may come from a stranger.
pub fn session_named(captures: &Path, name: &str) -> io::Result<Option<Session>> {
    let entry = Disk.list(captures)?.into_iter().find(|entry| entry.name == name);
    let folder = entry.filter(|entry| may_be_session(entry) && entry.kind != Kind::Link);
    Ok(folder.and_then(|entry| session_on(&Disk, &captures.join(&entry.name)).ok()))
}

/// Reads one session; `Err` if the folder is none.
pub fn session_at(folder: &Path) -> Result<Session, SetAside> {
    session_on(&Disk, folder)
}

/// Does the same as [`sessions_in`] on any storage.
pub(super) fn sessions_on(storage: &dyn Storage, captures: &Path) -> io::Result<(Vec<Session>, Vec<SetAside>)> {
    let (mut sessions, mut set_aside) = (Vec::new(), Vec::new());
    for entry in storage.list(captures)? {
        if !may_be_session(&entry) {
            continue;
        }
        let path = captures.join(&entry.name);
        if entry.kind == Kind::Link {
            set_aside.push(SetAside::new(path, "a link: not followed"));
            continue;
        }
        match session_on(storage, &path) {
            Ok(session) => sessions.push(session),
            Err(why) => set_aside.push(why),
        }
    }
    sessions.sort_by(|a, b| a.name.cmp(&b.name));
    set_aside.sort();
    Ok((sessions, set_aside))
}

/// Hidden entries belong to this program; plain files are none of its business.
fn may_be_session(entry: &Listed) -> bool {
    !entry.name.starts_with('.') && entry.bytes().is_none()
}

/// Does the same as [`session_at`] on any storage.
fn session_on(storage: &dyn Storage, folder: &Path) -> Result<Session, SetAside> {
    let refused = |why: String| SetAside::new(folder, why);
    let name = folder.file_name().and_then(|name| name.to_str()).filter(|name| is_plain_name(name));
    let name = name.ok_or_else(|| refused("not a session's name".to_owned()))?.to_owned();
    let head_bytes =
        read_whole(storage, &folder.join(SESSION_FILE), MAX_HEAD_BYTES).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => refused(format!("no session: it has no {SESSION_FILE}")),
            _ => refused(format!("{SESSION_FILE}: {error}")),
        })?;
    let head = Head::parse(&head_bytes).map_err(|why| refused(format!("{SESSION_FILE}: {why}")))?;
    let mut set_aside = Vec::new();
    let path = folder.join(MANIFEST_FILE);
    let (lines, doubted) = match read_whole(storage, &path, MAX_MANIFEST_BYTES) {
        Ok(bytes) => parse_manifest(&path, &bytes, &mut set_aside),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            set_aside
                .push(SetAside::new(&path, "missing: nobody can say which segments are whole (`sessions repair`)"));
            (Vec::new(), 0)
        }
        Err(error) => {
            set_aside.push(SetAside::new(&path, error.to_string()));
            (Vec::new(), 0)
        }
    };
    let mut session = Session {
        id: head.id(&head_bytes),
        folder: folder.to_owned(),
        name,
        head,
        head_bytes,
        lines,
        doubted,
        has_ended: false,
        segments: BTreeMap::new(),
        evicted: evicted_segments(storage, folder),
        open: false,
        pinned: false,
        is_refined: false,
        received: read_received(storage, &folder.join(RECEIVED_FILE), &mut set_aside),
        acknowledged: Acknowledged::new(),
        set_aside,
    };
    for entry in storage.list(folder).map_err(|error| refused(error.to_string()))? {
        if entry.name == ACK_FOLDER && entry.kind == Kind::Folder {
            session.acknowledged = read_acknowledged(storage, &folder.join(ACK_FOLDER), &mut session.set_aside);
        }
        session.has_ended |= entry.name == METADATA_FILE && entry.bytes().is_some();
        session.note(&entry.name, entry.kind);
    }
    session.set_aside.sort();
    Ok(session)
}

impl Session {
    /// Number of copies between the recorder and this one. A deletion may rely only on a store with a greater number.
    pub fn hops(&self) -> u32 {
        self.received.as_ref().map_or(0, |received| received.hops)
    }

    /// Takes account of an entry of the session's folder.
    pub fn note(&mut self, name: &str, kind: Kind) {
        let mut aside = |why: &str| self.set_aside.push(SetAside::new(self.folder.join(name), why));
        match kind {
            Kind::Link => aside("a link: not followed"),
            Kind::File(bytes) if is_segment_name(name) => {
                self.segments.insert(name.to_owned(), bytes);
            }
            Kind::File(_) if name == PIN_FILE => self.pinned = true,
            Kind::File(_) if name.strip_suffix(ACTIVE).is_some_and(is_segment_name) => self.open = true,
            Kind::File(_) if is_own_file(name) || is_probe(name.as_ref()) => {}
            Kind::Folder if name == REFINED_FOLDER => self.is_refined = true,
            Kind::Folder if name == ACK_FOLDER => {}
            Kind::File(_) if is_damaged_name(name) => {
                aside("set aside by `sessions repair`: for you to look at, and to delete");
            }
            _ => aside("not of this session: left alone"),
        }
    }

    /// Segments that the manifest lists and that are not here as they were written, without those removed on purpose.
    pub fn missing(&self) -> impl Iterator<Item = &ManifestLine> {
        self.lines.iter().filter(|line| !self.has(line) && !self.has_evicted(line))
    }

    /// Whether the segment is here with the size that it was written with.
    pub fn has(&self, line: &ManifestLine) -> bool {
        self.segments.get(&line.name) == Some(&line.bytes)
    }

    /// Whether the segment was removed to make room, because another store had it.
    pub fn has_evicted(&self, line: &ManifestLine) -> bool {
        !self.segments.contains_key(&line.name)
            && self.evicted.get(&line.name).is_some_and(|evicted| evicted.blake3 == line.blake3)
    }
}

/// Whether a file beside the segments is one that this program writes.
fn is_own_file(name: &str) -> bool {
    const OWN: [&str; 7] =
        [SESSION_FILE, MANIFEST_FILE, METADATA_FILE, COVERAGE_FILE, EVICTED_FILE, RECEIVED_FILE, JOURNAL_FILE];
    // A file that is replaced as a whole is written under this name first.
    let beside = |own: &str| Some(name) == Path::new(own).with_extension("new").to_str();
    OWN.contains(&name) || OWN.iter().any(|own| beside(own)) || name.strip_suffix(COPY).is_some_and(is_segment_name)
}

/// Whether a name is a single part of a path, not hidden, and prints as it is.
pub fn is_plain_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= MAX_NAME_BYTES
        && !name.starts_with('.')
        && !name.chars().any(|c| c == '/' || c == '\\' || c.is_control())
}

/// Parses a manifest that may be damaged: returns the valid lines, each segment once, and how many segments the other
/// lines may stand for. A torn last line does not count.
fn parse_manifest(path: &Path, bytes: &[u8], set_aside: &mut Vec<SetAside>) -> (Vec<ManifestLine>, u64) {
    let text = String::from_utf8_lossy(bytes);
    let mut lines: Vec<ManifestLine> = Vec::new();
    let mut numbers: BTreeMap<String, usize> = BTreeMap::new();
    let (mut unlike, mut damaged) = (BTreeSet::new(), 0);
    let mut rest = text.split('\n').enumerate().peekable();
    while let Some((index, text)) = rest.next() {
        let mut aside = |why: String| set_aside.push(SetAside::new(path, format!("line {}: {why}", index + 1)));
        match serde_json::from_str::<ManifestLine>(text) {
            Ok(line) if !is_segment_name(&line.name) => aside(format!("{:?} is no segment's name", line.name)),
            Ok(line) if line.blake3.len() != 64 || !line.blake3.bytes().all(|byte| byte.is_ascii_hexdigit()) => {
                aside(format!("{} has no hash", line.name));
                damaged += 1;
            }
            Ok(line) => match numbers.get(&line.name).map(|number| &lines[*number]) {
                Some(known) if *known == line => {}
                Some(_) => {
                    aside(format!("{} stands twice, and not alike", line.name));
                    unlike.insert(line.name);
                }
                None if lines.len() == MAX_SEGMENTS => {
                    aside(format!("more than {MAX_SEGMENTS} segments, which no recording has: the rest is not read"));
                    damaged += 1;
                    break;
                }
                None => {
                    numbers.insert(line.name.clone(), lines.len());
                    lines.push(line);
                }
            },
            // The last line is being written, or a power cut has torn it.
            Err(_) if rest.peek().is_none() => {}
            Err(error) => {
                aside(format!("damaged: {error}"));
                damaged += 1;
            }
        }
    }
    lines.retain(|line| !unlike.contains(&line.name));
    (lines, damaged + unlike.len() as u64)
}

/// Reads `received.json`. One that makes no sense counts as infinitely far from the recorder, so that this copy
/// relies on nobody's acknowledgement.
fn read_received(storage: &dyn Storage, path: &Path, set_aside: &mut Vec<SetAside>) -> Option<Received> {
    let parsed = match read_whole(storage, path, MAX_RECEIVED_BYTES) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
        Err(error) => Err(error.to_string()),
        Ok(bytes) => serde_json::from_slice(&bytes).map_err(|error| error.to_string()),
    };
    Some(parsed.unwrap_or_else(|why| {
        set_aside.push(SetAside::new(path, why));
        Received { hops: u32::MAX, ..Received::default() }
    }))
}

/// Reads all files of acknowledgements of a session.
fn read_acknowledged(storage: &dyn Storage, folder: &Path, set_aside: &mut Vec<SetAside>) -> Acknowledged {
    let mut all = Acknowledged::new();
    for entry in storage.list(folder).unwrap_or_default() {
        if is_probe(entry.name.as_ref()) {
            continue;
        }
        let path = folder.join(&entry.name);
        let receiver = entry.name.strip_suffix(ACK_ENDING).filter(|receiver| is_receiver(receiver));
        let Some(receiver) = receiver.filter(|_| all.len() < MAX_RECEIVERS) else {
            set_aside.push(SetAside::new(path, "not an acknowledgement: left alone"));
            continue;
        };
        match read_whole(storage, &path, MAX_MANIFEST_BYTES) {
            Ok(bytes) => {
                all.insert(receiver.to_owned(), Acknowledgement::parse_all(&String::from_utf8_lossy(&bytes)));
            }
            Err(error) => set_aside.push(SetAside::new(path, error.to_string())),
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Counts;

    #[test]
    fn a_manifest_without_an_end_is_read_to_its_bound() {
        let line = |number: usize| {
            let line = ManifestLine {
                name: format!("{number:04}.mcap"),
                bytes: 1,
                blake3: "0".repeat(64),
                first_ns: 0,
                last_ns: 0,
                messages: 0,
                frames: Counts::default(),
                poses: None,
                cut_bytes: None,
            };
            serde_json::to_string(&line).expect("a line") + "\n"
        };
        let text: String = (0..60_000).map(line).collect();
        let mut set_aside = Vec::new();
        let (lines, doubted) = parse_manifest(Path::new("manifest.jsonl"), text.as_bytes(), &mut set_aside);
        assert_eq!((lines.len(), doubted, set_aside.len()), (MAX_SEGMENTS, 1, 1));
        assert!(set_aside[0].why.contains("line 20001: more than 20000 segments"), "{set_aside:?}");
    }
}
