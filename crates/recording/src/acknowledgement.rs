//! `ack/<receiver>.jsonl` in a session's folder: what another store has, whole and verified.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::catalogue::Session;
use super::error::RecordingError;
use super::manifest::ManifestLine;
use super::storage::{Disk, Storage, read_small, write_atomically};

pub const ACK_FOLDER: &str = "ack";
pub const ACK_ENDING: &str = ".jsonl";
/// In a folder of captures, what `sync` needs beside the sessions; hidden, so that `captures/*` are sessions.
pub const SYNC_FOLDER: &str = ".sync";
/// In it, the folder's name as a receiver.
pub const RECEIVER_FILE: &str = "receiver";
/// A line with a name.
const MAX_RECEIVER_FILE_BYTES: u64 = 1024;

/// A line: this file is there, on its disk, with this hash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    pub file: String,
    pub blake3: String,
    pub bytes: u64,
}

/// Of each receiver what it has.
pub type Acknowledged = BTreeMap<String, Vec<Acknowledgement>>;

impl Acknowledgement {
    pub fn of(line: &ManifestLine) -> Self {
        Self { file: line.name.clone(), blake3: line.blake3.clone(), bytes: line.bytes }
    }

    /// Whole lines only: what was torn by a cut acknowledges nothing.
    pub fn parse_all(text: &str) -> Vec<Self> {
        text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    pub fn to_line(&self) -> String {
        // Two strings and a number.
        serde_json::to_string(self).map_or_else(|_| String::new(), |line| line + "\n")
    }

    /// Name, size and hash: an acknowledgement of other content is none.
    pub fn is_of(&self, line: &ManifestLine) -> bool {
        self.file == line.name && self.blake3 == line.blake3 && self.bytes == line.bytes
    }
}

/// A store's word for the session is not relied on here any more.
pub fn silence(session: &Session, receiver: &str) -> Result<(), RecordingError> {
    if session.acknowledged.get(receiver).is_none_or(Vec::is_empty) {
        return Ok(());
    }
    write_atomically(&Disk, &session.folder.join(ACK_FOLDER).join(format!("{receiver}{ACK_ENDING}")), b"")
}

/// Who has this segment.
pub fn receivers_of<'a>(line: &'a ManifestLine, all: &'a Acknowledged) -> impl Iterator<Item = &'a str> {
    all.iter().filter(|(_, acks)| acks.iter().any(|ack| ack.is_of(line))).map(|(receiver, _)| receiver.as_str())
}

/// The folder's name as a receiver, if anything was ever synced into it.
pub fn receiver_of(captures: &Path) -> Option<String> {
    receiver_on(&Disk, captures)
}

pub(super) fn receiver_on(storage: &dyn Storage, captures: &Path) -> Option<String> {
    let path = captures.join(SYNC_FOLDER).join(RECEIVER_FILE);
    let bytes = read_small(storage, &path, MAX_RECEIVER_FILE_BYTES).ok()??;
    Some(String::from_utf8_lossy(&bytes).trim().to_owned()).filter(|name| is_receiver(name))
}

/// What may be part of a file's name: of a receiver.
pub fn is_receiver(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= MAX_RECEIVER_BYTES
        && !name.starts_with('.')
        && name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c))
}

/// A host's name has at most 64, and a number comes behind it.
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
