//! Errors of a catalogue, with texts that say what to do.

use std::path::{Path, PathBuf};

use thiserror::Error;

use super::file::FORMAT;
use realitysim_database::DatabaseError;
use realitysim_log_input::log::LogError;
use realitysim_recording::RecordingError;

/// What can go wrong with a catalogue.
#[derive(Debug, Error)]
pub enum CatalogueError {
    /// A file or folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// Another process is changing the catalogue.
    #[error("{}: another process is changing this catalogue: wait until it is done", path.display())]
    Busy {
        /// The catalogue's folder.
        path: PathBuf,
    },
    /// A file of the catalogue was written by a newer version of this program.
    #[error(
        "{}: of catalogue format {format}, and this program knows {FORMAT}: use the program that wrote it, or another folder",
        path.display()
    )]
    Newer {
        /// The file.
        path: PathBuf,
        /// Its format.
        format: u64,
    },
    /// A folder is no capture or holds none, or what its `session.json` says is impossible.
    #[error("{}: {what}", path.display())]
    Source {
        /// The folder or file.
        path: PathBuf,
        /// What is wrong, and what would be right.
        what: String,
    },
    /// The folder holds no catalogue.
    #[error("{}: there is no catalogue here: `realitysim catalogue rebuild CAPTURES -o {}` makes one", path.display(), path.display())]
    None {
        /// The folder.
        path: PathBuf,
    },
    /// A file is no whole Parquet file of a catalogue.
    #[error("{}: no whole file of a catalogue: {what}: `realitysim catalogue rebuild` makes it anew", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// A Parquet file lies in the catalogue's folders and is not its own.
    #[error("{}: another program's Parquet file among those of the catalogue: move it elsewhere", path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// Rows cannot be written as Parquet.
    #[error("the rows cannot be written: {0}")]
    Write(#[from] parquet::errors::ParquetError),
    /// The tags of a capture cannot be read.
    #[error(transparent)]
    Tags(#[from] DatabaseError),
    /// A capture cannot be read, or a file of the catalogue cannot be replaced.
    #[error(transparent)]
    Session(#[from] RecordingError),
    /// The log of a capture cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
}

/// Turns an I/O error into one that names the path.
pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> CatalogueError {
    let path = path.to_owned();
    move |source| CatalogueError::Io { path, source }
}

/// Turns an error of a reader into one that names the file.
pub(super) fn damaged<E: std::fmt::Display>(path: &Path) -> impl Fn(E) -> CatalogueError + '_ {
    move |error| CatalogueError::Damaged { path: path.to_owned(), what: error.to_string() }
}
