//! Errors of settings, field and lens files. Their texts name the file and the key, and say what would be right.

use std::io;

use thiserror::Error;

use super::wording::closest_name;
use realitysim_geometry::{FieldError, LensError};

/// An error of a settings, field or lens file. `file` is its path, or its name if the file is shipped.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be opened or read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// Path of the file.
        file: String,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file is larger than a settings file may be.
    #[error("{file}: larger than {max_kib} KiB: no settings file is")]
    TooLarge {
        /// Path of the file.
        file: String,
        /// Largest size of a settings file, KiB.
        max_kib: u64,
    },
    /// The file is not UTF-8 text.
    #[error("{file}: not UTF-8 text: a settings file is TOML or YAML")]
    NotText {
        /// Path of the file.
        file: String,
    },
    /// The name is neither that of a file nor that of a shipped one.
    #[error("no {kind} is called {name:?}{}: give the path of a file or one of {}", did_you_mean(name, known), known.join(", "))]
    Unknown {
        /// Kind of file that was looked for: `field` or `camera`.
        kind: &'static str,
        /// Name that was given.
        name: String,
        /// Names of all shipped files of this kind.
        known: Vec<String>,
    },
    /// The text is not TOML, or has an unknown key or a value of a wrong type.
    #[error("{file}: {message}")]
    Syntax {
        /// Path or name of the file.
        file: String,
        /// Message of the parser, which names the line and the key.
        message: String,
    },
    /// A value of a settings file is out of its range.
    #[error("{file}: {message}")]
    Value {
        /// Path or name of the file.
        file: String,
        /// Message that names the key and its range.
        message: String,
    },
    /// A dimension of a field file is impossible.
    #[error("{file}: {source}")]
    Field {
        /// Path or name of the file.
        file: String,
        /// Error that names the dimension.
        source: FieldError,
    },
    /// A field cannot have the size that was measured.
    #[error("{} x {} m is no size for the field {field}: {source}", size_m[0], size_m[1])]
    FieldSize {
        /// Path of the field's file, or its name if the field is shipped.
        field: String,
        /// Length and width, metres.
        size_m: [f64; 2],
        /// Error that names what no longer fits.
        source: FieldError,
    },
    /// A lens file is wrong.
    #[error("{file}: {source}")]
    Lens {
        /// Path or name of the file.
        file: String,
        /// Error that names the key.
        source: LensFileError,
    },
}

fn did_you_mean(name: &str, known: &[String]) -> String {
    let closest = closest_name(name, known.iter().map(String::as_str));
    closest.map_or_else(String::new, |name| format!(" (did you mean {name}?)"))
}

/// An error in what a lens file or a `sensor_msgs/CameraInfo` says.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LensFileError {
    /// The text cannot be parsed; the message is that of the parser.
    #[error("{0}")]
    Syntax(String),
    /// The text is of none of the formats.
    #[error(
        "not a lens file of a known format: this crate's TOML begins with `key = value`, ROS camera_calibration YAML \
         has image_width and camera_matrix, OpenCV's YAML has camera_matrix and its XML opencv_storage, Kalibr has cam0, \
         VisualMesh has projection and focal_length, OCamCalib begins with a comment on the DIRECT mapping function, mrcal \
         has lensmodel"
    )]
    UnknownFormat,
    /// The value of a key is impossible or not supported.
    #[error("{key} is {found}: {expected}")]
    Value {
        /// Key as the file writes it.
        key: String,
        /// Value that was found.
        found: String,
        /// Sentence that says what would be right.
        expected: String,
    },
    /// A key, or a camera of a Kalibr file, is missing.
    #[error("{key} is missing: {expected}")]
    Missing {
        /// Key, or name of the camera.
        key: String,
        /// Sentence that says what would be right.
        expected: String,
    },
    /// The lens is calibrated for an image of another aspect ratio.
    #[error("the lens is for images of {} x {}, but the image has {} x {}", file[0], file[1], image[0], image[1])]
    ImageSize {
        /// Width and height that the file states, pixels.
        file: [u32; 2],
        /// Width and height of the image, pixels.
        image: [u32; 2],
    },
    /// A lens that does not state the size of its image was read without an image.
    #[error(
        "it does not say how large its image is: this works for commands on images and logs only; give a lens file with the size"
    )]
    ImageSizeUnknown,
    /// The parameters describe an impossible lens.
    #[error(transparent)]
    Lens(#[from] LensError),
}

impl LensFileError {
    /// Makes a [`Self::Value`] of anything that can be printed.
    pub(super) fn value(key: impl Into<String>, found: impl ToString, expected: impl Into<String>) -> Self {
        Self::Value { key: key.into(), found: found.to_string(), expected: expected.into() }
    }
}
