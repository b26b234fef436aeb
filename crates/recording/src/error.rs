//! Errors of a recording, and the names of their causes in counts, logs and `status`.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use thiserror::Error;

use realitysim_ros2::mcap_read::ReadError;
use realitysim_ros2::mcap_write::WriteError;

/// Why something could not be recorded, read or repaired.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}")]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A folder could not be made.
    #[error("{path}: {}", cannot_be_made(source))]
    Folder {
        /// The folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A segment could not be written.
    #[error("{path}: {source}")]
    Log {
        /// The segment.
        path: PathBuf,
        /// Error of the writer.
        source: WriteError,
    },
    /// A segment could not be read.
    #[error("{path}: {source}")]
    Read {
        /// The segment.
        path: PathBuf,
        /// Error of the reader.
        source: ReadError,
    },
    /// A file or folder was removed or moved while it was being recorded.
    #[error("{}: removed or moved while it was being recorded", .0.display())]
    Removed(PathBuf),
    /// A file of the session could not be encoded.
    #[error("session.json: {0}")]
    Json(#[from] serde_json::Error),
    /// `session.json` does not parse.
    #[error("{path}: not what a session says about itself: {source}")]
    Info {
        /// The file.
        path: PathBuf,
        /// Error of the parser.
        source: serde_json::Error,
    },
    /// `session.json` has another format version than this program knows.
    #[error("{path}: written by a newer version (format {format}, known is {known})")]
    Newer {
        /// The file.
        path: PathBuf,
        /// Version of the file.
        format: u32,
        /// Version that this program knows.
        known: u32,
    },
}

impl RecordingError {
    /// Error of the file system at a path.
    pub fn io(path: &Path, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    /// Error of writing a segment at a path.
    pub fn log(path: &Path, source: WriteError) -> Self {
        Self::Log { path: path.to_owned(), source }
    }

    /// Name of the cause, one word.
    pub fn cause(&self) -> &'static str {
        match self {
            Self::Io { source, .. }
            | Self::Folder { source, .. }
            | Self::Log { source: WriteError::Io(source), .. } => cause(source),
            Self::Removed(_) => REMOVED,
            _ => "unwritable",
        }
    }

    /// Whether a file or folder of that name exists already.
    pub fn already_exists(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == ErrorKind::AlreadyExists)
    }

    /// Whether the message itself cannot be written, whatever the disk.
    pub fn is_of_the_message(&self) -> bool {
        matches!(self, Self::Log { source: WriteError::Mcap(_) | WriteError::TooLarge { .. }, .. })
    }
}

/// Explains why a folder could not be made, and what to do.
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

/// Cause of [`RecordingError::Removed`].
pub const REMOVED: &str = "removed";

/// Name of the cause of an error of the file system.
fn cause(error: &io::Error) -> &'static str {
    // ENODEV and ENXIO of Linux.
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
