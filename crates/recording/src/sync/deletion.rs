//! Deletion of sessions from a folder of captures.
//!
//! It is decided without a lock, since reading takes long, and checked again under the locks of all folders right
//! before a session is deleted.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::{SyncError, io};
use super::prune::{Copy, Decision, Goal, decide};
use super::store::{Store, is_as_recorded};
use crate::sessions::{session_at, sessions_in};
use crate::{FolderLock, Session, is_probe, prove_distinct, receiver_of, silence, sync_folder};

/// What may be deleted from a folder of captures, and why.
///
/// A session that lies whole, by its hashes, in one of the folders `copies` counts as being elsewhere.
pub struct Removal<'a> {
    captures: &'a Path,
    copies: &'a [PathBuf],
    sessions: &'a [Session],
    /// Copies that were found whole, by the session's folder, with their files as they were then.
    found: BTreeMap<PathBuf, FoundCopy>,
    /// What is to become of each session.
    pub decisions: Vec<Decision>,
}

/// A session's folder in another folder of captures, proven to be other storage, and its files.
#[derive(Clone, Debug)]
struct FoundCopy {
    folder: PathBuf,
    files: Vec<Found>,
}

/// A file that was read and found as recorded.
#[derive(Clone, Debug)]
struct Found {
    path: PathBuf,
    stamp: Stamp,
}

/// Device, inode, size and the last change of content or name (s, ns). Another stamp may mean other content.
type Stamp = (u64, u64, u64, i64, i64);

/// Reason why a session stays that changed between decision and deletion.
const CHANGED: &str = "changed while it was looked at: prune again";
/// Beginning of the hidden name of a session that is being deleted; its id follows.
const HIDDEN: &str = ".pruned-";

impl<'a> Removal<'a> {
    /// Decides on every session, and reads for that every segment of the copies that matters.
    ///
    /// Nothing is changed, except that a probe file is written into both folders of a session, and removed, to prove
    /// that they are different storage.
    pub fn plan(captures: &'a Path, copies: &'a [PathBuf], sessions: &'a [Session], goal: &Goal) -> Self {
        let found = RefCell::new(BTreeMap::new());
        let copy_of = |session: &Session| {
            let mut answer = Copy::None;
            for copy in copies {
                match copy_in(session, copy) {
                    Ok(Some(whole)) => {
                        found.borrow_mut().insert(session.folder.clone(), whole);
                        return Copy::Whole;
                    }
                    Ok(None) => {}
                    Err(why) => answer = Copy::Doubted(why),
                }
            }
            answer
        };
        let decisions = decide(sessions, receiver_of(captures).as_deref(), &copy_of, goal);
        Self { captures, copies, sessions, found: found.into_inner(), decisions }
    }

    /// Deletes what was decided on. A session that has changed since stays, and its decision says so.
    pub fn carry_out(&mut self) -> Result<(), SyncError> {
        finish_earlier(self.captures)?;
        for index in 0..self.decisions.len() {
            let decision = &self.decisions[index];
            let Some(session) = self.sessions.iter().find(|it| decision.goes && it.name == decision.session) else {
                continue;
            };
            match self.hide(session, decision.relies_on_copy)? {
                Some(hidden) => fs::remove_dir_all(&hidden).map_err(io(&hidden))?,
                None => {
                    let decision = &mut self.decisions[index];
                    (decision.goes, decision.why) = (false, CHANGED.to_owned());
                }
            }
        }
        Ok(())
    }

    /// Hides a session in one step, by renaming its folder; `None` if something has changed since the decision.
    ///
    /// Under the locks of all folders nobody else deletes a copy that this deletion relies on, or relies on the one
    /// that is deleted.
    fn hide(&self, session: &Session, relies_on_copy: bool) -> Result<Option<PathBuf>, SyncError> {
        let Self { captures, copies, .. } = self;
        let folders: Vec<&Path> = [*captures].into_iter().chain(copies.iter().map(PathBuf::as_path)).collect();
        let turns = FolderLock::in_folders(&folders).map_err(io(captures))?;
        let relied_on = self.found.get(&session.folder).filter(|_| relies_on_copy);
        let is_as_found = || relied_on.is_none_or(FoundCopy::is_as_found);
        // The folders may be others than before: a disk may be unplugged and another appear under its name.
        let is_apart = relied_on.is_none_or(|copy| prove_distinct(&session.folder, &copy.folder).is_ok());
        if !session_at(&session.folder).is_ok_and(|now| now == *session) || !is_as_found() || !is_apart {
            return Ok(None);
        }
        let held = names_in(&session.folder).map_err(io(&session.folder))?;
        for copy in *copies {
            take_back(session, captures, copy, relies_on_copy, &turns)?;
        }
        if receiver_of(captures).is_some() {
            // So that a sync does not fetch the session again unasked.
            Store::in_turn(captures, &turns)?.note_pruned(session)?;
        }
        let hidden = captures.join(format!("{HIDDEN}{}", session.id.as_str()));
        fs::rename(&session.folder, &hidden).map_err(io(&session.folder))?;
        // A program that does not use the locks cannot reach the session any more. If it has changed something in the
        // last moment, the session stays; so it does if the copy is not where it was, now that this folder is hidden.
        if names_in(&hidden).map_err(io(&hidden))? != held || !is_as_found() {
            fs::rename(&hidden, &session.folder).map_err(io(&hidden))?;
            return Ok(None);
        }
        sync_folder(captures)?;
        Ok(Some(hidden))
    }
}

