//! The folder of captures that recordings are synced into. A file that has its final name here was verified on the
//! disk before.
//!
//! The folder `.sync/` holds the receiver's name, what was pruned, and for each source what is known of it (`known/`)
//! and what is not whole yet (`incoming/`).

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use rustix::fs::{Mode, OFlags};
use serde::{Deserialize, Serialize};

use super::error::{SyncError, io};
use super::name::receiver;
use super::plan::{Item, TransferReason};
use super::source::Source;
use super::source_state::SourceState;
use crate::sessions::{session_at, sessions_in};
use crate::storage::{open_plain, read_plain};
use crate::{
    ACK_ENDING, ACK_FOLDER, Acknowledgement, COVERAGE_FILE, FolderLock, MANIFEST_FILE, METADATA_FILE, ManifestLine,
    RECEIVED_FILE, Received, SESSION_FILE, SYNC_FOLDER, Session, SetAside, session_holding, silence, sync_folder,
    write_atomically,
};

/// File in `.sync/` that lists sessions that were deleted here.
const PRUNED_FILE: &str = "pruned.jsonl";
/// Largest file beside segments that is copied, bytes.
pub(super) const MAX_SMALL_BYTES: u64 = 64 << 20;
/// Most names tried for a file that is moved aside.
const MAX_ASIDE: u32 = 10_000;
/// Most damaged files that are remembered; further ones are fetched in each round.
const MAX_DAMAGED_FILES: usize = 10_000;

/// A folder of captures as a receiver.
#[derive(Debug)]
pub struct Store {
    captures: PathBuf,
    state: PathBuf,
    receiver: String,
    /// Files that came with a wrong hash during this process, as their sources had them then.
    damaged: Mutex<BTreeSet<String>>,
}

/// Result of verifying a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum VerifyOutcome {
    /// The file is as recorded, and acknowledged.
    Verified,
    /// The file has another hash; it is not put in place.
    Damaged,
}

/// A session that was deleted here.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Pruned {
    /// Identity of the session.
    pub id: String,
    /// Name of its folder.
    pub name: String,
}

impl Store {
    /// Opens a folder of captures, and makes it if it does not exist. A folder within a session is refused.
    pub fn open(captures: &Path) -> Result<Self, SyncError> {
        if let Some(session) = session_holding(captures) {
            return Err(SyncError::IntoCapture { captures: captures.to_owned(), session });
        }
        fs::create_dir_all(captures).map_err(io(captures))?;
        let turn = FolderLock::in_folder(captures).map_err(io(captures))?;
        Self::in_turn(captures, &[turn])
    }

    /// Opens a folder of captures whose lock the caller holds; `_turns` proves that.
    pub(super) fn in_turn(captures: &Path, _turns: &[FolderLock]) -> Result<Self, SyncError> {
        let state = captures.join(SYNC_FOLDER);
        fs::create_dir_all(&state).map_err(io(&state))?;
        real_folder(&state)?;
        let receiver = receiver(&state)?;
        Ok(Self { captures: captures.to_owned(), state, receiver, damaged: Mutex::default() })
    }

    /// Name of this folder as a receiver.
    pub fn receiver(&self) -> &str {
        &self.receiver
    }

    /// The folder of captures.
    pub fn captures(&self) -> &Path {
        &self.captures
    }

    /// Sessions in the folder, and what is no session.
    pub fn sessions(&self) -> Result<(Vec<Session>, Vec<SetAside>), SyncError> {
        sessions_in(&self.captures).map_err(io(&self.captures))
    }

    /// Sessions that were deleted here; they are not fetched again unasked.
    pub fn pruned(&self) -> Vec<Pruned> {
        pruned_in(&self.state)
    }

    /// Notes that a session is being deleted here.
    pub(super) fn note_pruned(&self, session: &Session) -> Result<(), SyncError> {
        let note = Pruned { id: session.id.as_str().to_owned(), name: session.name.clone() };
        let line = serde_json::to_string(&note).map_err(crate::RecordingError::from)?;
        let path = self.state.join(PRUNED_FILE);
        append(&path, &(line + "\n")).map_err(io(&path))
    }

