//! Verification: whether a session is what its manifest says, byte for byte.

use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::error::RecordingError;
use super::folder::{Loss, all_lines};
use super::manifest::MANIFEST_FILE;
use super::repair::read_head;
use super::retention::evicted_segments;
use super::segment::{ACTIVE, is_segment_name, segment_index};
use super::storage::{Kind, Storage};

/// Result of verifying one session.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verified {
    /// Folder of the session.
    pub session: PathBuf,
    /// Segments whose bytes have the hash that the manifest says.
    pub sound: u64,
    /// Bytes of these segments.
    pub bytes: u64,
    /// Segments that were removed because another store has them.
    pub evicted: u64,
    /// What is not as the manifest says.
    pub wrong: Vec<Loss>,
}

/// Reads every segment of a session and compares it with the manifest. Nothing is changed.
pub fn verify(storage: &dyn Storage, session: &Path) -> Result<Verified, RecordingError> {
    read_head(storage, session)?;
    let mut verified = Verified { session: session.to_owned(), ..Verified::default() };
    let path = session.join(MANIFEST_FILE);
    let (lines, damaged) = all_lines(storage, session).map_err(|source| RecordingError::io(&path, source))?;
    let files = storage.list(session).map_err(|source| RecordingError::io(session, source))?;
    let evicted = evicted_segments(storage, session);
    for line in damaged {
        // A torn last line is no loss if its segment is there, which is reported below. Without a name in it, no
        // segment had been removed yet.
        let is_there = |name: &String| files.iter().any(|file| file.name == *name) || evicted.contains_key(name);
        if !line.is_last || !line.name.as_ref().is_none_or(is_there) {
            verified.wrong.push(Loss::new(&path, line.describe()));
        }
    }
    for line in &lines {
        let file = session.join(&line.name);
        if !is_segment_name(&line.name) {
            verified.wrong.push(Loss::new(&path, format!("lists {:?}, which is no name of a segment", line.name)));
            continue;
        }
        let there = files.iter().find(|file| file.name == line.name);
        let said = match there {
            None if evicted.contains_key(&line.name) => {
                verified.evicted += 1;
                continue;
            }
            None => format!("missing: {MANIFEST_FILE} lists it with {} messages", line.messages),
            Some(there) => match there.kind {
                Kind::File(bytes) if bytes != line.bytes => {
                    format!("has {bytes} bytes, but {MANIFEST_FILE} says {}: it was cut or changed", line.bytes)
                }
                Kind::File(_) => match hash(storage, &file) {
                    Ok(hash) if hash.eq_ignore_ascii_case(&line.blake3) => {
                        verified.sound += 1;
                        verified.bytes += line.bytes;
                        continue;
                    }
                    Ok(_) => "its bytes are not those that were written: the hash differs".to_owned(),
                    Err(error) => format!("cannot be read: {error}"),
                },
                Kind::Folder | Kind::Link | Kind::Other => "is no plain file".to_owned(),
            },
        };
        verified.wrong.push(Loss::new(&file, said));
    }
    for file in files.iter().filter(|file| segment_index(&file.name).is_some()) {
        let is_listed = lines.iter().any(|line| line.name == file.name);
        if file.bytes().is_none() && !is_listed {
            verified.wrong.push(Loss::new(&session.join(&file.name), "is no plain file"));
        } else if file.name.ends_with(ACTIVE) {
            let said = "was never finished, or is being recorded: `realitysim sessions repair`";
            verified.wrong.push(Loss::new(&session.join(&file.name), said));
        } else if !is_listed {
            let said = format!("{MANIFEST_FILE} does not list it: `realitysim sessions repair`");
            verified.wrong.push(Loss::new(&session.join(&file.name), said));
        }
    }
    Ok(verified)
}

/// BLAKE3 hash of a file, hexadecimal.
pub(super) fn hash(storage: &dyn Storage, path: &Path) -> io::Result<String> {
    let mut hash = blake3::Hasher::new();
    io::copy(&mut storage.read(path)?, &mut hash)?;
    Ok(hash.finalize().to_hex().to_string())
}
