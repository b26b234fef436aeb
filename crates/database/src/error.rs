//! Errors of a database, with texts that say what to do.

use std::path::{Path, PathBuf};

use thiserror::Error;

use realitysim_config::ConfigError;
use realitysim_geometry::{FieldError, LensError};
use realitysim_log_input::log::LogError;
use realitysim_recording::{Loss, ReadoutError, RecordingError};
use realitysim_views::ViewError;

/// What can go wrong with a database.
#[derive(Debug, Error)]
pub enum DatabaseError {
    /// A file or folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// The folder holds no database.
    #[error("{}: there is no database here: `realitysim db add CAPTURE --db {}` makes one", path.display(), path.display())]
    None {
        /// The folder.
        path: PathBuf,
    },
    /// The index or a mask is damaged. It can be rebuilt from the sources.
    #[error("{}: {what}: `realitysim db rebuild` makes it anew from its captures", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// `database.json` is damaged. It cannot be rebuilt, because only it names the sources.
    #[error(
        "{}: {what}: move {} away and add its captures again with `realitysim db add`", path.display(), folder.display()
    )]
    Lost {
        /// The contents.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
        /// The database's folder.
        folder: PathBuf,
    },
    /// The lens of a source is not possible.
    #[error("{}: {source}", path.display())]
    Lens {
        /// The source.
        path: PathBuf,
        /// What is wrong.
        source: LensError,
    },
    /// The field of a source or of the database is not possible.
    #[error("{}: {source}", path.display())]
    Field {
        /// The source or database.
        path: PathBuf,
        /// What is wrong.
        source: FieldError,
    },
    /// A source was recorded on another field than the rest of the database.
    #[error(
        "{}: recorded on the field \"{found}\", but the database holds \"{known}\": a database is of one field; make \
         another", path.display()
    )]
    OtherField {
        /// The source.
        path: PathBuf,
        /// Title of the source's field.
        found: String,
        /// Title of the database's field.
        known: String,
    },
    /// A path is not a source that can be added.
    #[error("{}: {what}", path.display())]
    Source {
        /// The path, or a file in it.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// The source is in the database already, or contains one that is.
    #[error("{}: there already; remove it first to read it again", path.display())]
    Known {
        /// The path that was given.
        path: PathBuf,
    },
    /// The source to be removed is not in the database.
    #[error("{}: not in the database, which holds: {known}", path.display())]
    Unknown {
        /// The path that was given.
        path: PathBuf,
        /// The sources of the database, separated by commas.
        known: String,
    },
    /// An image or a mask cannot be used.
    #[error("{}: {what}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Another process is changing the database.
    #[error("{}: another process is changing this database: wait until it is done", path.display())]
    Busy {
        /// The database's folder.
        path: PathBuf,
    },
    /// The database has no image.
    #[error("the database has no image")]
    Empty,
    /// None of the sources has a usable image; the losses say why.
    #[error("nothing was added: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Nothing(Vec<Loss>),
    /// No training set can be made of the images.
    #[error("{0}")]
    Training(String),
    /// No view can be made of the images.
    #[error(transparent)]
    View(#[from] ViewError),
    /// A field or lens file is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The tags of a capture cannot be read.
    #[error(transparent)]
    Tags(#[from] ReadoutError),
    /// A capture cannot be read, or a file of the database cannot be replaced.
    #[error(transparent)]
    Session(#[from] RecordingError),
    /// The log of a capture cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
}

/// Turns an I/O error into one that names the path.
pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> DatabaseError {
    let path = path.to_owned();
    move |source| DatabaseError::Io { path, source }
}