    /// Opens the place of a source and locks it.
    pub fn open_source_state(&self, source: &Source) -> Result<SourceState, SyncError> {
        SourceState::open(&self.state, source)
    }

    /// Remembers a file that came damaged, with its state at the source.
    pub fn note_damaged(&self, file: String) {
        let mut damaged = self.damaged.lock().unwrap_or_else(PoisonError::into_inner);
        if damaged.len() < MAX_DAMAGED_FILES {
            damaged.insert(file);
        }
    }

    /// Whether a file in this state came damaged before.
    pub fn came_damaged(&self, file: &str) -> bool {
        self.damaged.lock().unwrap_or_else(PoisonError::into_inner).contains(file)
    }

    /// Free bytes on the disk; `None` if the disk does not say.
    pub fn free_bytes(&self) -> Option<u64> {
        let stat = rustix::fs::statvfs(&self.captures).ok()?;
        Some(stat.f_bavail.saturating_mul(stat.f_frsize))
    }

    /// Verifies a file that has come and puts it in place.
    ///
    /// The file is forced onto the disk, read back and compared. Only then it gets its name, a line in the manifest,
    /// and an acknowledgement: wherever this is interrupted, nothing is acknowledged that is not there.
    pub fn place(&self, staged: &Path, item: &Item, head: &[u8]) -> Result<VerifyOutcome, SyncError> {
        if !is_as_recorded(staged, &item.line).map_err(io(staged))? {
            return Ok(VerifyOutcome::Damaged);
        }
        let _turn = self.turn()?;
        let folder = self.session_folder(item, head)?;
        let path = folder.join(&item.line.name);
        if fs::symlink_metadata(&path).is_ok() {
            // Another sync, from another source, was faster; the file keeps its name all the time.
            if is_as_recorded(&path, &item.line).is_ok_and(|whole| whole) {
                sync_folder(&folder)?;
                self.acknowledge_segment(&folder, &item.line)?;
                fs::remove_file(staged).map_err(io(staged))?;
                return Ok(VerifyOutcome::Verified);
            }
            move_aside(&path)?;
        }
        fs::rename(staged, &path).map_err(io(&path))?;
        sync_folder(&folder)?;
        self.acknowledge_segment(&folder, &item.line)?;
        Ok(VerifyOutcome::Verified)
    }

    /// Verifies a file that is in its place already.
    pub fn verify(&self, item: &Item, head: &[u8]) -> Result<VerifyOutcome, SyncError> {
        let _turn = self.turn()?;
        let folder = self.session_folder(item, head)?;
        let path = folder.join(&item.line.name);
        if !is_as_recorded(&path, &item.line).map_err(io(&path))? {
            return Ok(VerifyOutcome::Damaged);
        }
        sync_folder(&folder)?;
        self.acknowledge_segment(&folder, &item.line)?;
        Ok(VerifyOutcome::Verified)
    }

    /// Copies what describes a session whose segments are all here.
    pub fn complete(&self, here: &str, known: &Path) -> Result<(), SyncError> {
        let _turn = self.turn()?;
        let folder = self.captures.join(here);
        real_folder(&folder)?;
        for name in [METADATA_FILE, COVERAGE_FILE] {
            let Ok(bytes) = read_plain(&known.join(name), MAX_SMALL_BYTES) else { continue };
            if read_plain(&folder.join(name), MAX_SMALL_BYTES).is_ok_and(|old| old == bytes) {
                continue;
            }
            write_atomically(&folder.join(name), &bytes)?;
        }
        Ok(())
    }

    /// Path of this store's acknowledgements of a session; the same file is copied to the source.
    pub fn acknowledgements(&self, here: &str) -> PathBuf {
        self.captures.join(here).join(ACK_FOLDER).join(format!("{}{ACK_ENDING}", self.receiver))
    }

