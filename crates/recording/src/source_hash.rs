//! Hashes by which a session that changed is noticed, without reading its segments.

use std::io;
use std::path::{Path, PathBuf};

use super::manifest::{MANIFEST_FILE, REFINED_FOLDER, SESSION_FILE};
use super::refined::{REFINED_INFO, REFINED_TAGS};
use realitysim_config::plain_file;
use realitysim_log_input::log::{LogError, files_of};

/// Hash of a capture with its tags, recorded and refined: of `session.json`, the manifest with the hash of each segment, names and
/// sizes of the segments that are there, and the refined tags; 64 hexadecimal digits.
///
/// # Errors
///
/// Fails if the folder has no segment, or if one of these files cannot be read.
pub fn source_hash(capture: &Path) -> Result<String, LogError> {
    let refined = capture.join(REFINED_FOLDER);
    hash_with(capture, &[refined.join(REFINED_INFO), refined.join(REFINED_TAGS)])
}

/// The same as [`source_hash`] without the refined tags: of what was recorded alone.
///
/// # Errors
///
/// Those of [`source_hash`].
pub fn recorded_hash(capture: &Path) -> Result<String, LogError> {
    hash_with(capture, &[])
}

fn hash_with(capture: &Path, more: &[PathBuf]) -> Result<String, LogError> {
    let mut hash = blake3::Hasher::new();
    let recorded = [capture.join(SESSION_FILE), capture.join(MANIFEST_FILE)];
    for path in recorded.iter().chain(more) {
        let of_file = hash_of(path).map_err(|source| LogError::Open { path: path.clone(), source })?;
        hash.update(of_file.as_bytes());
    }
    for segment in files_of(capture)? {
        let size = std::fs::metadata(&segment).map_or(0, |found| found.len());
        let name = segment.file_name().unwrap_or_default();
        hash.update(blake3::hash(name.as_encoded_bytes()).as_bytes());
        hash.update(&size.to_le_bytes());
    }
    Ok(hash.finalize().to_hex().to_string())
}

/// Hash of a file, or of nothing if there is none.
fn hash_of(path: &Path) -> io::Result<blake3::Hash> {
    let mut hash = blake3::Hasher::new();
    match plain_file::open(path) {
        Ok(mut file) => hash.update_reader(&mut file)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => &mut hash,
        Err(error) => return Err(error),
    };
    Ok(hash.finalize())
}
