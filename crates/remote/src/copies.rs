//! Whole copies of captures, databases and files on this machine.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

use realitysim_recording::{MANIFEST_FILE, ManifestLine};
use serde::{Deserialize, Serialize};

use super::address::Address;
use super::error::{RemoteError, io};
use super::object_stores::{ObjectInfo, ObjectStores, content};

/// The folder of the copies, bounded in size. A copy that a running program uses stays; of the others, the one that was not used for
/// longest goes first.
#[derive(Debug)]
pub struct Copies {
    folder: PathBuf,
    max_bytes: u64,
    /// The copies that this program uses by their addresses, with their locks, which are held until it ends.
    used: Mutex<HashMap<Address, (PathBuf, File)>>,
}

impl Copies {
    /// The copies in a folder, of at most `max_bytes` together. The folder is made once it is needed.
    pub fn new(folder: &Path, max_bytes: u64) -> Self {
        Self { folder: folder.to_owned(), max_bytes, used: Mutex::default() }
    }

    /// Removes copies that no program uses until `bytes` more have room.
    fn make_room(&self, bytes: u64) -> Result<(), RemoteError> {
        let mut others = Vec::new();
        for entry in fs::read_dir(&self.folder).map_err(io(&self.folder))?.filter_map(Result::ok) {
            let path = entry.path();
            let used = fs::metadata(path.join(LOCK)).and_then(|lock| lock.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
            others.push((used, bytes_in(&path), path));
        }
        others.sort();
        let mut total = bytes + others.iter().map(|(_, bytes, _)| bytes).sum::<u64>();
        for (_, bytes, path) in others {
            if total <= self.max_bytes {
                break;
            }
            let Ok(lock) = File::options().append(true).create(true).open(path.join(LOCK)) else { continue };
            if lock.try_lock().is_ok() && fs::remove_dir_all(&path).is_ok() {
                total -= bytes;
            }
        }
        if total <= self.max_bytes {
            return Ok(());
        }
        let (needed, most) = (total.div_ceil(1 << 20), self.max_bytes >> 20);
        let full = format!("{needed} MB would lie here, and at most {most} MB may: set REALITYSIM_CACHE_MB to more");
        Err(io(&self.folder)(std::io::Error::new(std::io::ErrorKind::StorageFull, full)))
    }
}

/// File in a copy's folder that programs lock while they use the copy.
const LOCK: &str = "lock";
/// Folder in a copy's folder with what was copied.
const CONTENT: &str = "content";
/// File in a copy's folder that is being written.
const COMING: &str = "coming";
/// Most times that a copy is looked at anew because it changed.
const MAX_TRIES: usize = 3;
/// File in a copy's folder that says what its files are copies of.
const STATE: &str = "copied.json";
/// Largest state, bytes: a million names.
const MAX_STATE_BYTES: u64 = 256 << 20;
/// Largest manifest, bytes.
const MAX_MANIFEST_BYTES: u64 = 64 << 20;

/// What the files of a copy are copies of, by name.
#[derive(Debug, Default, Serialize, Deserialize)]
struct CopyState {
    files: BTreeMap<String, CopiedFile>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct CopiedFile {
    bytes: u64,
    tag: String,
}

/// Copies a folder, or a single object, to this machine, as far as it is not here as it is there. The result is its path here.
///
/// Segments of a capture are compared with the hashes in its manifest. `progress` gets the number of bytes that have come and that will.
///
/// # Errors
///
/// [`RemoteError`] if nothing lies at the address, the store fails or gives other bytes than the manifest says, or the bound leaves no
/// room.
pub fn copy_of(
    stores: &ObjectStores,
    copies: &Copies,
    address: &Address,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<PathBuf, RemoteError> {
    let mut used = copies.used.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((root, _)) = used.get(address) {
        return Ok(root.clone());
    }
    let folder = copies.folder.join(&blake3::hash(address.as_str().as_bytes()).to_hex()[..16]);
    let root = folder.join(CONTENT).join(plain_name(address)?);
    let there = objects_at(stores, address)?;
    for _ in 0..MAX_TRIES {
        fs::create_dir_all(&folder).map_err(io(&folder))?;
        let lock_path = folder.join(LOCK);
        let lock = File::options().write(true).create(true).truncate(false).open(&lock_path).map_err(io(&lock_path))?;
        // As long as it is shared, no program changes the copy or removes it.
        lock.lock_shared().map_err(io(&lock_path))?;
        if is_current(&folder, &root, &there) && is_locked_at(&lock, &lock_path) {
            let _ = lock.set_modified(SystemTime::now());
            used.insert(address.clone(), (root.clone(), lock));
            return Ok(root);
        }
        lock.unlock().map_err(io(&lock_path))?;
        if lock.try_lock().is_err() {
            let busy = "another program uses the copy of what lay here before: try again once it has ended";
            return Err(content(address, busy.to_owned()));
        }
        update(stores, copies, address, &there, &folder, &root, progress)?;
        lock.unlock().map_err(io(&lock_path))?;
    }
    Err(content(address, "it changes faster than it can be copied, or another program removes the copy".to_owned()))
}

/// Whether a lock is that of the file at its path: another program may have removed the copy, and a new one may be in its place.
fn is_locked_at(lock: &File, path: &Path) -> bool {
    let [ours, there] =
        [lock.metadata(), fs::metadata(path)].map(|metadata| metadata.map(|file| (file.dev(), file.ino())));
    matches!((ours, there), (Ok(ours), Ok(there)) if ours == there)
}

/// Whether all objects are in a copy as they are there.
fn is_current(folder: &Path, root: &Path, there: &[ObjectInfo]) -> bool {
    let state = CopyState::read(folder);
    state.files.len() == there.len() && there.iter().all(|object| state.has(root, object))
}

impl CopyState {
    /// The state of the copy in a folder; empty if there is none.
    fn read(folder: &Path) -> Self {
        let known = realitysim_config::plain_file::read(&folder.join(STATE), MAX_STATE_BYTES).unwrap_or_default();
        serde_json::from_slice(&known).unwrap_or_default()
    }

    /// Whether an object is here as it is there.
    fn has(&self, root: &Path, object: &ObjectInfo) -> bool {
        let known = self.files.get(&object.name);
        known.is_some_and(|known| known.bytes == object.bytes && known.tag == object.tag)
            && fs::metadata(path_in(root, &object.name)).is_ok_and(|here| here.len() == object.bytes)
    }

    fn note(&mut self, object: &ObjectInfo) {
        self.files.insert(object.name.clone(), CopiedFile { bytes: object.bytes, tag: object.tag.clone() });
    }
}

/// Brings a copy up to date.
fn update(
    stores: &ObjectStores,
    copies: &Copies,
    address: &Address,
    there: &[ObjectInfo],
    folder: &Path,
    root: &Path,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<(), RemoteError> {
    let state_path = folder.join(STATE);
    let old = CopyState::read(folder);
    let missing: Vec<&ObjectInfo> = there.iter().filter(|object| !old.has(root, object)).collect();
    let total: u64 = missing.iter().map(|object| object.bytes).sum();
    copies.make_room(total)?;
    // Files that are not there any more belong to no capture.
    for name in old.files.keys().filter(|name| there.iter().all(|object| object.name != **name)) {
        let _ = fs::remove_file(path_in(root, name));
    }
    let mut state = CopyState::default();
    there.iter().filter(|object| old.has(root, object)).for_each(|object| state.note(object));
    let coming = folder.join(COMING);
    let mut hashes = BTreeMap::new();
    let mut done = 0;
    // The manifests come first, since the segments are compared with them.
    let is_manifest = |object: &&&ObjectInfo| last_of(&object.name) == MANIFEST_FILE;
    let (manifests, others): (Vec<&ObjectInfo>, Vec<&ObjectInfo>) =
        missing.iter().partition(|object| is_manifest(object));
    for object in manifests.into_iter().chain(others) {
        let path = path_in(root, &object.name);
        let from = if object.name.is_empty() { address.clone() } else { address.join(&object.name) };
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(io(parent))?;
            hashes.entry(parent.to_owned()).or_insert_with(|| hashes_of(parent));
        }
        let hash = fetch(stores, &from, object.bytes, [&coming, &path], &mut |bytes| {
            done += bytes;
            progress(done, total);
        })?;
        let parent = path.parent().map(Path::to_owned).unwrap_or_default();
        if last_of(&object.name) == MANIFEST_FILE {
            hashes.insert(parent.clone(), hashes_of(&parent));
        }
        if let Some(recorded) = hashes.get(&parent).and_then(|known| known.get(last_of(&object.name)))
            && *recorded != hash
        {
            let _ = fs::remove_file(&path);
            return Err(content(&from, "is not as its manifest says that it was recorded".to_owned()));
        }
        state.note(object);
        let text = serde_json::to_vec(&state).unwrap_or_default();
        fs::write(&state_path, text).map_err(io(&state_path))?;
    }
    Ok(())
}

/// The object at an address, or those below it.
fn objects_at(stores: &ObjectStores, address: &Address) -> Result<Vec<ObjectInfo>, RemoteError> {
    match stores.info(address) {
        Ok(object) => return Ok(vec![object]),
        Err(RemoteError::Absent { .. }) => {}
        Err(error) => return Err(error),
    }
    let listed = stores.list(address)?;
    if listed.is_empty() {
        return Err(RemoteError::Absent { address: address.to_string() });
    }
    match listed.iter().find(|object| !is_plain(&object.name)) {
        None => Ok(listed),
        Some(object) => Err(content(address, format!("{:?} is no name of a file", object.name))),
    }
}

/// Reads an object into a file beside, which gets its path once it is whole. The result is its BLAKE3 hash.
fn fetch(
    stores: &ObjectStores,
    from: &Address,
    bytes: u64,
    [beside, path]: [&Path; 2],
    came: &mut dyn FnMut(u64),
) -> Result<String, RemoteError> {
    let mut file = File::create(beside).map_err(io(beside))?;
    let mut hash = blake3::Hasher::new();
    stores.read_pieces(from, bytes, &mut |piece| {
        hash.update(piece);
        came(piece.len() as u64);
        file.write_all(piece).map_err(io(beside))
    })?;
    fs::rename(beside, path).map_err(io(path))?;
    Ok(hash.finalize().to_hex().to_string())
}

/// The hashes that a manifest in a folder has for its segments.
fn hashes_of(folder: &Path) -> BTreeMap<String, String> {
    let bytes =
        realitysim_config::plain_file::read(&folder.join(MANIFEST_FILE), MAX_MANIFEST_BYTES).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let lines = text.lines().filter_map(|line| serde_json::from_str::<ManifestLine>(line).ok());
    lines.map(|line| (line.name, line.blake3.to_ascii_lowercase())).collect()
}

/// The name of a copy: the last part of its address.
fn plain_name(address: &Address) -> Result<&str, RemoteError> {
    let name = address.name();
    if is_plain(name) { Ok(name) } else { Err(content(address, "names no folder or file".to_owned())) }
}

/// Whether a name is a path that stays within its folder.
fn is_plain(name: &str) -> bool {
    !name.is_empty() && Path::new(name).components().all(|part| matches!(part, Component::Normal(_)))
}

/// The path of an object in a copy; a single object has no name of its own.
fn path_in(root: &Path, name: &str) -> PathBuf {
    if name.is_empty() { root.to_owned() } else { root.join(name) }
}

fn last_of(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or_default()
}

/// Bytes of the files in a folder and below.
fn bytes_in(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let sizes = entries.map(|entry| match entry.metadata() {
        Ok(metadata) if metadata.is_dir() => bytes_in(&entry.path()),
        Ok(metadata) => metadata.len(),
        Err(_) => 0,
    });
    sizes.sum()
}
