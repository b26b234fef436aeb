//! Captures that do not lie on this machine, such as those in an object store. Another crate reads them.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Reads files that no operating system opens: their paths are addresses, such as `s3://bucket/captures/session/0000.mcap`.
pub trait RemoteFiles: Send + Sync {
    /// Whether a path is such an address.
    fn is_remote(&self, path: &Path) -> bool;

    /// Reads `length` bytes of a file from `offset` on, which have this CRC-32 if the file is as it was.
    ///
    /// # Errors
    ///
    /// Fails if the bytes cannot be had.
    fn read(&self, file: &Path, offset: u64, length: u32, crc: u32) -> io::Result<Vec<u8>>;

    /// A copy of a folder or a file on this machine, which stays until the program ends.
    ///
    /// # Errors
    ///
    /// Fails if it cannot be copied.
    fn local_copy(&self, folder: &Path) -> io::Result<PathBuf>;
}

static REMOTE_FILES: OnceLock<Box<dyn RemoteFiles>> = OnceLock::new();

/// States how remote files are read. A program does so once, before it opens a database; without it there are none.
pub fn set_remote_files(files: Box<dyn RemoteFiles>) {
    // The first one stays.
    let _ = REMOTE_FILES.set(files);
}

/// The reader of a path, if it is an address of a remote file.
pub(super) fn reader_of(path: &Path) -> Option<&'static dyn RemoteFiles> {
    REMOTE_FILES.get().map(Box::as_ref).filter(|files| files.is_remote(path))
}

/// Whether something lies at a path. What is remote is there until reading it fails.
pub(super) fn exists(path: &Path) -> bool {
    reader_of(path).is_some() || path.exists()
}

/// The path of a file or folder on this machine: its own, or that of a copy.
pub(super) fn local(path: &Path) -> io::Result<PathBuf> {
    match reader_of(path) {
        Some(files) => files.local_copy(path),
        None => path.canonicalize(),
    }
}

/// The absolute path of a source: an address stays as it is.
pub(super) fn absolute(path: &Path) -> io::Result<PathBuf> {
    match reader_of(path) {
        // A slash at the end names the same folder.
        Some(_) => Ok(PathBuf::from(path.to_string_lossy().trim_end_matches('/'))),
        None => path.canonicalize(),
    }
}