    /// Takes acknowledgements back.
    pub fn withdraw(&self, here: &str, which: &[Acknowledgement]) -> Result<(), SyncError> {
        let _turn = self.turn()?;
        let path = self.acknowledgements(here);
        let text = read_plain(&path, MAX_SMALL_BYTES).map_err(io(&path))?;
        let mut kept = Acknowledgement::parse_all(&String::from_utf8_lossy(&text));
        kept.retain(|ack| !which.contains(ack));
        let text: String = kept.iter().map(Acknowledgement::to_line).collect();
        Ok(write_atomically(&path, text.as_bytes())?)
    }

    /// Stops relying on another store's acknowledgements of a session.
    pub fn no_longer_rely_on(&self, session: &Session, receiver: &str) -> Result<(), SyncError> {
        let _turn = self.turn()?;
        self.stop_relying_on(session, receiver)
    }

    /// Does the same for a caller that holds the lock.
    fn stop_relying_on(&self, session: &Session, receiver: &str) -> Result<(), SyncError> {
        if receiver == self.receiver { Ok(()) } else { Ok(silence(session, receiver)?) }
    }

    /// Prepares a session for the deletion of another store's copy that relies on it.
    ///
    /// From then on it is at least as far from the recorder as the copy, which was `hops` away, and relies on nobody.
    /// A store that still has the session acknowledges again if it is farther from the recorder.
    pub(super) fn be_relied_on(&self, session: &Session, hops: u32) -> Result<(), SyncError> {
        for receiver in session.acknowledged.keys() {
            silence(session, receiver)?;
        }
        let received = Received { hops: session.hops().max(hops), receiver: self.receiver.clone() };
        note_received(&session.folder, &received)
    }

    /// All names in the folder, which no new session may get.
    pub fn occupied(&self) -> Vec<String> {
        let entries = fs::read_dir(&self.captures).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    }

    /// Finds the session's folder, or makes it; never another session's, never through a link.
    ///
    /// Its name differs from the planned one if another sync was faster.
    fn session_folder(&self, item: &Item, head: &[u8]) -> Result<PathBuf, SyncError> {
        let Item { here: name, session: id, hops, .. } = item;
        let received = Received { hops: hops.saturating_add(1), receiver: self.receiver.clone() };
        let mut folder = self.captures.join(name);
        let mut there = None;
        if fs::symlink_metadata(&folder).is_ok() {
            real_folder(&folder)?;
            there = session_at(&folder).ok().filter(|session| session.id == *id);
        }
        if there.is_none() {
            there = self.sessions()?.0.into_iter().find(|session| session.id == *id);
        }
        if let Some(ours) = there {
            match &ours.received {
                // The session came here without a sync. As long as it relies on no other store, it may as well have
                // come from that source. In any case this store is noted as the receiver, so that its
                // acknowledgements are not taken for another's if the session is moved.
                None => {
                    let relies = ours.acknowledged.keys().any(|who| *who != self.receiver);
                    let hops = if relies { 0 } else { received.hops };
                    note_received(&ours.folder, &Received { hops, ..received })?;
                }
                // The session was moved or copied here from the folder that received it, whose acknowledgement stands
                // for this very copy.
                Some(old) if old.receiver != self.receiver => {
                    self.stop_relying_on(&ours, &old.receiver)?;
                    note_received(&ours.folder, &Received { hops: old.hops.max(received.hops), ..received })?;
                }
                _ => {}
            }
            return Ok(ours.folder);
        }
        if fs::symlink_metadata(&folder).is_ok() {
            folder = self.captures.join(format!("{name}-{}", id.as_str()));
        }
        // The folder is prepared under another name, so that a power cut leaves no folder without an owner.
        let beside = self.state.join(format!("new-{}", id.as_str()));
        fs::create_dir_all(&beside).map_err(io(&beside))?;
        write_atomically(&beside.join(SESSION_FILE), head)?;
        write_atomically(&beside.join(MANIFEST_FILE), b"")?;
        note_received(&beside, &received)?;
        fs::rename(&beside, &folder).map_err(io(&folder))?;
        sync_folder(&self.captures)?;
        Ok(folder)
    }

