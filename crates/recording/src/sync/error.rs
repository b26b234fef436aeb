//! What can go wrong, in words that say what to do.

use std::path::{Path, PathBuf};

use thiserror::Error;

#[derive(Debug, Error)]
pub enum SyncError {
    #[error("{0}")]
    Source(String),
    #[error("{path}: {source}")]
    Io { path: PathBuf, source: std::io::Error },
    #[error(transparent)]
    Recording(#[from] crate::RecordingError),
    #[error("{captures} belongs to the capture {session}: name another folder")]
    IntoCapture { captures: PathBuf, session: PathBuf },
    #[error("{0}: another sync of the same source into the same folder is running")]
    Busy(String),
    #[error("rsync is not there: install it (Debian: apt-get install rsync), on the robot too")]
    NoRsync,
    /// Worth another try: the link may come back.
    #[error("{source_name}: {said}")]
    Link { source_name: String, said: String },
    /// Not there: not yet, or not any more.
    #[error("{source_name}: {said}")]
    Absent { source_name: String, said: String },
    /// The same would happen again.
    #[error("{source_name}: {said}")]
    Refused { source_name: String, said: String },
    #[error("no session at {source_name} is called {asked}…; there are: {there}")]
    NoSuchSession { source_name: String, asked: String, there: String },
}

impl SyncError {
    pub fn is_link(&self) -> bool {
        matches!(self, Self::Link { .. })
    }
}

pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> SyncError {
    let path = path.to_owned();
    move |source| SyncError::Io { path, source }
}
