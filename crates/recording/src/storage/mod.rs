//! Storage: what the recorder needs of a file system. The same recorder runs on a real disk and on a simulated one
//! that fails on purpose.

mod disk;

use std::any::Any;
use std::io::{self, Read, Seek, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

pub use disk::{Disk, open_plain};

use super::error::RecordingError;

/// A file system. Nothing is safe on the disk until the file was synced, and for its name the folder.
pub trait Storage: Send + Sync {
    /// Makes a folder; fails if it exists.
    fn create_folder(&self, path: &Path) -> io::Result<()>;
    /// Makes a folder that its group may write into, where the file system knows groups; fails if it exists.
    fn create_shared_folder(&self, path: &Path) -> io::Result<()>;
    /// Makes a folder and its parents; one that exists is as good.
    fn create_folders(&self, path: &Path) -> io::Result<()>;
    /// Creates a file to append to; fails if it exists.
    fn create(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>>;
    /// Creates an empty file to append to, whatever was there. Another caller that wants the same name waits until
    /// this file is dropped.
    fn create_over(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>>;
    /// Opens an existing file to append to.
    fn append(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>>;
    /// Opens a plain file for reading; a link is not followed.
    fn read(&self, path: &Path) -> io::Result<Box<dyn Readable>>;
    /// Lists the entries of a folder, by name; links are not followed. A name that is not UTF-8 is shown as well as
    /// possible.
    fn list(&self, folder: &Path) -> io::Result<Vec<Listed>>;
    /// Renames a file; a file that has the new name is replaced.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Removes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;
    /// Makes created, renamed and removed names survive a power cut.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;
    /// Room on the file system that holds this path.
    fn space(&self, path: &Path) -> io::Result<Space>;
    /// Locks a file or folder without waiting; `None` if another holds the lock. It is held until it is dropped or
    /// the process ends.
    fn lock(&self, path: &Path) -> io::Result<Option<Box<dyn Any + Send>>>;
    /// Number of the file system that holds this path, which must exist.
    fn volume(&self, path: &Path) -> io::Result<u64>;
    /// Time of a clock that never goes back; its beginning is arbitrary.
    fn now(&self) -> Duration;
}

/// An open file that can be appended to.
pub trait StoredFile: Send + Sync {
    /// Appends bytes; returns how many were taken.
    fn write(&self, bytes: &[u8]) -> io::Result<usize>;
    /// Forces content and length to disk, as fdatasync does.
    fn sync(&self) -> io::Result<()>;
    /// Sets the length of the file, bytes.
    fn set_len(&self, bytes: u64) -> io::Result<()>;
    /// Whether this path is still that of the file.
    fn is_at(&self, path: &Path) -> io::Result<bool>;
}

/// A file that can be read.
pub trait Readable: Read + Seek + Send {}
impl<T: Read + Seek + Send> Readable for T {}

/// An entry of a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    /// Name of the entry.
    pub name: String,
    /// What it is.
    pub kind: Kind,
}

/// What an entry of a folder is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A plain file, with its size in bytes.
    File(u64),
    /// A folder.
    Folder,
    /// A symbolic link.
    Link,
    /// A socket, device or pipe.
    Other,
}

impl Listed {
    /// Size of a plain file, bytes; `None` for anything else.
    pub fn bytes(&self) -> Option<u64> {
        if let Kind::File(bytes) = self.kind { Some(bytes) } else { None }
    }
}

/// Room on a file system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space {
    /// Size of the file system, bytes.
    pub total_bytes: u64,
    /// Bytes free for users other than root.
    pub free_bytes: u64,
    /// Free inodes; `u64::MAX` where the file system does not count them.
    pub free_inodes: u64,
}

/// Replaces a file as a whole: a power cut leaves the old content or the new. The new content is written beside it,
/// forced to disk, and renamed.
pub fn write_atomically(storage: &dyn Storage, path: &Path, content: &[u8]) -> Result<(), RecordingError> {
    let failed = |source| RecordingError::io(path, source);
    let beside = path.with_extension("new");
    let file = storage.create_over(&beside).map_err(failed)?;
    Appending(Arc::clone(&file)).write_all(content).and_then(|()| file.sync()).map_err(failed)?;
    storage.rename(&beside, path).map_err(failed)?;
    path.parent().map_or(Ok(()), |folder| storage.sync_folder(folder)).map_err(failed)
}

/// Reads a small file; one of more than `max_bytes` is refused.
pub fn read_whole(storage: &dyn Storage, path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    storage.read(path)?.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("larger than {max_bytes} bytes")));
    }
    Ok(bytes)
}

/// Reads a small file as [`read_whole`] does; `None` if there is none.
pub fn read_small(storage: &dyn Storage, path: &Path, max_bytes: u64) -> io::Result<Option<Vec<u8>>> {
    match read_whole(storage, path, max_bytes) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        read => read.map(Some),
    }
}

/// Reads a small file of the real disk as [`read_whole`] does.
pub fn read_plain(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    read_whole(&Disk, path, max_bytes)
}

/// Implements [`Write`] for a stored file.
pub struct Appending(pub Arc<dyn StoredFile>);

impl Write for Appending {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two recorders replace the state of the filter like this.
    #[test]
    fn two_that_replace_one_file_at_once_are_in_nobody_s_way() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("last_state.bin");
        std::thread::scope(|scope| {
            for letter in *b"ab" {
                let path = &path;
                scope.spawn(move || {
                    for length in 1..200 {
                        write_atomically(&Disk, path, &vec![letter; 10 * length]).unwrap();
                        let found = read_plain(path, 1 << 20).unwrap();
                        assert!(
                            found.len().is_multiple_of(10) && found.iter().all(|byte| *byte == found[0]),
                            "two in one"
                        );
                    }
                });
            }
        });
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left beside");
    }
}