    /// Lists a segment in the manifest and acknowledges it.
    fn acknowledge_segment(&self, folder: &Path, line: &ManifestLine) -> Result<(), SyncError> {
        let found = session_at(folder).map_err(|why| io(folder)(io::Error::other(why.why)))?;
        if !found.lines.contains(line) {
            let path = folder.join(MANIFEST_FILE);
            let text = |line: &ManifestLine| serde_json::to_string(line).map(|text| text + "\n");
            let failed = crate::RecordingError::from;
            if found.lines.iter().any(|known| known.name == line.name) {
                // `sessions repair` has made a line for the same bytes. The recorder's line says more.
                let lines = found.lines.iter().map(|known| if known.name == line.name { line } else { known });
                let all: Result<String, _> = lines.map(text).collect();
                write_atomically(&path, all.map_err(failed)?.as_bytes())?;
            } else {
                append(&path, &text(line).map_err(failed)?).map_err(io(&path))?;
            }
        }
        let ack = Acknowledgement::of(line);
        if found.acknowledged.get(&self.receiver).is_some_and(|acks| acks.contains(&ack)) {
            return Ok(());
        }
        let acks = folder.join(ACK_FOLDER);
        if fs::symlink_metadata(&acks).is_err() {
            fs::create_dir(&acks).map_err(io(&acks))?;
            sync_folder(folder)?;
        }
        let name = format!("{}{ACK_ENDING}", self.receiver);
        let path = acks.join(&name);
        append_within(folder, ACK_FOLDER, &name, &ack.to_line()).map_err(io(&path))
    }

    /// Locks the folder of captures.
    fn turn(&self) -> Result<FolderLock, SyncError> {
        FolderLock::in_folder(&self.captures).map_err(io(&self.captures))
    }
}

/// Reads the list of sessions that were deleted here.
fn pruned_in(state: &Path) -> Vec<Pruned> {
    let bytes = read_plain(&state.join(PRUNED_FILE), MAX_SMALL_BYTES).unwrap_or_default();
    String::from_utf8_lossy(&bytes).lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

/// Writes `received.json`.
fn note_received(session: &Path, received: &Received) -> Result<(), SyncError> {
    let text = serde_json::to_vec(received).map_err(crate::RecordingError::from)?;
    Ok(write_atomically(&session.join(RECEIVED_FILE), &text)?)
}

/// Whether a file has the size and the hash that its manifest says, on the disk and not only in memory.
pub fn is_as_recorded(path: &Path, line: &ManifestLine) -> io::Result<bool> {
    let file = open_plain(path)?;
    if file.metadata()?.len() != line.bytes {
        return Ok(false);
    }
    file.sync_all()?;
    // Where the file system does not support this, the content in memory is compared.
    let _ = rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed);
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(&file)?;
    Ok(hasher.finalize().to_hex().as_str() == line.blake3.to_ascii_lowercase())
}

/// Renames `0000.mcap` to `0000.mcap.aside-1` and so on: a file that somebody changed is theirs.
fn move_aside(path: &Path) -> Result<(), SyncError> {
    for number in 1..=MAX_ASIDE {
        let mut aside = path.as_os_str().to_owned();
        aside.push(format!(".aside-{number}"));
        if fs::symlink_metadata(&aside).is_err() {
            return fs::rename(path, &aside).map_err(io(path));
        }
    }
    Err(io(path)(io::Error::from(io::ErrorKind::AlreadyExists)))
}

/// Appends a line behind the last whole line and forces it to disk.
///
/// A line that a power cut has torn is removed. If the disk is full, no torn line stays behind.
fn append(path: &Path, text: &str) -> io::Result<()> {
    append_to(own_file(path)?, text)
}

