//! Lens files, told apart by their content ([`LensFormat`]), and lenses of which only the angle of view is known.
//!
//! Each file in `config/cameras` is built into the program as a camera of that name.

mod distortion;
mod field_of_view;
mod kalibr;
mod mrcal;
mod ocam;
mod opencv;
mod own;
mod ros;
mod visual_mesh;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use include_dir::{Dir, include_dir};
use serde::de::{DeserializeOwned, IgnoredAny};

use field_of_view::FieldOfView;

use super::source::{Shipped, Source};
use super::{ConfigError, LensFileError};
use realitysim_geometry::{Isometry, Lens, LensParameters};

pub use own::lens_text;
pub use ros::{camera_calibration_yaml, lens_from_camera_info};

static FOLDER: Dir<'static> = include_dir!("$CARGO_MANIFEST_DIR/cameras");
const SHIPPED: Shipped = Shipped { kind: "camera", folder: &FOLDER };

/// A lens file that has been checked.
#[derive(Clone, Debug, PartialEq)]
pub struct LensFile {
    /// Name that the file gives its camera, for people.
    pub title: String,
    /// Format of the file.
    pub format: LensFormat,
    /// The checked lens.
    pub lens: Lens,
    /// Width and height that the file states, pixels, if the lens was scaled from them to those of the image.
    pub scaled_from: Option<[u32; 2]>,
    /// Pose of the camera, which only a VisualMesh file states.
    pub visual_mesh_pose: Option<VisualMeshPose>,
}

/// A format of lens files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensFormat {
    /// This crate's own TOML.
    Own,
    /// YAML of ROS camera_calibration.
    Ros,
    /// Camchain YAML of Kalibr.
    Kalibr,
    /// YAML beside the images of VisualMesh.
    VisualMesh,
    /// YAML or XML of OpenCV's `FileStorage`.
    OpenCv,
    /// `calib_results.txt` of OCamCalib.
    OCamCalib,
    /// `.cameramodel` of mrcal.
    Mrcal,
    /// No file: a model with a field of view, as in `equidistant:180deg`.
    FieldOfView,
}

/// The pose of the camera that a VisualMesh file states as `Hoc`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisualMeshPose {
    /// Transformation from `camera_link` (x forward, y left, z up) to a world with z up, the ground at z = 0 and the origin
    /// below the camera. Its heading can be compared with other images of the same place at best.
    pub world_from_camera_link: Isometry,
}

/// Facts that the reader of a lens file adds to the file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensWanted<'a> {
    /// Name of the camera in a Kalibr file; `None` takes `cam0`.
    pub camera: Option<&'a str>,
    /// Width and height of the image that the lens is for, pixels.
    ///
    /// Files that do not state their size need it. The lens of others is scaled to it, if the aspect ratio is the same.
    pub image_size: Option<[u32; 2]>,
}

/// Returns the names of the shipped cameras, in alphabetic order.
pub fn lens_names() -> Vec<String> {
    SHIPPED.names()
}

/// Loads the lens of a file, or a shipped one. `file#cam1` is the camera `cam1` of a Kalibr file.
pub fn load_lens(path_or_name: &str) -> Result<LensFile, ConfigError> {
    load(path_or_name, None)
}

/// Loads the lens for an image of `width` by `height` pixels.
///
/// VisualMesh files, some of OpenCV and `equidistant:180deg` do not state their image size, so they can only be loaded this way.
/// The lens of any other is scaled to the image, unless the aspect ratio differs.
pub fn load_lens_for_image(path_or_name: &str, width: u32, height: u32) -> Result<LensFile, ConfigError> {
    load(path_or_name, Some([width, height]))
}

/// Resolves a lens that the file at `path` names: a relative path starts at the folder of that file.
pub fn lens_seen_from(path: &Path, path_or_name: &str) -> String {
    let (file, camera) = split_camera(path_or_name);
    let seen = SHIPPED.seen_from(path, file);
    camera.map_or_else(|| seen.clone(), |camera| format!("{seen}#{camera}"))
}

/// Returns the file that [`load_lens`] would read, or `None` if it would take a shipped lens.
pub fn lens_file(path_or_name: &str) -> Option<PathBuf> {
    SHIPPED.file(split_camera(path_or_name).0)
}

fn load(path_or_name: &str, image_size: Option<[u32; 2]>) -> Result<LensFile, ConfigError> {
    let (path, camera) = split_camera(path_or_name);
    if SHIPPED.file(path).is_none()
        && let Some(view) = FieldOfView::parse(path_or_name)
    {
        return checked(path_or_name, image_size, || view?.content(image_size));
    }
    let Source { name, text } = SHIPPED.load(path)?;
    parse_lens(&text, &name, LensWanted { camera, image_size })
}

