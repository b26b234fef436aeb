//! A disk in memory that loses what was not synced, sector by sector, and fails when it is told to.
//!
//! Names: changes of a folder survive a power cut in the order in which they were made, up to some point, as in a
//! journal. Content: of what was not synced, any sector may be old, new, or zero where the file grew. A failed sync
//! marks its sectors as clean, so that a second one reports success and keeps nothing, as ext4, XFS and Btrfs do.

use std::any::Any;
use std::collections::{BTreeMap, BTreeSet};
use std::io::{self, Cursor, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use super::super::storage::{Kind, Listed, Readable, Space, Storage, StoredFile};
use super::prng::Prng;

/// Size of a sector, bytes.
const SECTOR: usize = 512;

/// The disk; its clones are the same disk.
#[derive(Clone)]
pub struct SimulatedDisk(Arc<Mutex<World>>);

/// What goes wrong, by the number of the operation.
#[derive(Clone, Debug, Default)]
pub struct Trouble {
    /// Operations that fail, and how.
    pub fails: Vec<(std::ops::Range<u64>, Failure)>,
    /// The operation at which the power fails.
    pub cut_at: Option<u64>,
    /// One operation in this many takes this long.
    pub stalls: Option<(u64, Duration)>,
    /// Size of the disk, bytes.
    pub capacity_bytes: Option<u64>,
    /// Whether the disk reports that it has no free inodes.
    pub no_inodes: bool,
}

/// How an operation fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// Only syncs of files fail.
    Sync,
    /// Every operation fails with this error.
    Any(ErrorKind),
}

/// State of the disk.
struct World {
    prng: Prng,
    trouble: Trouble,
    operations: u64,
    clock: Duration,
    is_dead: bool,
    names: BTreeMap<PathBuf, Node>,
    /// Names as a power cut would leave them.
    safe_names: BTreeMap<PathBuf, Node>,
    /// Changes of names that are not yet safe, by folder.
    changes: BTreeMap<PathBuf, Vec<Change>>,
    files: Vec<Content>,
    locks: BTreeSet<PathBuf>,
}

/// What a name stands for; a file by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Node {
    Folder,
    File(usize),
}

/// A change of a name.
#[derive(Clone)]
enum Change {
    Put(PathBuf, Node),
    Take(PathBuf),
    Move(PathBuf, PathBuf, Node),
}

/// Content of a file: as it reads now, and as it is safe on the disk.
#[derive(Clone, Default)]
struct Content {
    now: Vec<u8>,
    safe: Vec<u8>,
    /// Sectors that are not safe.
    dirty: BTreeSet<usize>,
    length_is_dirty: bool,
}

impl SimulatedDisk {
    pub fn new(seed: u64, trouble: Trouble) -> Self {
        let names = BTreeMap::from([(PathBuf::from("/"), Node::Folder)]);
        Self(Arc::new(Mutex::new(World {
            prng: Prng::new(seed),
            trouble,
            operations: 0,
            clock: Duration::ZERO,
            is_dead: false,
            safe_names: names.clone(),
            names,
            changes: BTreeMap::new(),
            files: Vec::new(),
            locks: BTreeSet::new(),
        })))
    }

    /// Restores the power: what is left is what the disk holds.
    pub fn restart(&self) {
        let mut world = self.world();
        let World { prng, files, safe_names, changes, .. } = &mut *world;
        for changes in changes.values() {
            let kept = prng.below(changes.len() as u64 + 1) as usize;
            changes[..kept].iter().for_each(|change| change.apply(safe_names));
        }
        let keeps = [0, 50, 95, 100][prng.below(4) as usize];
        for file in files {
            file.survive(prng, keeps);
        }
        let folders: BTreeSet<PathBuf> =
            safe_names.iter().filter(|(_, node)| **node == Node::Folder).map(|(path, _)| path.clone()).collect();
        safe_names.retain(|path, _| path.ancestors().skip(1).all(|folder| folders.contains(folder)));
        world.names = world.safe_names.clone();
        world.changes.clear();
        world.locks.clear();
        world.is_dead = false;
        world.trouble = Trouble::default();
    }

