//! The lock of a folder of captures, or of a catalogue.
//!
//! Recorder, sync and prune delete segments because of acknowledgements, and give and take acknowledgements. Each of
//! them reads, decides and acts while it holds this lock: what was read before may no longer be true.

use std::fs::{File, TryLockError};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Exclusive lock of a folder of captures, held until it is dropped or the process ends.
#[derive(Debug)]
pub struct FolderLock(File);

/// Unlocks explicitly: closing the file is not enough while a process that is just being started has a copy of it.
impl Drop for FolderLock {
    fn drop(&mut self) {
        let _ = self.0.unlock();
    }
}

impl FolderLock {
    /// Waits for the lock of one folder.
    pub fn in_folder(captures: &Path) -> io::Result<Self> {
        let folder = File::open(captures)?;
        folder.lock()?;
        Ok(Self(folder))
    }

    /// Takes the lock of one folder without waiting; `None` if another process has it.
    pub fn try_in_folder(folder: &Path) -> io::Result<Option<Self>> {
        let folder = File::open(folder)?;
        match folder.try_lock() {
            Ok(()) => Ok(Some(Self(folder))),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(error),
        }
    }

    /// Waits for the locks of several folders. All callers lock them in the same order, by device and inode, so that
    /// no two wait for each other.
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