/// Parses and checks the text of a lens file. Error messages show `name`.
pub fn parse_lens(text: &str, name: &str, wanted: LensWanted) -> Result<LensFile, ConfigError> {
    checked(name, wanted.image_size, || read_content(text, wanted))
}

/// Scales the lens to its image and checks it.
fn checked(
    name: &str,
    image_size: Option<[u32; 2]>,
    content: impl FnOnce() -> Result<Content, LensFileError>,
) -> Result<LensFile, ConfigError> {
    let read = || -> Result<LensFile, LensFileError> {
        let Content { title, format, parameters, visual_mesh_pose } = content()?;
        let file = [parameters.width, parameters.height];
        let image = image_size.unwrap_or(file);
        // The file is judged by its own numbers.
        let mut lens = Lens::new(parameters)?;
        let scaled_from = (image != file).then_some(file);
        if scaled_from.is_some() {
            let scaled = lens.parameters().scaled_to(image).ok_or(LensFileError::ImageSize { file, image })?;
            lens = Lens::new(scaled)?;
        }
        Ok(LensFile { title, format, lens, scaled_from, visual_mesh_pose })
    };
    read().map_err(|source| ConfigError::Lens { file: name.to_owned(), source })
}

/// The content of a lens file, not checked yet.
struct Content {
    title: String,
    format: LensFormat,
    parameters: LensParameters,
    visual_mesh_pose: Option<VisualMeshPose>,
}

/// Reads a lens file of any format.
fn read_content(text: &str, wanted: LensWanted) -> Result<Content, LensFileError> {
    let format = detect_format(text)?;
    if let (Some(camera), false) = (wanted.camera, format == LensFormat::Kalibr) {
        return Err(LensFileError::value("#", camera, "only a Kalibr file has several cameras: leave it out"));
    }
    match format {
        LensFormat::Own => own::read(text),
        LensFormat::Ros => ros::read(text),
        LensFormat::Kalibr => kalibr::read(text, wanted.camera.unwrap_or("cam0")),
        LensFormat::VisualMesh => visual_mesh::read(text, wanted.image_size),
        LensFormat::OpenCv => opencv::read(text, wanted.image_size),
        LensFormat::OCamCalib => ocam::read(text),
        LensFormat::Mrcal => mrcal::read(text),
        // No text is of this format.
        LensFormat::FieldOfView => Err(LensFileError::UnknownFormat),
    }
}

/// Tells the format of a lens file by its first line and its keys.
fn detect_format(text: &str) -> Result<LensFormat, LensFileError> {
    if ocam::is_ocam(text) {
        return Ok(LensFormat::OCamCalib);
    }
    if mrcal::is_mrcal(text) {
        return Ok(LensFormat::Mrcal);
    }
    if opencv::is_xml(text) {
        return Ok(LensFormat::OpenCv);
    }
    if looks_like_toml(text) {
        return Ok(LensFormat::Own);
    }
    let keys: BTreeMap<String, IgnoredAny> = yaml(text)?;
    let has = |key| keys.contains_key(key);
    if has("distortion_model") && (has("image_width") || has("camera_matrix")) {
        Ok(LensFormat::Ros)
    } else if opencv::KEYS.into_iter().any(has) || has("image_width") {
        Ok(LensFormat::OpenCv)
    } else if keys.keys().any(|key| is_camera_key(key)) {
        Ok(LensFormat::Kalibr)
    } else if has("projection") || has("focal_length") {
        Ok(LensFormat::VisualMesh)
    } else {
        Err(LensFileError::UnknownFormat)
    }
}

/// Whether the first line that is neither empty nor a comment is `key = value` or `[table]`, not `key: value`.
fn looks_like_toml(text: &str) -> bool {
    let line = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#')).unwrap_or("");
    line.starts_with('[') || line.split_once('=').is_some_and(|(key, _)| !key.contains(':'))
}

/// Parses YAML. OpenCV begins it with `%YAML:1.0`, which the standard does not know.
fn yaml<T: DeserializeOwned>(text: &str) -> Result<T, LensFileError> {
    let text = match text.split_once('\n') {
        Some((first, rest)) if first.starts_with("%YAML:") => rest,
        _ => text,
    };
    serde_saphyr::from_str(text).map_err(|error| LensFileError::Syntax(error.to_string().trim_end().to_owned()))
}

/// Splits `path#cam1` into path and camera. Any other `#` belongs to the path.
fn split_camera(path: &str) -> (&str, Option<&str>) {
    match path.rsplit_once('#') {
        Some((file, camera)) if is_camera_key(camera) => (file, Some(camera)),
        _ => (path, None),
    }
}

/// Whether a key is a camera's name in a Kalibr file: `cam0`, `cam1` and so on.
fn is_camera_key(key: &str) -> bool {
    key.strip_prefix("cam").is_some_and(|digits| !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()))
}

#[cfg(test)]
mod tests;
