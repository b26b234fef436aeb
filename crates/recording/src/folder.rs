//! What a session's manifest promises, compared with what its folder holds.

use std::fmt;
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::error::RecordingError;
use super::manifest::{MANIFEST_FILE, ManifestLine, SESSION_FILE, SessionInfo};
use super::retention::evicted_segments;
use super::segment::{ACTIVE, is_segment_name};
use super::storage::{Disk, Storage, open_plain, read_plain, read_small};
use realitysim_ros2::mcap_read::Damage;

/// Largest manifest, bytes: it has some hundred bytes a segment.
const MAX_MANIFEST_BYTES: u64 = 64 << 20;
/// Largest `session.json`, bytes: it holds a config, a field and a lens.
const MAX_SESSION_BYTES: u64 = 4 << 20;

/// A part of a recording that cannot be read any more.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Loss {
    /// The file that is damaged or missing.
    pub file: PathBuf,
    /// What is lost, in words.
    pub what: String,
}

impl Loss {
    /// Loss of a part of a file.
    pub fn new(file: &Path, what: impl Into<String>) -> Self {
        Self { file: file.to_owned(), what: what.into() }
    }

    /// Loss that a reader met in a file.
    pub fn of_damage(file: &Path, damage: &Damage) -> Self {
        let open = file.extension().is_some_and(|ending| *ending == *ACTIVE.trim_start_matches('.'));
        let state = if open && damage.torn { "never finished" } else { "damaged" };
        Self::new(file, format!("{state}: {damage}"))
    }

    /// Adds this loss to others; losses of the same file become one.
    pub fn join(self, losses: &mut Vec<Self>) {
        match losses.iter_mut().find(|known| known.file == self.file) {
            Some(known) => known.what = format!("{}; {}", known.what, self.what),
            None => losses.push(self),
        }
    }
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.file.display(), self.what)
    }
}

/// Lists segments of the manifest that are missing or have another size than they were written with.
///
/// `capture` is a session's folder, or one of its segments, which is then checked alone. A folder without a manifest
/// has no losses.
pub fn missing_parts(capture: &Path) -> Vec<Loss> {
    let (folder, only) = match (capture.is_dir(), capture.parent(), capture.file_name()) {
        (false, Some(folder), Some(name)) => (folder, Some(name)),
        _ => (capture, None),
    };
    let path = folder.join(MANIFEST_FILE);
    let text = match read_manifest(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Vec::new(),
        Err(error) => return vec![Loss::new(&path, format!("cannot be read, so no segment was checked: {error}"))],
    };
    let evicted = evicted_segments(&Disk, folder);
    let mut losses = Vec::new();
    let (lines, damaged) = parse_lines(&text);
    for line in lines {
        // A segment that was removed to make room is in another store.
        let is_evicted = evicted.contains_key(&line.name) && !folder.join(&line.name).exists();
        if !is_evicted && only.is_none_or(|name| *name == *line.name) {
            losses.extend(loss_of(folder, &line));
        }
    }
    let told = damaged.into_iter().filter(|line| !line.is_last);
    losses.extend(told.map(|line| Loss::new(&path, line.describe())));
    losses
}

/// A line of a manifest that does not parse.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct DamagedLine {
    /// Number of the line, from 1.
    number: usize,
    /// Name of the segment, if that much can be read.
    pub name: Option<String>,
    /// Whether it is the last line and has no end: a line is appended after its segment got its final name, and power
    /// may fail in between.
    pub is_last: bool,
    error: String,
}

impl DamagedLine {
    /// Describes the damage for people.
    pub fn describe(&self) -> String {
        let of = self.name.as_ref().map_or(String::new(), |name| format!(" (that of {name})"));
        format!("line {} is damaged{of}: {}", self.number, self.error)
    }
}

/// Parses a manifest: its valid lines in order, and its damaged ones.
fn parse_lines(text: &str) -> (Vec<ManifestLine>, Vec<DamagedLine>) {
    let (mut lines, mut damaged) = (Vec::new(), Vec::new());
    let mut rest = text.split('\n').enumerate().filter(|(_, line)| !line.trim().is_empty()).peekable();
    while let Some((index, line)) = rest.next() {
        match serde_json::from_str::<ManifestLine>(line) {
            Ok(line) => lines.push(line),
            Err(error) => {
                let is_last = rest.peek().is_none() && !text.ends_with('\n');
                damaged.push(DamagedLine { number: index + 1, name: name_in(line), is_last, error: error.to_string() });
            }
        }
    }
    (lines, damaged)
}

/// Name of the segment in a damaged line.
fn name_in(line: &str) -> Option<String> {
    let (_, rest) = line.split_once("\"name\":")?;
    let (name, _) = rest.trim_start().strip_prefix('"')?.split_once('"')?;
    is_segment_name(name).then(|| name.to_owned())
}

/// Reads the valid lines of a manifest, in order.
pub(super) fn manifest_lines(storage: &dyn Storage, session: &Path) -> io::Result<Vec<ManifestLine>> {
    Ok(all_lines(storage, session)?.0)
}