    /// Ends all trouble.
    pub fn heal(&self) {
        self.world().trouble = Trouble::default();
    }

    /// Sets what goes wrong from now on.
    pub fn trouble(&self, trouble: Trouble) {
        self.world().trouble = trouble;
    }

    /// Whether the power has failed.
    pub fn is_dead(&self) -> bool {
        self.world().is_dead
    }

    /// Number of operations so far.
    pub fn operations(&self) -> u64 {
        self.world().operations
    }

    /// Advances the clock.
    pub fn pass(&self, time: Duration) {
        self.world().clock += time;
    }

    /// Removes a path and everything in it, as somebody else might.
    pub fn remove_all(&self, path: &Path) {
        let mut world = self.world();
        let World { names, safe_names, changes, .. } = &mut *world;
        names.retain(|name, _| !name.starts_with(path));
        safe_names.retain(|name, _| !name.starts_with(path));
        changes.retain(|folder, _| !folder.starts_with(path));
    }

    /// All files with their content.
    pub fn snapshot(&self) -> BTreeMap<PathBuf, Vec<u8>> {
        let world = self.world();
        let content = |node: &Node| match node {
            Node::Folder => Vec::new(),
            Node::File(id) => world.files[*id].now.clone(),
        };
        world.names.iter().map(|(path, node)| (path.clone(), content(node))).collect()
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.0.lock().unwrap()
    }

    fn make(&self, path: &Path, node: impl FnOnce(&mut World) -> Node) -> io::Result<Node> {
        let mut world = self.world();
        world.operate(false)?;
        world.parent_of(path)?;
        if world.names.contains_key(path) {
            return Err(ErrorKind::AlreadyExists.into());
        }
        let node = node(&mut world);
        world.change(path, Change::Put(path.to_owned(), node));
        Ok(node)
    }

    fn file(&self, node: Node) -> Arc<dyn StoredFile> {
        let Node::File(id) = node else { unreachable!("a file") };
        Arc::new(SimulatedFile { disk: self.clone(), id })
    }
}

fn new_file(world: &mut World) -> Node {
    world.files.push(Content::default());
    Node::File(world.files.len() - 1)
}

impl World {
    /// Counts an operation and lets it fail if that is due.
    fn operate(&mut self, is_sync: bool) -> io::Result<()> {
        self.operations += 1;
        self.clock += Duration::from_micros(100);
        if let Some((one_in, time)) = self.trouble.stalls
            && self.prng.below(one_in) == 0
        {
            self.clock += time;
        }
        if self.trouble.cut_at.is_some_and(|at| self.operations >= at) {
            self.is_dead = true;
        }
        if self.is_dead {
            return Err(io::Error::other("the power is gone"));
        }
        let failure = self.trouble.fails.iter().find(|(range, _)| range.contains(&self.operations));
        match failure {
            Some((_, Failure::Sync)) if is_sync => Err(io::Error::other("input/output error")),
            Some((_, Failure::Any(kind))) => Err((*kind).into()),
            _ => Ok(()),
        }
    }

    fn parent_of(&self, path: &Path) -> io::Result<()> {
        match self.names.get(path.parent().unwrap()) {
            Some(Node::Folder) => Ok(()),
            _ => Err(ErrorKind::NotFound.into()),
        }
    }

    fn change(&mut self, path: &Path, change: Change) {
        change.apply(&mut self.names);
        self.changes.entry(path.parent().unwrap().to_owned()).or_default().push(change);
    }

    fn find(&self, path: &Path) -> io::Result<Node> {
        self.names.get(path).copied().ok_or_else(|| ErrorKind::NotFound.into())
    }

    fn used(&self) -> u64 {
        let bytes = |node: &Node| if let Node::File(id) = node { self.files[*id].now.len() as u64 } else { 0 };
        self.names.values().map(bytes).sum()
    }
}

