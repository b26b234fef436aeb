//! Resolves the paths given to `db add` into sources.

use std::path::{Path, PathBuf};

use super::contents::Contents;
use super::error::{DatabaseError, io};
use super::remote_files::absolute;
use super::sources::is_source;
use realitysim_recording::{DISK_FILE, STATE_FILE};

/// Files that recorders keep beside their captures. The shell's `captures/*` includes them, so they are skipped.
const BESIDE_CAPTURES: [&str; 2] = [STATE_FILE, DISK_FILE];

/// The captures and folders of images to add, as absolute paths, each once.
///
/// A folder of captures stands for those in it that the database does not have. A capture or folder of images that the
/// database has is an error.
pub(super) fn sources_of(paths: &[PathBuf], known: Option<&Contents>) -> Result<Vec<PathBuf>, DatabaseError> {
    let mut found: Vec<PathBuf> = Vec::new();
    for path in paths {
        let inside = captures_in(path)?;
        let is_folder_of_captures = !inside.is_empty();
        let beside =
            path.file_name().and_then(|name| name.to_str()).is_some_and(|name| BESIDE_CAPTURES.contains(&name));
        if beside && path.is_file() {
            continue;
        }
        for source in if is_folder_of_captures { inside } else { vec![path.clone()] } {
            let source = absolute(&source).map_err(io(&source))?;
            let sources = known.into_iter().flat_map(|known| known.sources.iter().map(|source| &source.path));
            match sources.chain(&found).find(|other| source.starts_with(other) || other.starts_with(&source)) {
                Some(_) if is_folder_of_captures => {}
                Some(_) => return Err(DatabaseError::Known { path: path.clone() }),
                None => found.push(source),
            }
        }
    }
    Ok(found)
}

/// The sources directly in a folder, sorted by name; empty if the path itself is a source or a file.
fn captures_in(path: &Path) -> Result<Vec<PathBuf>, DatabaseError> {
    if is_source(path) || !path.is_dir() {
        return Ok(Vec::new());
    }
    let entries = std::fs::read_dir(path).map_err(io(path))?.filter_map(Result::ok).map(|entry| entry.path());
    let mut found: Vec<PathBuf> = entries.filter(|entry| is_source(entry)).collect();
    found.sort();
    Ok(found)
}