/// Appends a line to `folder/inner/name` as [`append`] does.
///
/// Each part of the path is opened within the part before it and through no link, so that a link that replaces a
/// folder meanwhile leads nowhere.
fn append_within(folder: &Path, inner: &str, name: &str, text: &str) -> io::Result<()> {
    let as_folder = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let as_file =
        OFlags::RDWR | OFlags::APPEND | OFlags::CREATE | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let folder = rustix::fs::open(folder, as_folder, Mode::empty())?;
    let inner = rustix::fs::openat(&folder, inner, as_folder, Mode::empty())?;
    let file = File::from(rustix::fs::openat(&inner, name, as_file, Mode::from_raw_mode(0o666))?);
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("not a plain file"));
    }
    append_to(file, text)?;
    Ok(rustix::fs::fsync(&inner)?)
}

/// Appends a line to an open file as [`append`] does.
fn append_to(mut file: File, text: &str) -> io::Result<()> {
    let mut old = Vec::new();
    Read::by_ref(&mut file).take(MAX_SMALL_BYTES).read_to_end(&mut old)?;
    if old.len() as u64 == MAX_SMALL_BYTES {
        return Err(io::ErrorKind::FileTooLarge.into());
    }
    let whole = old.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
    let mut text = text.to_owned();
    let mut length = old.len() as u64;
    if serde_json::from_slice::<serde_json::Value>(&old[whole..]).is_ok() {
        text.insert(0, '\n');
    } else if whole < old.len() {
        length = whole as u64;
        file.set_len(length)?;
    }
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    if written.is_err() {
        let _ = file.set_len(length);
    }
    written
}

/// Opens or creates a file of this program to read and append; a link is not followed.
pub(super) fn own_file(path: &Path) -> io::Result<File> {
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits();
    OpenOptions::new().read(true).append(true).create(true).custom_flags(flags as i32).open(path)
}

/// Checks that a path is a folder, and not a link to one.
pub(super) fn real_folder(path: &Path) -> Result<(), SyncError> {
    let metadata = fs::symlink_metadata(path).map_err(io(path))?;
    if metadata.is_dir() { Ok(()) } else { Err(io(path)(io::Error::other("a link or a file, not a folder: not used"))) }
}

impl Item {
    /// Path of the file while it is not whole.
    pub(super) fn staged(&self, source_state: &SourceState) -> PathBuf {
        source_state.incoming.join(&self.there).join(&self.line.name)
    }

    /// Whether the segment has to be transferred.
    pub(super) fn is_fetched(&self) -> bool {
        self.why != TransferReason::Verify
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A link is refused whenever it was put there: nothing looks for links beforehand.
    #[test]
    fn nothing_is_appended_through_a_link() {
        let folder = tempfile::tempdir().expect("a folder");
        let [session, foreign] = ["session", "foreign"].map(|name| folder.path().join(name));
        fs::create_dir_all(session.join("ack")).expect("made");
        fs::create_dir_all(foreign.join("ack")).expect("made");
        append_within(&session, "ack", "a.jsonl", "{}\n").expect("appended");
        append_within(&session, "ack", "a.jsonl", "{}\n").expect("appended");
        assert_eq!(fs::read_to_string(session.join("ack/a.jsonl")).expect("there"), "{}\n{}\n");
        std::os::unix::fs::symlink(&foreign, session.join("inner")).expect("linked");
        append_within(&session, "inner", "a.jsonl", "{}\n").expect_err("through the inner folder");
        std::os::unix::fs::symlink(&foreign, folder.path().join("outer")).expect("linked");
        append_within(&folder.path().join("outer"), "ack", "a.jsonl", "{}\n")
            .expect_err("through the session's folder");
        std::os::unix::fs::symlink(foreign.join("file"), session.join("ack/b.jsonl")).expect("linked");
        append_within(&session, "ack", "b.jsonl", "{}\n").expect_err("through the file");
        assert_eq!(fs::read_dir(&foreign).expect("a folder").count(), 1);
        assert_eq!(fs::read_dir(foreign.join("ack")).expect("a folder").count(), 0);
    }
}