/// Reads the valid and the damaged lines of a manifest, in order.
pub(super) fn all_lines(storage: &dyn Storage, session: &Path) -> io::Result<(Vec<ManifestLine>, Vec<DamagedLine>)> {
    let text = read_small(storage, &session.join(MANIFEST_FILE), MAX_MANIFEST_BYTES)?.unwrap_or_default();
    Ok(parse_lines(&String::from_utf8_lossy(&text)))
}

fn read_manifest(path: &Path) -> io::Result<String> {
    let mut bytes = Vec::new();
    open_plain(path)?.take(MAX_MANIFEST_BYTES).read_to_end(&mut bytes)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Compares a line of the manifest with the file of its segment.
fn loss_of(folder: &Path, line: &ManifestLine) -> Option<Loss> {
    let file = folder.join(&line.name);
    let ManifestLine { bytes, messages, frames, .. } = line;
    let what = match fs::metadata(&file) {
        Ok(found) if !found.is_file() => "is no plain file".to_owned(),
        Ok(found) if found.len() == *bytes => return None,
        Ok(found) => format!("has {} bytes, but {MANIFEST_FILE} says {bytes}: it was cut or changed", found.len()),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            format!("missing: {MANIFEST_FILE} lists it with {} frames and {messages} messages", frames.written)
        }
        Err(error) => format!("cannot be read: {error}"),
    };
    Some(Loss { file, what })
}

/// Reads `session.json` of a session.
pub fn read_info(session: &Path) -> Result<SessionInfo, RecordingError> {
    let path = session.join(SESSION_FILE);
    let bytes = read_plain(&path, MAX_SESSION_BYTES).map_err(|source| RecordingError::io(&path, source))?;
    serde_json::from_slice(&bytes).map_err(|source| RecordingError::Info { path, source })
}

/// Finds the session in whose folder a path lies, or would lie if it existed. Nothing else may be written there.
pub fn session_holding(path: &Path) -> Option<PathBuf> {
    let path = std::path::absolute(path).ok()?;
    let existing = path.ancestors().find_map(|ancestor| ancestor.canonicalize().ok())?;
    let is_session = |folder: &&Path| folder.join(SESSION_FILE).is_file() && folder.join(MANIFEST_FILE).is_file();
    existing.ancestors().find(is_session).map(Path::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(name: &str, bytes: u64) -> String {
        let frames = r#"{"captured":3,"written":3,"tagged":3,"valid":3,"dropped":{}}"#;
        let times = r#""first_ns":0,"last_ns":1,"messages":7"#;
        format!(r#"{{"name":"{name}","bytes":{bytes},"blake3":"",{times},"frames":{frames},"poses":null}}"#)
    }

    fn said(capture: &Path) -> Vec<String> {
        let shown = |loss: Loss| format!("{}: {}", loss.file.file_name().unwrap().display(), loss.what);
        missing_parts(capture).into_iter().map(shown).collect()
    }

    #[test]
    fn what_the_manifest_lists_and_is_not_there_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        fs::write(folder.join("0000.mcap"), "12345").unwrap();
        fs::write(folder.join("0001.mcap"), "1234").unwrap();
        assert_eq!(said(folder), [""; 0], "no manifest");
        let lines = [line("0000.mcap", 5), line("0001.mcap", 5), line("0002.mcap", 5)].map(|line| line + "\n");
        fs::write(folder.join(MANIFEST_FILE), lines.concat()).unwrap();
        let cut = "0001.mcap: has 4 bytes, but manifest.jsonl says 5: it was cut or changed";
        let missing = "0002.mcap: missing: manifest.jsonl lists it with 3 frames and 7 messages";
        assert_eq!(said(folder), [cut, missing]);
        assert_eq!(said(&folder.join("0000.mcap")), [""; 0]);
        assert_eq!(said(&folder.join("0001.mcap")), [cut]);
    }

    #[test]
    fn a_torn_last_line_is_no_loss_and_a_damaged_one_is() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        fs::write(folder.join("0000.mcap"), "12345").unwrap();
        let whole = line("0000.mcap", 5);
        let path = folder.join(MANIFEST_FILE);
        fs::write(&path, format!("{whole}\n{}", &whole[..40])).unwrap();
        assert_eq!(said(folder), [""; 0]);
        fs::write(&path, format!("{}\n{whole}\n", &whole[..40])).unwrap();
        assert!(said(folder)[0].starts_with("manifest.jsonl: line 1 is damaged"), "{:?}", said(folder));
        fs::write(&path, b"\xff\0\n\n").unwrap();
        assert_eq!(said(folder).len(), 1);
    }

    #[test]
    fn a_path_in_a_session_is_known_before_it_exists() {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().canonicalize().unwrap().join("captures/session");
        fs::create_dir_all(&session).unwrap();
        assert_eq!(session_holding(&session.join("x")), None, "only a folder yet");
        for name in [SESSION_FILE, MANIFEST_FILE] {
            fs::write(session.join(name), "").unwrap();
        }
        std::os::unix::fs::symlink(&session, folder.path().join("link")).unwrap();
        let inside = [session.clone(), session.join("a/b.png"), folder.path().join("link/x")];
        for path in inside {
            assert_eq!(session_holding(&path), Some(session.clone()), "{path:?}");
        }
        assert_eq!(session_holding(&session.join("../x")), None);
        assert_eq!(session_holding(folder.path()), None);
    }
}
