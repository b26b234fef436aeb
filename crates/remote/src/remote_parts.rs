//! Images of databases whose captures lie in an object store.

use std::io;
use std::path::{Path, PathBuf};

use super::address::Address;
use super::copies::{Copies, copy_of};
use super::object_stores::ObjectStores;
use super::part_cache::PartCache;

/// Reads images from object stores: each with one request, or from the cache.
pub struct RemoteParts {
    stores: ObjectStores,
    cache: PartCache,
    copies: Copies,
}

impl RemoteParts {
    /// Reads from these stores, and keeps what was read in the cache and in the copies.
    pub fn new(stores: ObjectStores, cache: PartCache, copies: Copies) -> Self {
        Self { stores, cache, copies }
    }

    /// Reads `length` bytes of an object from `offset` on, which have this CRC-32 if the object is as it was.
    ///
    /// # Errors
    ///
    /// Fails if the path is no address, or the store does not give the bytes. Bytes with another checksum are given as they are, and
    /// not kept.
    pub fn read(&self, object: &Path, offset: u64, length: u32, crc: u32) -> io::Result<Vec<u8>> {
        let address = address_of(object)?;
        if let Some(bytes) = self.cache.get(&address, offset, length, crc) {
            return Ok(bytes);
        }
        let range = offset..offset.saturating_add(u64::from(length));
        let bytes = self.stores.read_range(&address, range).map_err(super::RemoteError::into_io)?;
        if crc32fast::hash(&bytes) == crc {
            self.cache.put(&address, offset, crc, &bytes);
        }
        Ok(bytes)
    }

    /// A whole copy of a folder or an object on this machine; see [`copy_of`].
    ///
    /// # Errors
    ///
    /// Fails if the path is no address, or it cannot be copied.
    pub fn local_copy(&self, folder: &Path, progress: &mut dyn FnMut(u64, u64)) -> io::Result<PathBuf> {
        copy_of(&self.stores, &self.copies, &address_of(folder)?, progress).map_err(super::RemoteError::into_io)
    }
}

/// The address that a path is.
fn address_of(path: &Path) -> io::Result<Address> {
    Address::parse(path.to_str().unwrap_or_default()).map_err(super::RemoteError::into_io)
}
