//! The file system of this machine as a [`Storage`].

use std::any::Any;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;
use std::sync::{Arc, LazyLock};
use std::time::{Duration, Instant};

use rustix::fs::{FlockOperation, Mode, OFlags, flock, statvfs};
use rustix::io::Errno;

use super::{Kind, Listed, Readable, Space, Storage, StoredFile};

/// The file system of this machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disk;

/// Permission bits that let the group read, write and enter.
const GROUP_WRITES: u32 = 0o070;

/// Flags for opening a file to write: no link is followed, and no pipe is waited for.
const STAYS: i32 = OFlags::NOFOLLOW.union(OFlags::NONBLOCK).bits() as i32;

/// Longest time to wait for another process that writes the same small file.
const MAX_WAIT: Duration = Duration::from_secs(10);
/// Pause between two attempts to lock that file.
const TURN: Duration = Duration::from_millis(2);

/// Beginning of the clock of [`Storage::now`].
static BEGAN: LazyLock<Instant> = LazyLock::new(Instant::now);

impl Storage for Disk {
    fn create_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)
    }

    fn create_shared_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir(path)?;
        let mode = fs::metadata(path)?.permissions().mode();
        if mode & GROUP_WRITES != GROUP_WRITES {
            // A memory stick knows no groups, and works without.
            let _ = fs::set_permissions(path, fs::Permissions::from_mode(mode | GROUP_WRITES));
        }
        Ok(())
    }

    fn create_folders(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn create(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>> {
        Ok(Arc::new(OpenOptions::new().append(true).create_new(true).open(path)?))
    }

    fn create_over(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>> {
        let began = Instant::now();
        loop {
            let file = OpenOptions::new().write(true).create(true).truncate(false).custom_flags(STAYS).open(path)?;
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                // Another process may have renamed the file that was opened: then it is in use under its new name.
                Ok(()) if StoredFile::is_at(&file, path)? => {
                    File::set_len(&file, 0)?;
                    return Ok(Arc::new(file));
                }
                // On a file system without locks, two writers can collide; the file is written nonetheless.
                Err(Errno::NOLCK | Errno::NOSYS | Errno::OPNOTSUPP) => {
                    File::set_len(&file, 0)?;
                    return Ok(Arc::new(file));
                }
                Ok(()) | Err(Errno::WOULDBLOCK) if began.elapsed() > MAX_WAIT => {
                    return Err(io::ErrorKind::ResourceBusy.into());
                }
                Ok(()) => {}
                Err(Errno::WOULDBLOCK) => std::thread::sleep(TURN),
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn append(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>> {
        Ok(Arc::new(OpenOptions::new().append(true).custom_flags(STAYS).open(path)?))
    }

    fn read(&self, path: &Path) -> io::Result<Box<dyn Readable>> {
        Ok(Box::new(open_plain(path)?))
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Listed>> {
        let mut all = Vec::new();
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            let kind = match entry.metadata() {
                Ok(metadata) if metadata.is_file() => Kind::File(metadata.len()),
                Ok(metadata) if metadata.is_dir() => Kind::Folder,
                Ok(metadata) if metadata.is_symlink() => Kind::Link,
                // The entry has vanished meanwhile.
                Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                _ => Kind::Other,
            };
            all.push(Listed { name: entry.file_name().to_string_lossy().into_owned(), kind });
        }
        all.sort_by(|one, other| one.name.cmp(&other.name));
        Ok(all)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        // The parent of a plain name is the empty path.
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        File::open(folder)?.sync_all()
    }

    fn space(&self, path: &Path) -> io::Result<Space> {
        let found = statvfs(path)?;
        Ok(Space {
            total_bytes: found.f_blocks.saturating_mul(found.f_frsize),
            free_bytes: found.f_bavail.saturating_mul(found.f_frsize),
            free_inodes: if found.f_files == 0 { u64::MAX } else { found.f_favail },
        })
    }

    fn lock(&self, path: &Path) -> io::Result<Option<Box<dyn Any + Send>>> {
        let file = File::open(path)?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => Ok(Some(Box::new(file))),
            Err(Errno::WOULDBLOCK) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    fn volume(&self, path: &Path) -> io::Result<u64> {
        Ok(fs::metadata(path)?.dev())
    }

    fn now(&self) -> Duration {
        BEGAN.elapsed()
    }
}

/// Opens a plain file for reading. A link, a device or a pipe is refused: it is neither followed nor waited for.
pub fn open_plain(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = rustix::fs::open(path, flags, Mode::empty()).map_err(|error| match error {
        rustix::io::Errno::LOOP => io::Error::other("a link: not followed"),
        error => error.into(),
    })?;
    let file = File::from(file);
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("not a plain file"));
    }
    Ok(file)
}

impl StoredFile for File {
    fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        Write::write(&mut &*self, bytes)
    }

    fn sync(&self) -> io::Result<()> {
        self.sync_data()
    }

    fn set_len(&self, bytes: u64) -> io::Result<()> {
        File::set_len(self, bytes)
    }

    fn is_at(&self, path: &Path) -> io::Result<bool> {
        let own = self.metadata()?;
        match fs::symlink_metadata(path) {
            Ok(there) => Ok((own.dev(), own.ino()) == (there.dev(), there.ino())),
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => Ok(false),
            Err(error) => Err(error),
        }
    }
}
