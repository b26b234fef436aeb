//! The contents of a database, `database.json`: its sources, and the index that belongs to them.
//!
//! A change takes effect at the moment when this file is replaced.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::{DatabaseError, io};
use super::index::{Index, path_of};
use realitysim_config::plain_file;
use realitysim_geometry::{FieldDimensions, LensParameters};
use realitysim_recording::write_atomically;
use realitysim_views::Hall;

/// The content of `database.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contents {
    /// Version of the file's format.
    pub format: u32,
    /// Number of the index file; it counts up with every change.
    pub index: u64,
    /// The field that all images were taken on.
    pub field: FieldDimensions,
    /// The sources, in the order in which records number them.
    pub sources: Vec<Source>,
}

/// A capture or a folder of images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// Whether it is a capture or a folder.
    pub kind: SourceKind,
    /// Absolute path of the capture, of one of its segments, or of the folder.
    pub path: PathBuf,
    /// The lens of the images.
    pub lens: LensParameters,
    /// The files with images, relative to `path`; an empty path if `path` is the file itself.
    pub files: Vec<PathBuf>,
    /// PNGs that mask the robot's own body at any position of its head: file names in the database's folder, or absolute
    /// paths.
    pub body_masks: Vec<String>,
    /// A PNG in the database's folder that is black where no image was ever lit, outside the lens's circle.
    pub dark: Option<String>,
    /// How the lens darkens its images towards their border, if it could be measured: k1 to k3 of
    /// [`realitysim_views::Vignetting`].
    #[serde(default)]
    pub darkening: Option<[f64; 3]>,
    /// The walls and the ceiling that the images determine.
    #[serde(default)]
    pub hall: Hall,
    /// A file in the database's folder that says what stands before the hall in each image.
    #[serde(default)]
    pub moved: Option<String>,
    /// Number of images in the index.
    pub images: u64,
    /// Number of frames left out: without a valid tag, with a tag beyond `limits`, or with an image that does not decode or
    /// fit the lens.
    pub left_out: u64,
    /// The limits that tags had to keep.
    #[serde(default)]
    pub limits: TagLimits,
    /// Whether the field's goals may have stood there. They do not in a rendered scene.
    #[serde(default = "default_true")]
    pub goals: bool,
}

/// Limits that the valid tags of a capture must keep for their images to be added.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TagLimits {
    /// Whether tags count that do not know which half of the field they are in.
    pub ambiguous: bool,
    /// Largest standard deviation of x, y along its longer axis, metres.
    pub sigma_m: f64,
}

impl Default for TagLimits {
    fn default() -> Self {
        Self { ambiguous: false, sigma_m: 0.04 }
    }
}

fn default_true() -> bool {
    true
}

/// The kind of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SourceKind {
    /// A capture or one of its segments.
    Capture,
    /// A folder of images with `poses.csv`.
    Folder,
}

/// Most attempts to open a database while others change it.
pub(super) const MAX_TRIES: usize = 100;
/// Largest `database.json` that is read; a source takes some hundred bytes.
const MAX_CONTENTS_BYTES: u64 = 64 << 20;
const FORMAT: u32 = 1;
const FILE: &str = "database.json";

impl Contents {
    /// Contents without sources.
    pub fn new(field: FieldDimensions) -> Self {
        Self { format: FORMAT, index: 0, field, sources: Vec::new() }
    }

    /// Reads the contents of the database in a folder.
    pub fn read(folder: &Path) -> Result<Self, DatabaseError> {
        let path = folder.join(FILE);
        let text = match plain_file::read_text(&path, MAX_CONTENTS_BYTES) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                return Err(DatabaseError::None { path: folder.to_owned() });
            }
            Err(error) => return Err(io(&path)(error)),
        };
        let damaged = |what: String| DatabaseError::Lost { path: path.clone(), what, folder: folder.to_owned() };
        let contents: Self = serde_json::from_str(&text).map_err(|error| damaged(error.to_string()))?;
        if contents.format != FORMAT {
            return Err(damaged(format!("of format {}, and this program reads format {FORMAT}", contents.format)));
        }
        Ok(contents)
    }

    /// Reads the contents and their index.
    ///
    /// A concurrent change removes the old index after it has written the new contents; then both are read again.
    pub fn with_index(folder: &Path) -> Result<(Self, Index), DatabaseError> {
        let mut tries = 0;
        loop {
            let contents = Self::read(folder)?;
            match Index::open(&path_of(folder, contents.index)) {
                Ok(index) => return Ok((contents, index)),
                Err(error) if tries == MAX_TRIES || Self::read(folder)?.index == contents.index => return Err(error),
                Err(_) => tries += 1,
            }
        }
    }

    /// Replaces the file atomically: it holds the old content or the new, never a part.
    pub fn write(&self, folder: &Path) -> Result<(), DatabaseError> {
        let path = folder.join(FILE);
        let text = serde_json::to_vec_pretty(self).map_err(|error| io(&path)(error.into()))?;
        Ok(write_atomically(&path, &text)?)
    }

    /// The number of the source with this absolute path.
    pub fn position(&self, path: &Path) -> Option<usize> {
        self.sources.iter().position(|source| source.path == path)
    }
}

impl Source {
    /// The absolute path of the file with this number.
    pub fn file(&self, number: u32) -> Option<PathBuf> {
        let name = self.files.get(number as usize)?;
        Some(if name.as_os_str().is_empty() { self.path.clone() } else { self.path.join(name) })
    }
}
