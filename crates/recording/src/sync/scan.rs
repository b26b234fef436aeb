//! Scan of a source: its sessions, and what lies in their folders.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::error::SyncError;
use super::listing::Entry;
use super::rsync::{Ended, Rsync};
use super::source_state::SourceState;
use super::sync_pass::Report;
use crate::sessions::{Kind, is_plain_name, sessions_in};
use crate::{Session, SetAside, is_segment_name};

/// A source at one moment.
pub(super) struct SourceScan {
    /// Sessions at the source, with the files in their folders.
    pub sessions: Vec<Session>,
    /// Sizes and times of files, by path, as rsync prints them: they only tell whether a file has changed.
    pub stamps: BTreeMap<String, String>,
}

/// Scans a source: fetches what describes its sessions, then lists their folders.
pub(super) fn scan(rsync: &Rsync, source_state: &SourceState, report: &mut Report) -> Result<SourceScan, SyncError> {
    // An acknowledgement that became a link at the source would otherwise stay here as it was.
    source_state.forget_acknowledgements()?;
    // In this order: a recorder renames a segment before it writes the line, so that what the manifest lists is there
    // when the folder is listed.
    if let Ended::Partly(said) = rsync.heads(&source_state.known)? {
        report.set_aside.push(SetAside::new(rsync.source.shown(), said));
    }
    let (entries, ended) = rsync.list()?;
    let shown = PathBuf::from(rsync.source.shown());
    let as_there =
        |path: &Path| path.strip_prefix(&source_state.known).map_or_else(|_| path.to_owned(), |rest| shown.join(rest));
    let (mut sessions, strange) = sessions_in(&source_state.known)
        .map_err(|source| SyncError::Io { path: source_state.known.clone(), source })?;
    report.set_aside.extend(strange.into_iter().map(|it| SetAside::new(as_there(&it.path), it.why)));
    for session in &mut sessions {
        session.folder = as_there(&session.folder);
        for it in &mut session.set_aside {
            it.path = as_there(&it.path);
        }
    }
    if let Ended::Partly(said) = ended {
        let unread = leave_out_unread(&mut sessions, &entries, &said);
        if let [first, ..] = unread.as_slice() {
            report.failed = Some(first.to_string());
        }
        report.set_aside.extend(unread);
    }
    let mut stamps = BTreeMap::new();
    for entry in entries {
        if let Kind::File(_) = entry.kind {
            stamps.insert(entry.path.clone(), entry.stamp.clone());
        }
        let (folder, name) = entry.path.split_once('/').map_or((entry.path.as_str(), None), |(a, b)| (a, Some(b)));
        let session = sessions.iter_mut().find(|session| session.name == folder);
        if let (None, Some(name), Kind::File(_)) = (&session, name, entry.kind) {
            // The segment belongs to no session that can be read, so that nobody can say what it should be.
            report.left_there += u64::from(is_plain_name(folder) && is_segment_name(name));
        }
        match (session, name, entry.kind) {
            // A link there is not a folder to acknowledge into.
            (Some(session), Some(name), kind) => session.note(name, kind),
            (_, None, Kind::Link | Kind::Other) => {
                report.set_aside.push(SetAside::new(shown.join(folder), "a link or a device: not followed"));
            }
            (None, None, Kind::Folder) if !is_plain_name(folder) || !source_state.known.join(folder).exists() => {
                report.set_aside.push(SetAside::new(shown.join(folder), "no session: left alone"));
            }
            _ => {}
        }
    }
    Ok(SourceScan { sessions, stamps })
}

/// Leaves out sessions whose folder could not be listed: such a folder is not empty, and nothing is taken back
/// because of it.
fn leave_out_unread(sessions: &mut Vec<Session>, entries: &[Entry], said: &str) -> Vec<SetAside> {
    let is_read = |session: &Session| {
        entries.iter().any(|entry| entry.path.split_once('/').is_some_and(|(folder, _)| folder == session.name))
    };
    let (read, unread): (Vec<_>, Vec<_>) = std::mem::take(sessions).into_iter().partition(is_read);
    *sessions = read;
    unread.into_iter().map(|session| SetAside::new(session.folder, format!("cannot be looked into: {said}"))).collect()
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use crate::sessions::session_at;

    #[test]
    fn a_folder_that_cannot_be_read_is_not_taken_for_an_empty_one() {
        let captures = tempfile::tempdir().unwrap();
        let mut sessions = Vec::new();
        for name in ["read", "unread"] {
            let folder = captures.path().join(name);
            fs::create_dir(&folder).unwrap();
            fs::write(folder.join("session.json"), r#"{"format":1,"robot":"r","started":"t"}"#).unwrap();
            sessions.push(session_at(&folder).unwrap());
        }
        let entry = |path: &str, kind| Entry { path: path.to_owned(), kind, stamp: String::new() };
        let entries =
            [entry("read", Kind::Folder), entry("read/session.json", Kind::File(40)), entry("unread", Kind::Folder)];
        let aside = leave_out_unread(&mut sessions, &entries, "Permission denied");
        assert_eq!(sessions.iter().map(|session| session.name.as_str()).collect::<Vec<_>>(), ["read"]);
        assert!(aside.len() == 1 && aside[0].to_string().contains("unread: cannot be looked into: Permission denied"));
    }
}
