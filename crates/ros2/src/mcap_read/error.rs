//! Errors of reading: a file that is no log, or a log that is damaged.

use std::fmt;
use std::io;

use thiserror::Error;

/// The bytes with which every MCAP file begins, and with which a finished one ends.
pub(super) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// Why a log cannot be read at all. Damage inside a log is no error: see [`Damage`].
#[derive(Debug, Error)]
pub enum ReadError {
    /// The file is no MCAP.
    #[error("expected an MCAP file, found {found}")]
    NotMcap {
        /// Description of the file, as far as its first bytes tell.
        found: String,
    },
    /// The file cannot be read.
    #[error("cannot read the log: {0}")]
    Io(#[from] io::Error),
}

/// Damage of a log: what a reader could not trust and left out.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Whether the file does not end as an MCAP file must: its writer was stopped, or its tail is lost.
    pub torn: bool,
    /// Number of chunks whose checksum or structure is wrong. None of their messages was delivered.
    pub bad_chunks: u64,
    /// Number of records outside of chunks, or messages in sound chunks, that cannot be parsed.
    pub bad_records: u64,
    /// Number of messages whose channel was defined in a part that is lost.
    pub orphan_messages: u64,
    /// Number of messages that were delivered after one with a later log time, although the log has an index.
    pub out_of_order: u64,
    /// Number of bytes of the file that were not used because of damage.
    pub bytes_skipped: u64,
    /// Description of the first damage that was found.
    pub first_error: Option<String>,
}

impl Damage {
    /// Whether the log is sound.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Keeps the description of damage if it is the first.
    pub(super) fn note(&mut self, error: impl FnOnce() -> String) {
        self.first_error.get_or_insert_with(error);
    }

    /// Counts a chunk at `offset` whose `bytes` are not used.
    pub(super) fn bad_chunk(&mut self, offset: u64, bytes: u64, error: &str) {
        self.bad_chunks += 1;
        self.bytes_skipped += bytes;
        self.note(|| format!("chunk at byte {offset}: {error}"));
    }

    /// Counts a record at `offset` of which `bytes` are not used.
    pub(super) fn bad_record(&mut self, offset: u64, bytes: u64, error: &str) {
        self.bad_records += 1;
        self.bytes_skipped += bytes;
        self.note(|| format!("record at byte {offset}: {error}"));
    }
}

/// Describes the damage in words, the most important first.
impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        if self.torn {
            parts.push("its end is missing".to_owned());
        }
        for (count, one, many) in [
            (self.bad_chunks, "bad chunk", "bad chunks"),
            (self.bad_records, "bad record", "bad records"),
            (self.orphan_messages, "message of an unknown topic", "messages of unknown topics"),
            (self.out_of_order, "message out of order", "messages out of order"),
            (self.bytes_skipped, "byte not used", "bytes not used"),
        ] {
            match count {
                0 => {}
                1 => parts.push(format!("1 {one}")),
                _ => parts.push(format!("{count} {many}")),
            }
        }
        f.write_str(&parts.join(", "))?;
        match &self.first_error {
            Some(error) if parts.is_empty() => f.write_str(error),
            Some(error) => write!(f, " ({error})"),
            None => Ok(()),
        }
    }
}

/// Checks the first bytes of a file. A file that was cut within the magic bytes counts as a torn MCAP.
pub(super) fn check_magic(first: &[u8]) -> Result<(), ReadError> {
    let compared = first.len().min(MAGIC.len());
    if compared > 0 && first[..compared] == MAGIC[..compared] {
        return Ok(());
    }
    Err(ReadError::NotMcap { found: describe(first) })
}

/// Describes a file that is no MCAP by its first bytes.
fn describe(first: &[u8]) -> String {
    let known: [(&[u8], &str); 7] = [
        (b"SQLite format 3", "a SQLite database (a rosbag2 .db3 file? rosbags-convert turns it into MCAP)"),
        (b"#ROSBAG V", "a ROS 1 bag (rosbags-convert turns it into MCAP)"),
        (b"\x1f\x8b", "gzip data (unpack it first)"),
        (b"\x28\xb5\x2f\xfd", "zstd data (a rosbag2 file compressed as a whole? unpack it first)"),
        (b"PK\x03\x04", "a zip archive (unpack it first)"),
        (b"rosbag2_bagfile_information", "a rosbag2 metadata.yaml (name the .mcap file beside it)"),
        (&[0; 8], "zeros (the recording never reached the disk)"),
    ];
    if first.is_empty() {
        return "an empty file".to_owned();
    }
    match known.iter().find(|(start, _)| first.starts_with(start)) {
        Some((_, what)) => (*what).to_owned(),
        None => format!("a file that starts with {:02x?}", &first[..first.len().min(MAGIC.len())]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damage_is_told_in_words() {
        let mut damage = Damage { torn: true, ..Damage::default() };
        assert_eq!(damage.to_string(), "its end is missing");
        damage.bad_chunk(40, 100, "it is cut");
        damage.bad_chunk(140, 100, "it is cut as well");
        let said = "its end is missing, 2 bad chunks, 200 bytes not used (chunk at byte 40: it is cut)";
        assert_eq!(damage.to_string(), said);
    }

    #[test]
    fn says_what_the_file_looks_like() {
        let said = |first: &[u8]| check_magic(first).unwrap_err().to_string();
        assert!(said(b"SQLite format 3\0").contains("rosbags-convert"));
        assert!(said(b"#ROSBAG V2.0\n").contains("ROS 1"));
        assert!(said(b"\x1f\x8b\x08").contains("gzip"));
        assert_eq!(said(b""), "expected an MCAP file, found an empty file");
        assert_eq!(said(b"hi"), "expected an MCAP file, found a file that starts with [68, 69]");
        check_magic(b"\x89MC").unwrap();
        check_magic(b"\x89MCAP0\r\n\x01").unwrap();
    }
}
