//! Names under which `repair` sets aside what it does not keep. A file that is there is never replaced.

use std::path::{Path, PathBuf};

use super::super::error::RecordingError;
use super::super::segment::{ACTIVE, is_segment_name};
use super::super::storage::Storage;

/// End of the name of a segment that was copied or whose place was taken; it is kept for people to look at.
const DAMAGED: &str = ".damaged";
/// Most files of one segment that are set aside.
const MAX_DAMAGED_NAMES: u32 = 1000;

/// Whether a name is `0000.mcap.damaged`, `0000.mcap.damaged-2` and so on.
pub(crate) fn is_damaged_name(name: &str) -> bool {
    let Some((segment, number)) = name.split_once(DAMAGED) else { return false };
    let is_number = |digits: &str| !digits.starts_with('0') && digits.parse::<u32>().is_ok_and(|number| number > 1);
    is_segment_name(segment) && (number.is_empty() || number.strip_prefix('-').is_some_and(is_number))
}

/// Renames an unfinished segment to the first of these names that is free, and returns the new path.
pub(super) fn set_aside(storage: &dyn Storage, active: &Path) -> Result<PathBuf, RecordingError> {
    let folder = active.parent().unwrap_or(Path::new("."));
    let name = active.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let name = name.trim_end_matches(ACTIVE);
    let there = storage.list(folder).map_err(|source| RecordingError::io(folder, source))?;
    let name_of = |number: u32| match number {
        1 => format!("{name}{DAMAGED}"),
        number => format!("{name}{DAMAGED}-{number}"),
    };
    let mut names = (1..=MAX_DAMAGED_NAMES).map(name_of);
    let free = names.find(|name| !there.iter().any(|entry| entry.name == *name));
    let free = free.ok_or_else(|| RecordingError::io(active, std::io::ErrorKind::AlreadyExists.into()))?;
    let free = folder.join(free);
    rename_durably(storage, active, &free)?;
    Ok(free)
}

/// Renames a file and makes the new name survive a power cut.
pub(super) fn rename_durably(storage: &dyn Storage, from: &Path, to: &Path) -> Result<(), RecordingError> {
    let folder = to.parent().unwrap_or(Path::new("."));
    storage
        .rename(from, to)
        .and_then(|()| storage.sync_folder(folder))
        .map_err(|source| RecordingError::io(from, source))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_what_is_set_aside_are_known_and_others_are_not() {
        for name in ["0000.mcap.damaged", "0012.mcap.damaged-2", "0012.mcap.damaged-1000"] {
            assert!(is_damaged_name(name), "{name}");
        }
        for name in ["0000.mcap", "x.damaged", "0000.mcap.damaged-", "0000.mcap.damaged-1", "0000.mcap.damaged-02"] {
            assert!(!is_damaged_name(name), "{name}");
        }
    }
}
