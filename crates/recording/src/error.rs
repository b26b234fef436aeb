//! What goes wrong with a recording, and what that is called in counts, logs and `status`.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use thiserror::Error;

use realitysim_ros2::mcap_read::ReadError;
use realitysim_ros2::mcap_write::WriteError;

#[derive(Debug, Error)]
pub enum RecordingError {
    #[error("{path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    #[error("{path}: {}", cannot_be_made(source))]
    Folder { path: PathBuf, source: io::Error },
    #[error("{path}: {source}")]
    Log { path: PathBuf, source: WriteError },
    #[error("{path}: {source}")]
    Read { path: PathBuf, source: ReadError },
    #[error("{}: removed or moved while it was being recorded", .0.display())]
    Removed(PathBuf),
    #[error("session.json: {0}")]
    Json(#[from] serde_json::Error),
    #[error("{path}: not what a session says about itself: {source}")]
    Info { path: PathBuf, source: serde_json::Error },
    #[error("{path}: written by a newer version (format {format}, known is {known})")]
    Newer { path: PathBuf, format: u32, known: u32 },
}

impl RecordingError {
    pub fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    pub fn log(path: &Path, source: WriteError) -> Self {
        Self::Log { path: path.to_owned(), source }
    }

    /// One word for it.
    pub fn cause(&self) -> &'static str {
        match self {
            Self::Io { source, .. }
            | Self::Folder { source, .. }
            | Self::Log { source: WriteError::Io(source), .. } => cause(source),
            Self::Removed(_) => REMOVED,
            _ => "unwritable",
        }
    }

    pub fn already_exists(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == ErrorKind::AlreadyExists)
    }

    /// What is to be written cannot be, on whatever disk.
    pub fn is_of_the_message(&self) -> bool {
        matches!(self, Self::Log { source: WriteError::Mcap(_) | WriteError::TooLarge { .. }, .. })
    }
}

/// Why there is no folder where one was to be made.
pub fn cannot_be_made(error: &io::Error) -> String {
    let why = match error.kind() {
        ErrorKind::NotFound => "no folder can be made there",
        ErrorKind::PermissionDenied => "you may not make a folder there",
        ErrorKind::AlreadyExists => "it is a file, and a folder is needed",
        ErrorKind::NotADirectory => "a part of its path is a file, not a folder",
        ErrorKind::ReadOnlyFilesystem => "no folder can be made there, the disk can only be read",
        _ => return format!("the folder cannot be made: {error}"),
    };
    format!("{why}: choose another place")
}

/// Somebody has taken away what was being written.
pub const REMOVED: &str = "removed";

fn cause(error: &io::Error) -> &'static str {
    // No such device, no such device or address.
    const GONE: [i32; 2] = [19, 6];
    match error.kind() {
        ErrorKind::StorageFull => "disk_full",
        ErrorKind::QuotaExceeded => "disk_quota",
        ErrorKind::FileTooLarge => "file_too_large",
        ErrorKind::ReadOnlyFilesystem => "read_only",
        ErrorKind::PermissionDenied => "no_permission",
        ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::StaleNetworkFileHandle => "disk_gone",
        _ if error.raw_os_error().is_some_and(|code| GONE.contains(&code)) => "disk_gone",
        _ => "disk_error",
    }
}
