//! What can be wrong with a settings file, in words that name the file, the key and what would be right.

use std::io;

use thiserror::Error;

use super::wording::meant;
use realitysim_geometry::{FieldError, LensError};

#[derive(Debug, Error)]
pub enum ConfigError {
    #[error("{file}: cannot be read: {source}")]
    Read { file: String, source: io::Error },
    #[error("{file}: larger than {max_kib} KiB: no settings file is")]
    TooLarge { file: String, max_kib: u64 },
    #[error("{file}: not UTF-8 text: a settings file is TOML or YAML")]
    NotText { file: String },
    /// Neither a file nor a shipped name.
    #[error("no {kind} is called {name:?}{}: give the path of a file or one of {}", did_you_mean(name, known), known.join(", "))]
    Unknown { kind: &'static str, name: String, known: Vec<String> },
    /// The parser's message, which names the line and the key.
    #[error("{file}: {message}")]
    Syntax { file: String, message: String },
    #[error("{file}: {message}")]
    Value { file: String, message: String },
    #[error("{file}: {source}")]
    Field { file: String, source: FieldError },
    #[error("{file}: {source}")]
    Lens { file: String, source: LensFileError },
}

fn did_you_mean(name: &str, known: &[String]) -> String {
    let meant = meant(name, known.iter().map(String::as_str));
    meant.map_or_else(String::new, |name| format!(" (did you mean {name}?)"))
}

/// What can be wrong with what a lens file or a `sensor_msgs/CameraInfo` says.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LensFileError {
    #[error("{0}")]
    Syntax(String),
    #[error(
        "not a lens file of a known format: this crate's TOML begins with `key = value`, ROS camera_calibration YAML \
         has image_width and camera_matrix, Kalibr has cam0, VisualMesh has projection and focal_length"
    )]
    UnknownFormat,
    #[error("{key} is {found}: {expected}")]
    Value { key: String, found: String, expected: String },
    #[error("{key} is missing: {expected}")]
    Missing { key: String, expected: String },
    #[error("the lens is for images of {} x {}, but the image has {} x {}", file[0], file[1], image[0], image[1])]
    ImageSize { file: [u32; 2], image: [u32; 2] },
    #[error("a VisualMesh file does not say how large its image is: the image must be given along with it")]
    ImageSizeUnknown,
    #[error(transparent)]
    Lens(#[from] LensError),
}

impl LensFileError {
    pub(super) fn value(key: impl Into<String>, found: impl ToString, expected: impl Into<String>) -> Self {
        Self::Value { key: key.into(), found: found.to_string(), expected: expected.into() }
    }
}
