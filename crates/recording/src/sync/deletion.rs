//! Sessions go from a folder of captures: decided on with all the time that reading takes, and once more looked at, in the
//! folders' turn, when they do.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::{SyncError, io};
use super::prune::{Copy, Decision, Goal, decide};
use super::store::{Store, is_as_recorded};
use crate::catalogue::{session_at, sessions_in};
use crate::{FolderLock, Session, is_probe, prove_apart, receiver_of, silence, sync_folder};

/// What may go from `captures`, and why. What lies in one of `copies` whole, by its hash, counts as being elsewhere.
pub struct Removal<'a> {
    captures: &'a Path,
    copies: &'a [PathBuf],
    sessions: &'a [Session],
    /// Of a session that was found whole in a copy, the copy's files as they were then.
    found: BTreeMap<PathBuf, FoundCopy>,
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

/// Device, inode, size and the last change of either content or name: another stamp may be another content.
type Stamp = (u64, u64, u64, i64, i64);

const CHANGED: &str = "changed while it was looked at: prune again";
/// What is on its way out is hidden under this and the session's id.
const HIDDEN: &str = ".pruned-";

impl<'a> Removal<'a> {
    /// Reads every segment of the copies that matters. Nothing is changed, but that a file is written into both folders of a
    /// session, and removed, to prove that they are not one.
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

    /// Deletes what was decided on. What is not as it was any more stays, and says so.
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

    /// Gone from sight in one step. Nobody else deletes in these folders meanwhile, nor relies on what does: each would be the
    /// other's last copy.
    fn hide(&self, session: &Session, relies_on_copy: bool) -> Result<Option<PathBuf>, SyncError> {
        let Self { captures, copies, .. } = self;
        let folders: Vec<&Path> = [*captures].into_iter().chain(copies.iter().map(PathBuf::as_path)).collect();
        let turns = FolderLock::in_folders(&folders).map_err(io(captures))?;
        let relied_on = self.found.get(&session.folder).filter(|_| relies_on_copy);
        let is_as_found = || relied_on.is_none_or(FoundCopy::is_as_found);
        // The folders may be others than those that were looked at: a disk goes, another comes under its name.
        let is_apart = relied_on.is_none_or(|copy| prove_apart(&session.folder, &copy.folder).is_ok());
        if !session_at(&session.folder).is_ok_and(|now| now == *session) || !is_as_found() || !is_apart {
            return Ok(None);
        }
        let held = names_in(&session.folder).map_err(io(&session.folder))?;
        for copy in *copies {
            take_back(session, captures, copy, relies_on_copy, &turns)?;
        }
        if receiver_of(captures).is_some() {
            // A sync does not fetch it again unasked.
            Store::in_turn(captures, &turns)?.note_pruned(session)?;
        }
        let hidden = captures.join(format!("{HIDDEN}{}", session.id.as_str()));
        fs::rename(&session.folder, &hidden).map_err(io(&session.folder))?;
        // Whoever does not know of turns has no way to it any more; what came in the last moment stays with the session.
        // And the copy must be where it was although this has gone.
        if names_in(&hidden).map_err(io(&hidden))? != held || !is_as_found() {
            fs::rename(&hidden, &session.folder).map_err(io(&hidden))?;
            return Ok(None);
        }
        sync_folder(captures)?;
        Ok(Some(hidden))
    }
}

/// Before the session goes: what the copy may have relied on it for holds no longer; and if it goes because the copy was found
/// whole, the copy relies on nobody any more, since everybody else may rely on what goes.
fn take_back(
    session: &Session,
    captures: &Path,
    copy: &Path,
    relies_on_copy: bool,
    turns: &[FolderLock],
) -> Result<(), SyncError> {
    // A folder without a name has given nobody its word.
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

/// What a prune that was killed had begun to delete.
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

/// The other folder's session, if every segment that is here lies there as it was recorded, in another file; or why that is no
/// copy.
fn copy_in(session: &Session, copy: &Path) -> Result<Option<FoundCopy>, String> {
    let Ok((others, _)) = sessions_in(copy) else { return Ok(None) };
    let Some(other) = others.into_iter().find(|other| other.id == session.id) else { return Ok(None) };
    prove_apart(&session.folder, &other.folder).map_err(|why| why.to_string())?;
    let files = whole_in(session, &other);
    Ok(files.map(|files| FoundCopy { folder: other.folder, files }))
}

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
    fn is_as_found(&self) -> bool {
        self.files.iter().all(|file| stamp(&file.path).is_ok_and(|now| now == file.stamp))
    }
}

fn stamp(path: &Path) -> io::Result<Stamp> {
    let is = fs::symlink_metadata(path)?;
    Ok((is.dev(), is.ino(), is.len(), is.ctime(), is.ctime_nsec()))
}

fn names_in(folder: &Path) -> io::Result<Vec<std::ffi::OsString>> {
    let mut names = fs::read_dir(folder)?.map(|entry| Ok(entry?.file_name())).collect::<io::Result<Vec<_>>>()?;
    // Somebody else's proof that this folder is none of theirs comes and goes.
    names.retain(|name| !is_probe(name));
    names.sort();
    Ok(names)
}
