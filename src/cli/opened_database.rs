//! A database for a command that takes a capture as well: that of a folder, or one made of the capture for the while.

use std::path::Path;

use tempfile::TempDir;

use super::output;
use crate::config::Settings;
use crate::database::{self, Contents, DatabaseError, ImageDatabase, TagLimits};
use crate::recording::Loss;

/// An open database, and what was lost when it was made.
pub struct OpenedDatabase {
    /// The database.
    pub database: ImageDatabase,
    /// What of the capture could not be read.
    pub lost: Vec<Loss>,
    /// Holds the database of a single capture, and is removed at the end.
    _made: Option<TempDir>,
}

impl OpenedDatabase {
    /// Opens the database in a folder, or makes one of a capture, with poses whose place is known to `max_sigma_m` metres.
    pub fn of(input: &Path, max_sigma_m: f64) -> anyhow::Result<Self> {
        let mut progress = output::Progress::new("reading");
        let opened = Self::read(input, max_sigma_m, &mut |done| progress.set(done, None));
        progress.finish();
        opened
    }

    /// Does the same as [`Self::of`]; `done` gets the number of images read so far of a capture.
    pub fn read(input: &Path, max_sigma_m: f64, done: &mut dyn FnMut(u64)) -> anyhow::Result<Self> {
        let settings = Settings::default().views;
        match Contents::read(input) {
            // A capture, or a path that `add` says more of.
            Err(DatabaseError::None { .. }) => {}
            Err(DatabaseError::Io { .. }) if !input.is_dir() => {}
            _ => return Ok(Self { database: ImageDatabase::open(input, &settings)?, lost: Vec::new(), _made: None }),
        }
        let made = tempfile::tempdir()?;
        let limits = TagLimits { sigma_m: max_sigma_m, ..TagLimits::default() };
        let added = database::add(made.path(), &[input.to_owned()], None, limits, done)?;
        let database = ImageDatabase::open(made.path(), &settings)?;
        Ok(Self { database, lost: added.losses, _made: Some(made) })
    }
}
