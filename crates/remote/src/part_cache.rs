//! Parts of objects that are kept on this machine.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::SystemTime;

use realitysim_config::plain_file;

use super::address::Address;
use super::error::{RemoteError, io};

/// A folder with parts of objects, bounded in size: what was not used for longest goes first.
///
/// Several programs may use one folder. A file appears as a whole; whether its content is right tells the checksum that each reader
/// brings along.
#[derive(Debug)]
pub struct PartCache {
    folder: PathBuf,
    max_bytes: u64,
    /// Bytes that lie in the folder, as far as this program knows.
    bytes: AtomicU64,
}

/// Share of the bound that is left after parts were removed, so that not each new part looks through the folder.
const KEPT_SHARE: f64 = 0.8;
/// Ending of the files.
const ENDING: &str = "part";

impl PartCache {
    /// Opens a folder of at most `max_bytes`, and makes it if it is not there.
    ///
    /// # Errors
    ///
    /// [`RemoteError::Io`] if the folder cannot be made or read.
    pub fn open(folder: &Path, max_bytes: u64) -> Result<Self, RemoteError> {
        fs::create_dir_all(folder).map_err(io(folder))?;
        let bytes = files_of(folder).map_err(io(folder))?.iter().map(|file| file.bytes).sum();
        let cache = Self { folder: folder.to_owned(), max_bytes, bytes: AtomicU64::new(bytes) };
        cache.make_room();
        Ok(cache)
    }

    /// A part of an object that begins at `offset`, if it is here whole and has this CRC-32.
    pub fn get(&self, address: &Address, offset: u64, length: u32, crc: u32) -> Option<Vec<u8>> {
        let path = self.path_of(address, offset, length, crc);
        let bytes = plain_file::read(&path, u64::from(length)).ok()?;
        if bytes.len() != length as usize || crc32fast::hash(&bytes) != crc {
            let _ = fs::remove_file(&path);
            return None;
        }
        // A time that cannot be set makes the part go earlier, no more.
        let _ = fs::File::options().append(true).open(&path).and_then(|file| file.set_modified(SystemTime::now()));
        Some(bytes)
    }

    /// Keeps a part of an object. A cache that cannot be written is none: the part is read from the store again.
    pub fn put(&self, address: &Address, offset: u64, crc: u32, bytes: &[u8]) {
        let Ok(length) = u32::try_from(bytes.len()) else { return };
        if u64::from(length) > self.max_bytes {
            return;
        }
        let path = self.path_of(address, offset, length, crc);
        let beside = path.with_extension(format!("{}.tmp", std::process::id()));
        let written = fs::File::create(&beside).and_then(|mut file| file.write_all(bytes));
        if written.and_then(|()| fs::rename(&beside, &path)).is_err() {
            let _ = fs::remove_file(&beside);
            return;
        }
        if self.bytes.fetch_add(u64::from(length), Ordering::Relaxed) + u64::from(length) > self.max_bytes {
            self.make_room();
        }
    }

    /// Removes the parts that were not used for longest, if there are too many.
    fn make_room(&self) {
        let Ok(mut files) = files_of(&self.folder) else { return };
        let mut bytes: u64 = files.iter().map(|file| file.bytes).sum();
        if bytes > self.max_bytes {
            files.sort_by_key(|file| file.used);
            let kept = (self.max_bytes as f64 * KEPT_SHARE) as u64;
            for file in files {
                if bytes <= kept {
                    break;
                }
                if fs::remove_file(&file.path).is_ok() {
                    bytes = bytes.saturating_sub(file.bytes);
                }
            }
        }
        self.bytes.store(bytes, Ordering::Relaxed);
    }

    fn path_of(&self, address: &Address, offset: u64, length: u32, crc: u32) -> PathBuf {
        let key = format!("{address}\0{offset}\0{length}\0{crc}");
        self.folder.join(format!("{}.{ENDING}", &blake3::hash(key.as_bytes()).to_hex()[..32]))
    }
}

struct CachedFile {
    path: PathBuf,
    bytes: u64,
    used: SystemTime,
}

/// The files of a cache. Such that vanish meanwhile are passed over.
fn files_of(folder: &Path) -> std::io::Result<Vec<CachedFile>> {
    let entries = fs::read_dir(folder)?.filter_map(Result::ok);
    let files = entries.filter_map(|entry| {
        let metadata = entry.metadata().ok().filter(fs::Metadata::is_file)?;
        let used = metadata.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        Some(CachedFile { path: entry.path(), bytes: metadata.len(), used })
    });
    Ok(files.collect())
}
