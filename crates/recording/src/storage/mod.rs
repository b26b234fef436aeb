//! What the recorder asks of a disk, so that the same recorder runs on a real one and on one that fails on purpose.

mod disk;

use std::any::Any;
use std::io::{self, Read, Seek, Write};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

pub use disk::{Disk, open_plain};

use super::error::RecordingError;

/// A file system. Nothing is on the disk before the file, and for its name the folder, was synced.
pub trait Storage: Send + Sync {
    /// Fails if it exists.
    fn create_folder(&self, path: &Path) -> io::Result<()>;
    /// One that the folder's group may write into, where the file system knows groups; fails if it exists.
    fn create_shared_folder(&self, path: &Path) -> io::Result<()>;
    /// With its parents; one that exists is as good.
    fn create_folders(&self, path: &Path) -> io::Result<()>;
    /// A new file to append to; fails if it exists.
    fn create(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>>;
    /// An empty file to append to, whatever was there. Whoever else wants one of this name waits until this one is dropped.
    fn create_over(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>>;
    /// An existing file to append to.
    fn append(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>>;
    /// A plain file; a link is not followed.
    fn read(&self, path: &Path) -> io::Result<Box<dyn Readable>>;
    /// What stands in a folder, by name, links not followed. A name that is no text is shown as well as it can be.
    fn list(&self, folder: &Path) -> io::Result<Vec<Listed>>;
    /// Replaces a file that is there.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    fn remove(&self, path: &Path) -> io::Result<()>;
    /// Makes created, renamed and removed names survive a power cut.
    fn sync_folder(&self, folder: &Path) -> io::Result<()>;
    /// Of the file system that holds this path.
    fn space(&self, path: &Path) -> io::Result<Space>;
    /// Held until it is dropped or the process ends; `None` if another holds it.
    fn lock(&self, path: &Path) -> io::Result<Option<Box<dyn Any + Send>>>;
    /// A number of the file system that holds this path, which must be there.
    fn volume(&self, path: &Path) -> io::Result<u64>;
    /// A clock that never goes back, from any beginning.
    fn now(&self) -> Duration;
}

pub trait StoredFile: Send + Sync {
    fn write(&self, bytes: &[u8]) -> io::Result<usize>;
    /// fdatasync: content and length.
    fn sync(&self) -> io::Result<()>;
    fn set_len(&self, bytes: u64) -> io::Result<()>;
    /// Whether it still is the file of this name.
    fn is_at(&self, path: &Path) -> io::Result<bool>;
}

pub trait Readable: Read + Seek + Send {}
impl<T: Read + Seek + Send> Readable for T {}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    pub name: String,
    pub kind: Kind,
}

/// What something in a folder is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A plain one, of so many bytes.
    File(u64),
    Folder,
    Link,
    /// Sockets, devices, pipes.
    Other,
}

impl Listed {
    /// Of a plain file.
    pub fn bytes(&self) -> Option<u64> {
        if let Kind::File(bytes) = self.kind { Some(bytes) } else { None }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space {
    pub total_bytes: u64,
    /// To users who are not root.
    pub free_bytes: u64,
    /// `u64::MAX` where a file system counts none.
    pub free_inodes: u64,
}

/// The old content or the new, never a part: written beside, forced to disk, renamed.
pub fn write_atomically(storage: &dyn Storage, path: &Path, content: &[u8]) -> Result<(), RecordingError> {
    let failed = |source| RecordingError::io(path, source);
    let beside = path.with_extension("new");
    let file = storage.create_over(&beside).map_err(failed)?;
    Appending(Arc::clone(&file)).write_all(content).and_then(|()| file.sync()).map_err(failed)?;
    storage.rename(&beside, path).map_err(failed)?;
    path.parent().map_or(Ok(()), |folder| storage.sync_folder(folder)).map_err(failed)
}

/// All of a small file; one that is larger is refused.
pub fn read_whole(storage: &dyn Storage, path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    storage.read(path)?.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, format!("larger than {max_bytes} bytes")));
    }
    Ok(bytes)
}

/// The same; `None` if there is none.
pub fn read_small(storage: &dyn Storage, path: &Path, max_bytes: u64) -> io::Result<Option<Vec<u8>>> {
    match read_whole(storage, path, max_bytes) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        read => read.map(Some),
    }
}

/// The same of the real disk.
pub fn read_plain(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    read_whole(&Disk, path, max_bytes)
}

/// A stored file for whoever wants `Write`.
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

    /// As two recorders do with the state of the filter.
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
