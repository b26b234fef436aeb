//! Whose turn it is in a folder of captures.
//!
//! Segments are deleted where somebody else's word says that they may be, and words are given and taken back while that is
//! so. Whoever does either (recorder, sync, prune) looks, decides and acts in one turn: what was seen before it holds no longer.

use std::fs::File;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Until it is dropped, or the process ends.
#[derive(Debug)]
pub struct FolderLock(#[expect(dead_code, reason = "the lock ends with the open file")] File);

impl FolderLock {
    /// Waits for it.
    pub fn in_folder(captures: &Path) -> io::Result<Self> {
        let folder = File::open(captures)?;
        folder.lock()?;
        Ok(Self(folder))
    }

    /// In all of them at once, in an order that is the same for everybody, so that no two wait for each other.
    pub fn in_folders(captures: &[&Path]) -> io::Result<Vec<Self>> {
        let open = |folder: &&Path| {
            let file = File::open(folder)?;
            let is = file.metadata()?;
            Ok(((is.dev(), is.ino()), file))
        };
        let mut folders = captures.iter().map(open).collect::<io::Result<Vec<_>>>()?;
        folders.sort_by_key(|(identity, _)| *identity);
        folders.dedup_by_key(|(identity, _)| *identity);
        folders.into_iter().map(|(_, file)| file.lock().map(|()| Self(file))).collect()
    }
}
