//! What can go wrong with a database, in words that say what to do.

use std::path::{Path, PathBuf};

use thiserror::Error;

use realitysim_config::ConfigError;
use realitysim_geometry::{FieldError, LensError};
use realitysim_log_input::log::LogError;
use realitysim_recording::{Loss, ReadoutError, RecordingError};
use realitysim_views::ViewError;

#[derive(Debug, Error)]
pub enum DatabaseError {
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    #[error("{}: there is no database here: `realitysim db add CAPTURE --db {}` makes one", path.display(), path.display())]
    None { path: PathBuf },
    #[error("{}: {what}: `realitysim db rebuild` makes it anew from its captures", path.display())]
    Damaged { path: PathBuf, what: String },
    /// Only it says what the database was made of.
    #[error(
        "{}: {what}: move {} away and add its captures again with `realitysim db add`", path.display(), folder.display()
    )]
    Lost { path: PathBuf, what: String, folder: PathBuf },
    #[error("{}: {source}", path.display())]
    Lens { path: PathBuf, source: LensError },
    #[error("{}: {source}", path.display())]
    Field { path: PathBuf, source: FieldError },
    #[error(
        "{}: recorded on the field \"{found}\", but the database holds \"{known}\": a database is of one field; make \
         another", path.display()
    )]
    OtherField { path: PathBuf, found: String, known: String },
    #[error("{}: {what}", path.display())]
    Source { path: PathBuf, what: String },
    #[error("{}: there already; remove it first to read it again", path.display())]
    Known { path: PathBuf },
    #[error("{}: not in the database, which holds: {known}", path.display())]
    Unknown { path: PathBuf, known: String },
    #[error("{}: {what}", path.display())]
    Image { path: PathBuf, what: String },
    #[error("{}: another process is changing this database: wait until it is done", path.display())]
    Busy { path: PathBuf },
    #[error("the database has no image")]
    Empty,
    #[error("nothing was added: {}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Nothing(Vec<Loss>),
    #[error(transparent)]
    View(#[from] ViewError),
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Tags(#[from] ReadoutError),
    #[error(transparent)]
    Session(#[from] RecordingError),
    #[error(transparent)]
    Log(#[from] LogError),
}

pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> DatabaseError {
    let path = path.to_owned();
    move |source| DatabaseError::Io { path, source }
}
