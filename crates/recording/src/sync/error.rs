//! Errors of a sync, in words that say what to do.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why a sync failed.
#[derive(Debug, Error)]
pub enum SyncError {
    /// The text is not a source.
    #[error("{0}")]
    Source(String),
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A file of a session could not be written.
    #[error(transparent)]
    Recording(#[from] crate::RecordingError),
    /// The folder to sync into belongs to a session.
    #[error("{captures} belongs to the capture {session}: name another folder")]
    IntoCapture {
        /// The folder to sync into.
        captures: PathBuf,
        /// The session.
        session: PathBuf,
    },
    /// Another sync of the same source into the same folder is running; with the source.
    #[error("{0}: another sync of the same source into the same folder is running")]
    Busy(String),
    /// The program rsync is not installed.
    #[error("rsync is not there: install it (Debian: apt-get install rsync), on the robot too")]
    NoRsync,
    /// The link to the source broke. Another try may succeed.
    #[error("{source_name}: {said}")]
    Link {
        /// The source.
        source_name: String,
        /// What was said about it.
        said: String,
    },
    /// The source does not exist, not yet or not any more.
    #[error("{source_name}: {said}")]
    Absent {
        /// The source.
        source_name: String,
        /// What was said about it.
        said: String,
    },
    /// The source or the disk refused. Another try would fail in the same way.
    #[error("{source_name}: {said}")]
    Refused {
        /// The source.
        source_name: String,
        /// What was said about it.
        said: String,
    },
    /// No session of the source has a name that begins like this.
    #[error("no session at {source_name} is called {asked}…; there are: {there}")]
    NoSuchSession {
        /// The source.
        source_name: String,
        /// Beginning of the name.
        asked: String,
        /// Names of the sessions there.
        there: String,
    },
}

impl SyncError {
    /// Whether the link is at fault, so that another try may succeed.
    pub fn is_link(&self) -> bool {
        matches!(self, Self::Link { .. })
    }
}

/// Makes an error of the file system at a path.
pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> SyncError {
    let path = path.to_owned();
    move |source| SyncError::Io { path, source }
}
