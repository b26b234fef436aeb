//! `database.json`: what a database was made of, and which index belongs to it. Replacing this file is the moment at
//! which a change takes effect.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::{DatabaseError, io};
use super::index::{Index, path_of};
use realitysim_config::plain_file;
use realitysim_geometry::{FieldDimensions, LensParameters};
use realitysim_recording::write_atomically;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Catalogue {
    pub format: u32,
    /// Of the index file; counts up with every change.
    pub index: u64,
    pub field: FieldDimensions,
    pub sources: Vec<Source>,
}

/// A capture or a folder of images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    pub kind: SourceKind,
    /// Absolute.
    pub path: PathBuf,
    pub lens: LensParameters,
    /// Relative to `path`; empty if `path` is the file itself.
    pub files: Vec<PathBuf>,
    /// PNGs that hide the robot's own body, whatever its head does: in the database's folder, or with their whole path.
    pub body_masks: Vec<String>,
    /// A PNG in the database's folder, black where no image was ever lit: outside of the lens's circle.
    pub dark: Option<String>,
    /// How the lens darkens its images towards their border, if that shows in them: k1 to k3 of
    /// [`realitysim_views::Vignetting`].
    #[serde(default)]
    pub darkening: Option<[f64; 3]>,
    pub images: u64,
    /// Frames without a valid tag, those whose tag keeps not within `limits`, and those that do not decode.
    pub left_out: u64,
    #[serde(default)]
    pub limits: TagLimits,
    /// Whether the field's goals may have stood there: not in a rendered scene.
    #[serde(default = "usually")]
    pub goals: bool,
}

/// What a capture's valid tags need to count.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TagLimits {
    /// Those too that do not know which half of the field they are in.
    pub ambiguous: bool,
    /// Standard deviation of x, y along its longer axis, at most.
    pub sigma_m: f64,
}

impl Default for TagLimits {
    fn default() -> Self {
        Self { ambiguous: false, sigma_m: 0.04 }
    }
}

fn usually() -> bool {
    true
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceKind {
    Capture,
    Folder,
}

/// A database that changes faster than it can be opened is not opened.
pub(super) const MAX_TRIES: usize = 100;
/// Some hundred bytes for each source.
const MAX_CATALOGUE_BYTES: u64 = 64 << 20;
const FORMAT: u32 = 1;
const FILE: &str = "database.json";

impl Catalogue {
    pub fn new(field: FieldDimensions) -> Self {
        Self { format: FORMAT, index: 0, field, sources: Vec::new() }
    }

    pub fn read(folder: &Path) -> Result<Self, DatabaseError> {
        let path = folder.join(FILE);
        let text = match plain_file::read_text(&path, MAX_CATALOGUE_BYTES) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(DatabaseError::None { path: folder.to_owned() });
            }
            Err(error) => return Err(io(&path)(error)),
        };
        let damaged = |what: String| DatabaseError::Lost { path: path.clone(), what, folder: folder.to_owned() };
        let catalogue: Self = serde_json::from_str(&text).map_err(|error| damaged(error.to_string()))?;
        if catalogue.format != FORMAT {
            return Err(damaged(format!("of format {}, and this program reads format {FORMAT}", catalogue.format)));
        }
        Ok(catalogue)
    }

    /// With its index, as both are now: who changes the database takes the old index away after the new catalogue is there.
    pub fn with_index(folder: &Path) -> Result<(Self, Index), DatabaseError> {
        let mut tries = 0;
        loop {
            let catalogue = Self::read(folder)?;
            match Index::open(&path_of(folder, catalogue.index)) {
                Ok(index) => return Ok((catalogue, index)),
                Err(error) if tries == MAX_TRIES || Self::read(folder)?.index == catalogue.index => return Err(error),
                Err(_) => tries += 1,
            }
        }
    }

    /// The old content or the new, never a part.
    pub fn write(&self, folder: &Path) -> Result<(), DatabaseError> {
        let path = folder.join(FILE);
        let text = serde_json::to_vec_pretty(self).map_err(|error| io(&path)(error.into()))?;
        Ok(write_atomically(&path, &text)?)
    }

    pub fn position(&self, path: &Path) -> Option<usize> {
        self.sources.iter().position(|source| source.path == path)
    }
}

impl Source {
    pub fn file(&self, number: u32) -> Option<PathBuf> {
        let name = self.files.get(number as usize)?;
        Some(if name.as_os_str().is_empty() { self.path.clone() } else { self.path.join(name) })
    }
}