impl Change {
    fn apply(&self, names: &mut BTreeMap<PathBuf, Node>) {
        match self {
            Self::Put(path, node) => drop(names.insert(path.clone(), *node)),
            Self::Take(path) => drop(names.remove(path)),
            Self::Move(from, to, node) => {
                names.remove(from);
                names.insert(to.clone(), *node);
            }
        }
    }
}

impl Content {
    fn write(&mut self, bytes: &[u8]) {
        let from = self.now.len();
        self.now.extend(bytes);
        self.touch(from);
    }

    fn set_len(&mut self, length: usize) {
        self.now.resize(length, 0);
        self.dirty.retain(|sector| sector * SECTOR < length);
        self.length_is_dirty = true;
    }

    fn touch(&mut self, from: usize) {
        self.length_is_dirty = true;
        self.dirty.extend(from / SECTOR..self.now.len().div_ceil(SECTOR));
    }

    fn sync(&mut self) {
        self.safe.resize(self.now.len(), 0);
        for sector in std::mem::take(&mut self.dirty) {
            self.save(sector);
        }
        self.length_is_dirty = false;
    }

    /// Fails a sync: some sectors are safe nonetheless, and the others will never be tried again.
    fn fail_to_sync(&mut self, prng: &mut Prng) {
        for sector in std::mem::take(&mut self.dirty) {
            if prng.below(2) == 0 {
                self.safe.resize(self.safe.len().max(self.now.len().min((sector + 1) * SECTOR)), 0);
                self.save(sector);
            }
        }
    }

    fn save(&mut self, sector: usize) {
        let range = sector * SECTOR..self.now.len().min((sector + 1) * SECTOR);
        self.safe[range.clone()].copy_from_slice(&self.now[range]);
    }

    /// Leaves of the content what survives a power cut: each unsafe sector with a probability of `keeps_percent`.
    fn survive(&mut self, prng: &mut Prng, keeps_percent: u64) {
        if self.length_is_dirty {
            let [least, most] = [self.safe.len().min(self.now.len()), self.safe.len().max(self.now.len())];
            let length = match prng.below(3) {
                0 => self.safe.len(),
                1 => self.now.len(),
                _ => least + prng.below((most - least) as u64 + 1) as usize,
            };
            self.safe.resize(length, 0);
        }
        for sector in std::mem::take(&mut self.dirty) {
            if prng.below(100) < keeps_percent && sector * SECTOR < self.safe.len() {
                let end = ((sector + 1) * SECTOR).min(self.safe.len()).min(self.now.len());
                let range = sector * SECTOR..end.max(sector * SECTOR);
                self.safe[range.clone()].copy_from_slice(&self.now[range]);
            }
        }
        self.length_is_dirty = false;
        self.now = self.safe.clone();
    }
}

impl Storage for SimulatedDisk {
    fn create_folder(&self, path: &Path) -> io::Result<()> {
        self.make(path, |_| Node::Folder).map(drop)
    }

    fn create_shared_folder(&self, path: &Path) -> io::Result<()> {
        self.create_folder(path)
    }

    fn create_folders(&self, path: &Path) -> io::Result<()> {
        if self.world().names.get(path) == Some(&Node::Folder) { Ok(()) } else { self.create_folder(path) }
    }

    fn create(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>> {
        Ok(self.file(self.make(path, new_file)?))
    }

    fn create_over(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>> {
        match self.make(path, new_file) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                let file = self.append(path)?;
                file.set_len(0)?;
                Ok(file)
            }
            made => Ok(self.file(made?)),
        }
    }

    fn append(&self, path: &Path) -> io::Result<Arc<dyn StoredFile>> {
        let node = {
            let mut world = self.world();
            world.operate(false)?;
            world.find(path)?
        };
        Ok(self.file(node))
    }

