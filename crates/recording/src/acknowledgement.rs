//! Acknowledgements: `ack/<receiver>.jsonl` in a session's folder says what another store has, whole and verified.

use std::collections::BTreeMap;
use std::path::Path;
use std::{fs, io};

use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use super::manifest::ManifestLine;
use super::sessions::Session;
use super::storage::{Disk, Storage, read_small, write_atomically};

/// Folder in a session's folder with one file of acknowledgements per receiver.
pub const ACK_FOLDER: &str = "ack";
/// End of the name of a file of acknowledgements, behind the receiver's name.
pub const ACK_ENDING: &str = ".jsonl";
/// Folder in a folder of captures with what `sync` needs beside the sessions. It is hidden, so that `captures/*` are
/// sessions.
pub const SYNC_FOLDER: &str = ".sync";
/// File in [`SYNC_FOLDER`] with the name of the folder of captures as a receiver.
pub const RECEIVER_FILE: &str = "receiver";
/// Largest file with a receiver's name, bytes: one line.
const MAX_RECEIVER_FILE_BYTES: u64 = 1024;

/// One line of acknowledgement: the receiver has this file on its disk, with this hash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    /// Name of the segment.
    pub file: String,
    /// BLAKE3 hash of the file, hexadecimal.
    pub blake3: String,
    /// Size of the file, bytes.
    pub bytes: u64,
}

/// Acknowledgements of a session, by receiver.
pub type Acknowledged = BTreeMap<String, Vec<Acknowledgement>>;

impl Acknowledgement {
    /// Acknowledgement of the segment that a line of the manifest describes.
    pub fn of(line: &ManifestLine) -> Self {
        Self { file: line.name.clone(), blake3: line.blake3.clone(), bytes: line.bytes }
    }

    /// Parses a file of acknowledgements. A line that a power cut has torn acknowledges nothing.
    pub fn parse_all(text: &str) -> Vec<Self> {
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// Line of JSON with its line feed.
    pub fn to_line(&self) -> String {
        // Encoding two strings and a number cannot fail.
        serde_json::to_string(self).map_or_else(|_| String::new(), |line| line + "\n")
    }

    /// Whether name, size and hash are those of the line: an acknowledgement of other content does not count.
    pub fn is_of(&self, line: &ManifestLine) -> bool {
        self.file == line.name && self.blake3 == line.blake3 && self.bytes == line.bytes
    }
}

/// Empties a receiver's acknowledgements in a session's folder, so that nothing is deleted because of them any more.
pub fn silence(session: &Session, receiver: &str) -> Result<(), RecordingError> {
    if session.acknowledged.get(receiver).is_none_or(Vec::is_empty) {
        return Ok(());
    }
    write_atomically(&Disk, &session.folder.join(ACK_FOLDER).join(format!("{receiver}{ACK_ENDING}")), b"")
}

/// Replaces a receiver's acknowledgements of a session. The caller has verified each of them at the receiver.
///
/// # Errors
/// Fails if the name is no receiver's, or the file cannot be written.
pub fn acknowledge(session: &Session, receiver: &str, all: &[Acknowledgement]) -> Result<(), RecordingError> {
    let folder = session.folder.join(ACK_FOLDER);
    let path = folder.join(format!("{receiver}{ACK_ENDING}"));
    if !is_receiver(receiver) {
        return Err(RecordingError::io(&path, io::Error::from(io::ErrorKind::InvalidFilename)));
    }
    let failed = |source| RecordingError::io(&folder, source);
    match fs::symlink_metadata(&folder) {
        Ok(metadata) if metadata.is_dir() => {}
        // A link could lead anywhere.
        Ok(_) => return Err(failed(io::Error::from(io::ErrorKind::NotADirectory))),
        Err(_) => fs::create_dir(&folder).map_err(failed)?,
    }
    let text: String = all.iter().map(Acknowledgement::to_line).collect();
    write_atomically(&Disk, &path, text.as_bytes())
}

/// Receivers that have this segment.
pub fn receivers_of<'a>(line: &'a ManifestLine, all: &'a Acknowledged) -> impl Iterator<Item = &'a str> {
    all.iter().filter(|(_, acks)| acks.iter().any(|ack| ack.is_of(line))).map(|(receiver, _)| receiver.as_str())
}

/// Name of a folder of captures as a receiver; `None` if nothing was ever synced into it.
pub fn receiver_of(captures: &Path) -> Option<String> {
    receiver_on(&Disk, captures)
}

/// Does the same as [`receiver_of`] on any storage.
pub(super) fn receiver_on(storage: &dyn Storage, captures: &Path) -> Option<String> {
    let path = captures.join(SYNC_FOLDER).join(RECEIVER_FILE);
    let bytes = read_small(storage, &path, MAX_RECEIVER_FILE_BYTES).ok()??;
    Some(String::from_utf8_lossy(&bytes).trim().to_owned()).filter(|name| is_receiver(name))
}

/// Whether a name may be a receiver's, and so part of the name of a file.
pub fn is_receiver(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= MAX_RECEIVER_BYTES
        && !name.starts_with('.')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
}

/// Longest name of a receiver, bytes: a host's name has at most 64, and a number follows it.
const MAX_RECEIVER_BYTES: usize = 100;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_lines_of_the_same_content_count() {
        let ack = Acknowledgement { file: "0000.mcap".into(), blake3: "ab".into(), bytes: 5 };
        let text = format!("{}\0\0\0\n{}", ack.to_line(), &ack.to_line()[..20]);
        assert_eq!(Acknowledgement::parse_all(&text), [ack]);
    }

    #[test]
    fn a_receiver_is_a_plain_name() {
        for name in ["", "..", ".x", "a/b", "a b", "ä", &"x".repeat(101)] {
            assert!(!is_receiver(name), "{name}");
        }
        assert!(is_receiver("laptop-3.local-0a1b2c"));
    }
}
