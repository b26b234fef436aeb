//! A hash by which a session that changed after it was catalogued is noticed, without reading its segments.

use std::io;
use std::path::Path;

use super::error::{CatalogueError, io as io_of};
use realitysim_config::plain_file;
use realitysim_log_input::log::files_of;
use realitysim_recording::{MANIFEST_FILE, REFINED_FOLDER, REFINED_INFO, REFINED_TAGS, SESSION_FILE};

/// Hash of what the rows of a capture come from: `session.json`, the manifest with the hash of each segment, names and sizes of
/// the segments that are there, and refined tags; 64 hexadecimal digits.
pub(super) fn source_hash(capture: &Path) -> Result<String, CatalogueError> {
    let mut hash = blake3::Hasher::new();
    let refined = capture.join(REFINED_FOLDER);
    let files = [
        capture.join(SESSION_FILE),
        capture.join(MANIFEST_FILE),
        refined.join(REFINED_INFO),
        refined.join(REFINED_TAGS),
    ];
    for file in &files {
        hash.update(hash_of(file).map_err(io_of(file))?.as_bytes());
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
fn hash_of(file: &Path) -> io::Result<blake3::Hash> {
    let mut hash = blake3::Hasher::new();
    match plain_file::open(file) {
        Ok(mut open) => hash.update_reader(&mut open)?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => &mut hash,
        Err(error) => return Err(error),
    };
    Ok(hash.finalize())
}
