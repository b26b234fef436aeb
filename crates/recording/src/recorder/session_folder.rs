//! The folder of a session: it is made with the first entry, and another one is begun if somebody removes it.

use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::Recorder;
use crate::acknowledgement::ACK_FOLDER;
use crate::error::RecordingError;
use crate::identity::SessionId;
use crate::manifest::{MANIFEST_FILE, SESSION_FILE};
use crate::storage::{Storage, write_atomically};

/// What has become of a folder that the recorder has made.
pub(super) enum FolderState {
    /// The folder is there.
    Present,
    /// The folder of all captures is gone as well, and may come back.
    Unreachable,
    /// Somebody has removed or moved the session's folder.
    Removed,
}

/// Most names tried for a session's folder: `name`, `name-2`, and so on.
const MAX_SUFFIX: u32 = 10_000;
/// Time that a folder of captures may be away before another is made in its place, on the same file system.
const PATIENCE: Duration = Duration::from_secs(5);

impl Recorder {
    /// Makes folder, session file and manifest when they are needed first. Each step can be repeated after a failure.
    pub(super) fn open_session(&mut self) -> Result<PathBuf, RecordingError> {
        let storage = self.storage.as_ref();
        let captures = &self.plan.captures;
        let failed = |source| RecordingError::io(captures, source);
        let folder = match &self.folder {
            Some(folder) => folder.clone(),
            None => {
                let unmade = |source| RecordingError::Folder { path: captures.clone(), source };
                storage.create_folders(captures).map_err(unmade)?;
                self.volume = storage.volume(captures).ok();
                let folder = new_folder(storage, captures, &self.plan.name)?;
                self.folder = Some(folder.clone());
                folder
            }
        };
        if !self.is_ready {
            if self.plan.is_synced_from {
                create_shared_folder(storage, &folder.join(ACK_FOLDER))?;
            }
            write_atomically(storage, &folder.join(SESSION_FILE), &serde_json::to_vec_pretty(&self.plan.info)?)?;
            storage.sync_folder(captures).map_err(failed)?;
            // The folder of all captures may be new as well.
            captures.parent().map_or(Ok(()), |parent| storage.sync_folder(parent)).map_err(failed)?;
            // A repair that holds the lock will soon be done, and the recorder tries again.
            let busy = || RecordingError::io(&folder, io::ErrorKind::ResourceBusy.into());
            self.lock = Some(storage.lock(&folder.join(SESSION_FILE)).map_err(failed)?.ok_or_else(busy)?);
            self.is_ready = true;
            self.shared.update(|status| status.session = Some(folder.clone()));
        }
        if self.manifest.is_none() {
            let path = folder.join(MANIFEST_FILE);
            let mut text = Vec::new();
            for line in &self.lines {
                serde_json::to_writer(&mut text, line)?;
                text.push(b'\n');
            }
            write_atomically(storage, &path, &text)?;
            self.manifest = Some(storage.append(&path).map_err(|source| RecordingError::io(&path, source))?);
        }
        Ok(folder)
    }

    /// Finds out what has become of the session's folder.
    ///
    /// If it is gone while the folder of all captures is there, on the same file system, somebody has removed or
    /// moved it. If the folder of all captures is gone as well, it may come back, as a disk that was unplugged does,
    /// and is waited for.
    pub(super) fn find_folder(&mut self, folder: &Path) -> FolderState {
        let (storage, captures) = (self.storage.as_ref(), &self.plan.captures);
        let is_missing =
            |error: io::Error| matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory);
        let is_gone = match self.is_ready {
            true => storage.read(&folder.join(SESSION_FILE)).is_err_and(is_missing),
            // The session's file is not written yet, so the folder itself is looked for.
            false => storage.volume(folder).is_err_and(is_missing),
        };
        if !is_gone {
            self.away_since = None;
            return FolderState::Present;
        }
        let now = storage.now();
        let away_since = *self.away_since.get_or_insert(now);
        let near = captures.ancestors().skip(1).find_map(|folder| storage.volume(non_empty(folder)).ok());
        let is_removed = match storage.volume(captures) {
            Ok(volume) => Some(volume) == self.volume,
            Err(_) => near == self.volume && now.saturating_sub(away_since) >= PATIENCE,
        };
        if is_removed { FolderState::Removed } else { FolderState::Unreachable }
    }

    /// Begins another session, with an identity of its own: if the old folder was only moved, there are two sessions.
    /// The content of the old one counts as lost, and a gap in the new one says so.
    pub(super) fn begin_new_session(&mut self) {
        let mut content = std::mem::take(&mut self.finished_content);
        content.join(std::mem::take(&mut self.open_content));
        self.report_removed(content);
        (self.folder, self.lock, self.manifest, self.away_since) = (None, None, None, None);
        (self.is_ready, self.next_index) = (false, 0);
        self.lines.clear();
        self.topics.clear();
        self.cuts.clear();
        if let Some(id) = &mut self.plan.info.id {
            SessionId::new().as_str().clone_into(id);
        }
        if let Some(next_ns) = self.kept.iter().find_map(|kept| kept.waiting.entry.log_time_ns()) {
            let started = jiff::Timestamp::from_nanosecond(i128::from(next_ns)).unwrap_or_default();
            self.plan.info.started = started.to_string();
            self.plan.name = folder_name(started, &self.plan.info.robot);
        }
        self.shared.request_segment();
    }
}

/// Name of a session's folder: the time of its first message and the robot's name.
pub fn folder_name(started: jiff::Timestamp, robot: &str) -> String {
    format!("{}-{robot}", started.strftime("%Y-%m-%dT%H-%M-%SZ"))
}

/// Path that can be opened: the parent of a plain name is the empty path, and stands for `.`.
fn non_empty(path: &Path) -> &Path {
    if path.as_os_str().is_empty() { Path::new(".") } else { path }
}

/// Makes the session's folder, with a suffix if the name is taken.
fn new_folder(storage: &dyn Storage, captures: &Path, name: &str) -> Result<PathBuf, RecordingError> {
    for suffix in 1..=MAX_SUFFIX {
        let folder = captures.join(if suffix == 1 { name.to_owned() } else { format!("{name}-{suffix}") });
        match storage.create_folder(&folder) {
            Ok(()) => return Ok(folder),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(source) => return Err(RecordingError::Folder { path: folder, source }),
        }
    }
    let source = io::Error::from(io::ErrorKind::AlreadyExists);
    Err(RecordingError::Io { path: captures.join(name), source })
}

/// Makes a folder that the group may write into; one that exists is as good.
fn create_shared_folder(storage: &dyn Storage, path: &Path) -> Result<(), RecordingError> {
    match storage.create_shared_folder(path) {
        Err(source) if source.kind() != io::ErrorKind::AlreadyExists => {
            Err(RecordingError::Folder { path: path.to_owned(), source })
        }
        _ => Ok(()),
    }
}