    fn read(&self, path: &Path) -> io::Result<Box<dyn Readable>> {
        let world = self.world();
        match world.find(path)? {
            Node::File(id) => Ok(Box::new(Cursor::new(world.files[id].now.clone()))),
            Node::Folder => Err(ErrorKind::IsADirectory.into()),
        }
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<Listed>> {
        let world = self.world();
        world.find(folder)?;
        let inside = world.names.iter().filter(|(path, _)| path.parent() == Some(folder));
        let listed = inside.map(|(path, node)| {
            let kind = match node {
                Node::Folder => Kind::Folder,
                Node::File(id) => Kind::File(world.files[*id].now.len() as u64),
            };
            Listed { name: path.file_name().unwrap().to_str().unwrap().to_owned(), kind }
        });
        Ok(listed.collect())
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut world = self.world();
        world.operate(false)?;
        let node = world.find(from)?;
        world.change(to, Change::Move(from.to_owned(), to.to_owned(), node));
        Ok(())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        let mut world = self.world();
        world.operate(false)?;
        world.find(path)?;
        world.change(path, Change::Take(path.to_owned()));
        Ok(())
    }

    fn sync_folder(&self, folder: &Path) -> io::Result<()> {
        let mut world = self.world();
        world.operate(false)?;
        world.find(folder)?;
        for change in world.changes.remove(folder).unwrap_or_default() {
            change.apply(&mut world.safe_names);
        }
        Ok(())
    }

    fn space(&self, _: &Path) -> io::Result<Space> {
        let world = self.world();
        let total_bytes = world.trouble.capacity_bytes.unwrap_or(1 << 40);
        let free_bytes = total_bytes.saturating_sub(world.used());
        Ok(Space { total_bytes, free_bytes, free_inodes: if world.trouble.no_inodes { 0 } else { u64::MAX } })
    }

    fn lock(&self, path: &Path) -> io::Result<Option<Box<dyn Any + Send>>> {
        let mut world = self.world();
        world.find(path)?;
        if !world.locks.insert(path.to_owned()) {
            return Ok(None);
        }
        drop(world);
        Ok(Some(Box::new(Lock { disk: self.clone(), path: path.to_owned() })))
    }

    fn volume(&self, path: &Path) -> io::Result<u64> {
        self.world().find(path).map(|_| 0)
    }

    fn now(&self) -> Duration {
        self.world().clock
    }
}

struct Lock {
    disk: SimulatedDisk,
    path: PathBuf,
}

impl Drop for Lock {
    fn drop(&mut self) {
        self.disk.world().locks.remove(&self.path);
    }
}

struct SimulatedFile {
    disk: SimulatedDisk,
    id: usize,
}

impl StoredFile for SimulatedFile {
    fn write(&self, bytes: &[u8]) -> io::Result<usize> {
        let mut world = self.disk.world();
        let done = world.operate(false);
        let free = world.trouble.capacity_bytes.map_or(u64::MAX, |capacity| capacity.saturating_sub(world.used()));
        // A write that fails may have written something; one that succeeds may have written less than asked.
        let most = if done.is_err() { world.prng.below(bytes.len() as u64 + 1) } else { bytes.len() as u64 };
        let written = most.min(free) as usize;
        if !world.is_dead {
            world.files[self.id].write(&bytes[..written]);
        }
        done?;
        if written == 0 && !bytes.is_empty() { Err(ErrorKind::StorageFull.into()) } else { Ok(written) }
    }

    fn sync(&self) -> io::Result<()> {
        let mut world = self.disk.world();
        let done = world.operate(true);
        let World { files, prng, is_dead, .. } = &mut *world;
        match &done {
            Ok(()) => files[self.id].sync(),
            Err(_) if !*is_dead => files[self.id].fail_to_sync(prng),
            Err(_) => {}
        }
        done
    }

    fn set_len(&self, bytes: u64) -> io::Result<()> {
        let mut world = self.disk.world();
        world.operate(false)?;
        world.files[self.id].set_len(bytes as usize);
        Ok(())
    }

    fn is_at(&self, path: &Path) -> io::Result<bool> {
        Ok(self.disk.world().names.get(path) == Some(&Node::File(self.id)))
    }
}
