//! Sessions as somebody else may have left them: moved, renamed, edited, partly deleted, with foreign files among them.
//! Read without trust: no link is followed, nothing is changed, what is not understood is named and set aside.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags};
use serde::Serialize;

use super::acknowledgement::{ACK_ENDING, ACK_FOLDER, Acknowledged, Acknowledgement, is_receiver};
use super::identity::{Head, SessionId};
use super::manifest::{MANIFEST_FILE, ManifestLine, SESSION_FILE};
use super::segment::ACTIVE;

/// A file of this name in a session's folder: nobody deletes the session unasked.
pub const PIN_FILE: &str = "pinned";
/// For `ros2 bag`; written last.
pub const METADATA_FILE: &str = "metadata.yaml";

/// What was found and is not used, and why.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct SetAside {
    pub path: PathBuf,
    pub why: String,
}

impl SetAside {
    pub fn new(path: impl Into<PathBuf>, why: impl Into<String>) -> Self {
        Self { path: path.into(), why: why.into() }
    }
}

impl fmt::Display for SetAside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.why)
    }
}

/// A session's folder.
#[derive(Clone, Debug)]
pub struct Session {
    pub folder: PathBuf,
    /// The folder's own name.
    pub name: String,
    pub head: Head,
    /// `session.json` as it stands.
    pub head_bytes: Vec<u8>,
    pub id: SessionId,
    /// Of finished segments, in the manifest's order, each once.
    pub lines: Vec<ManifestLine>,
    /// Plain files with segments' names, and their sizes.
    pub segments: BTreeMap<String, u64>,
    /// A segment is being written, or was when the power went.
    pub open: bool,
    pub pinned: bool,
    pub acknowledged: Acknowledged,
    pub set_aside: Vec<SetAside>,
}

/// A manifest has some hundred bytes a segment; what is larger is none.
const MAX_MANIFEST_BYTES: u64 = 64 << 20;
/// `session.json` repeats a config, a field and a lens.
const MAX_HEAD_BYTES: u64 = 4 << 20;
/// More receivers' files than any team has.
const MAX_RECEIVERS: usize = 256;
/// File systems allow no longer names.
const MAX_NAME_BYTES: usize = 255;

/// All sessions in a folder of captures, by name, and what is no session.
pub fn sessions_in(captures: &Path) -> io::Result<(Vec<Session>, Vec<SetAside>)> {
    let (mut sessions, mut set_aside) = (Vec::new(), Vec::new());
    for entry in fs::read_dir(captures)? {
        let entry = entry?;
        let (path, kind) = (entry.path(), entry.file_type()?);
        let name = entry.file_name();
        // Ours, or nobody's business.
        if name.to_string_lossy().starts_with('.') || kind.is_file() {
            continue;
        }
        if kind.is_symlink() {
            set_aside.push(SetAside::new(path, "a link: not followed"));
            continue;
        }
        match session_at(&path) {
            Ok(session) => sessions.push(session),
            Err(why) => set_aside.push(why),
        }
    }
    sessions.sort_by(|a, b| a.name.cmp(&b.name));
    set_aside.sort();
    Ok((sessions, set_aside))
}

/// One session; `Err` if the folder is none.
pub fn session_at(folder: &Path) -> Result<Session, SetAside> {
    let refused = |why: String| SetAside::new(folder, why);
    let name = folder.file_name().and_then(|name| name.to_str()).filter(|name| is_plain_name(name));
    let name = name.ok_or_else(|| refused("not a session's name".to_owned()))?.to_owned();
    let head_bytes = read_plain(&folder.join(SESSION_FILE), MAX_HEAD_BYTES).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => refused(format!("no session: it has no {SESSION_FILE}")),
        _ => refused(format!("{SESSION_FILE}: {error}")),
    })?;
    let head = Head::parse(&head_bytes).map_err(|why| refused(format!("{SESSION_FILE}: {why}")))?;
    let mut set_aside = Vec::new();
    let path = folder.join(MANIFEST_FILE);
    let lines = match read_plain(&path, MAX_MANIFEST_BYTES) {
        Ok(bytes) => parse_manifest(&path, &bytes, &mut set_aside),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            set_aside
                .push(SetAside::new(&path, "missing: nobody can say which segments are whole (`sessions repair`)"));
            Vec::new()
        }
        Err(error) => {
            set_aside.push(SetAside::new(&path, error.to_string()));
            Vec::new()
        }
    };
    let mut session = Session {
        id: head.id(&head_bytes),
        folder: folder.to_owned(),
        name,
        head,
        head_bytes,
        lines,
        segments: BTreeMap::new(),
        open: false,
        pinned: false,
        acknowledged: read_acknowledged(&folder.join(ACK_FOLDER), &mut set_aside),
        set_aside,
    };
    let entries = fs::read_dir(folder).map_err(|error| refused(error.to_string()))?;
    for entry in entries.flatten() {
        let kind = match entry.file_type() {
            Ok(kind) if kind.is_symlink() => Kind::Link,
            Ok(kind) if kind.is_dir() => Kind::Folder,
            Ok(kind) if kind.is_file() => Kind::File(entry.metadata().map_or(0, |metadata| metadata.len())),
            _ => Kind::Other,
        };
        session.note(&entry.file_name().to_string_lossy(), kind);
    }
    session.set_aside.sort();
    Ok(session)
}