/// Corrects the acknowledgements in a copy before the session is deleted.
///
/// What the copy has on record from this folder holds no longer. If the session is deleted because the copy was found
/// whole, all acknowledgements in the copy are taken back, since other stores may rely on the session that is
/// deleted.
fn take_back(
    session: &Session,
    captures: &Path,
    copy: &Path,
    relies_on_copy: bool,
    turns: &[FolderLock],
) -> Result<(), SyncError> {
    // A folder without a name as a receiver has acknowledged nothing.
    let own = receiver_of(captures).unwrap_or_default();
    let (others, _) = sessions_in(copy).map_err(io(copy))?;
    for other in others.iter().filter(|other| other.id == session.id) {
        let is_relying = other.acknowledged.values().any(|acks| !acks.is_empty());
        if relies_on_copy && (is_relying || other.hops() < session.hops()) {
            Store::in_turn(copy, turns)?.be_relied_on(other, session.hops())?;
        } else {
            silence(other, &own)?;
        }
    }
    Ok(())
}

/// Deletes what a prune that was killed had hidden.
fn finish_earlier(captures: &Path) -> Result<(), SyncError> {
    let _turn = FolderLock::in_folder(captures).map_err(io(captures))?;
    for entry in fs::read_dir(captures).map_err(io(captures))?.flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_string_lossy().starts_with(HIDDEN) {
            fs::remove_dir_all(entry.path()).map_err(io(&entry.path()))?;
        }
    }
    Ok(())
}

/// Finds the session in another folder of captures, with every segment as it was recorded and in another file; the
/// error says why what was found does not count as a copy.
fn copy_in(session: &Session, copy: &Path) -> Result<Option<FoundCopy>, String> {
    let Ok((others, _)) = sessions_in(copy) else { return Ok(None) };
    let Some(other) = others.into_iter().find(|other| other.id == session.id) else { return Ok(None) };
    prove_distinct(&session.folder, &other.folder).map_err(|why| why.to_string())?;
    let files = whole_in(session, &other);
    Ok(files.map(|files| FoundCopy { folder: other.folder, files }))
}

/// Files of the other session, if each segment lies there as it was recorded.
fn whole_in(session: &Session, other: &Session) -> Option<Vec<Found>> {
    let here = session.lines.iter().filter(|line| session.segments.contains_key(&line.name));
    let found = here.map(|line| {
        let path = other.folder.join(&line.name);
        let (own, there) = (stamp(&session.folder.join(&line.name)).ok()?, stamp(&path).ok()?);
        let is_another = (own.0, own.1) != (there.0, there.1);
        (is_another && is_as_recorded(&path, line).ok()?).then_some(Found { path, stamp: there })
    });
    found.collect()
}

impl FoundCopy {
    /// Whether no file has changed since it was read.
    fn is_as_found(&self) -> bool {
        self.files.iter().all(|file| stamp(&file.path).is_ok_and(|now| now == file.stamp))
    }
}

fn stamp(path: &Path) -> io::Result<Stamp> {
    let is = fs::symlink_metadata(path)?;
    Ok((is.dev(), is.ino(), is.len(), is.ctime(), is.ctime_nsec()))
}

/// Names of the entries of a folder, sorted.
fn names_in(folder: &Path) -> io::Result<Vec<std::ffi::OsString>> {
    let mut names = fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name())).collect::<io::Result<Vec<_>>>()?;
    // Probe files of other programs come and go.
    names.retain(|name| !is_probe(name));
    names.sort();
    Ok(names)
}