/// What something in a session's folder is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    File(u64),
    Folder,
    Link,
    Other,
}

impl Session {
    /// Something that lies in the folder.
    pub fn note(&mut self, name: &str, kind: Kind) {
        let mut aside = |why: &str| self.set_aside.push(SetAside::new(self.folder.join(name), why));
        match kind {
            Kind::Link => aside("a link: not followed"),
            Kind::File(bytes) if is_segment_name(name) => {
                self.segments.insert(name.to_owned(), bytes);
            }
            Kind::File(_) if name == PIN_FILE => self.pinned = true,
            Kind::File(_) if name.strip_suffix(ACTIVE).is_some_and(is_segment_name) => self.open = true,
            Kind::File(_) if is_own_file(name) => {}
            Kind::Folder if name == ACK_FOLDER || name == "refined" => {}
            _ => aside("not of this session: left alone"),
        }
    }

    /// Promised by the manifest and not there as it was written; with the acknowledgements that say who has it.
    pub fn missing(&self) -> impl Iterator<Item = &ManifestLine> {
        self.lines.iter().filter(|line| self.segments.get(&line.name) != Some(&line.bytes))
    }
}

/// Beside segments.
fn is_own_file(name: &str) -> bool {
    [SESSION_FILE, MANIFEST_FILE, METADATA_FILE, super::COVERAGE_FILE].contains(&name) || name.ends_with(".new")
}

/// `0000.mcap`: what the recorder calls a finished segment, and nothing else.
pub fn is_segment_name(name: &str) -> bool {
    let digits = name.strip_suffix(".mcap").unwrap_or("");
    (4..=9).contains(&digits.len()) && digits.bytes().all(|byte| byte.is_ascii_digit())
}

/// One part of a path that stays where it is put and shows as it is.
pub fn is_plain_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= MAX_NAME_BYTES
        && !name.starts_with('.')
        && !name.chars().any(|c| c == '/' || c == '\\' || c.is_control())
}

/// Lines that say what they must, each segment once; the last may be torn.
fn parse_manifest(path: &Path, bytes: &[u8], set_aside: &mut Vec<SetAside>) -> Vec<ManifestLine> {
    let text = String::from_utf8_lossy(bytes);
    let mut lines: Vec<ManifestLine> = Vec::new();
    let mut doubted = Vec::new();
    let mut rest = text.split('\n').enumerate().peekable();
    while let Some((index, text)) = rest.next() {
        let mut aside = |why: String| set_aside.push(SetAside::new(path, format!("line {}: {why}", index + 1)));
        match serde_json::from_str::<ManifestLine>(text) {
            Ok(line) if !is_segment_name(&line.name) => aside(format!("{:?} is no segment's name", line.name)),
            Ok(line) if line.blake3.len() != 64 || !line.blake3.bytes().all(|byte| byte.is_ascii_hexdigit()) => {
                aside(format!("{} has no hash", line.name));
            }
            Ok(line) => match lines.iter().find(|known| known.name == line.name) {
                Some(known) if *known == line => {}
                Some(_) => {
                    aside(format!("{} stands twice, and not alike", line.name));
                    doubted.push(line.name);
                }
                None => lines.push(line),
            },
            // Being written, or torn by a power cut before it was whole.
            Err(_) if rest.peek().is_none() => {}
            Err(error) => aside(format!("damaged: {error}")),
        }
    }
    lines.retain(|line| !doubted.contains(&line.name));
    lines
}

fn read_acknowledged(folder: &Path, set_aside: &mut Vec<SetAside>) -> Acknowledged {
    let mut all = Acknowledged::new();
    if fs::symlink_metadata(folder).is_ok_and(|metadata| !metadata.is_dir()) {
        return all;
    }
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let receiver = name.strip_suffix(ACK_ENDING).filter(|receiver| is_receiver(receiver));
        let Some(receiver) = receiver.filter(|_| all.len() < MAX_RECEIVERS) else {
            set_aside.push(SetAside::new(entry.path(), "not an acknowledgement: left alone"));
            continue;
        };
        match read_plain(&entry.path(), MAX_MANIFEST_BYTES) {
            Ok(bytes) => {
                all.insert(receiver.to_owned(), Acknowledgement::parse_all(&String::from_utf8_lossy(&bytes)));
            }
            Err(error) => set_aside.push(SetAside::new(entry.path(), error.to_string())),
        }
    }
    all
}

/// A file's content; a link, a device, a pipe or something larger is refused, not followed and not waited for.
pub fn read_plain(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = open_plain(path)?;
    let mut bytes = Vec::new();
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("larger than {most} bytes")));
    }
    Ok(bytes)
}

/// For reading; not through a link.
pub fn open_plain(path: &Path) -> io::Result<fs::File> {
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| match error {
        rustix::io::Errno::LOOP => io::Error::other("a link: not followed"),
        error => error.into(),
    })?;
    let file = fs::File::from(file);
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("not a plain file"));
    }
    Ok(file)
}
