//! Calibrations that OpenCV's `FileStorage` writes, as YAML (`%YAML:1.0`, `!!opencv-matrix`) or XML (`<opencv_storage>`).
//!
//! They name no distortion model: the number of coefficients tells it, and `fisheye_model` where that is not enough.

use std::collections::BTreeMap;

use quick_xml::Reader;
use quick_xml::events::Event;
use serde::Deserialize;

use super::ros::{Matrix, intrinsics};
use super::{Content, LensFileError, LensFormat, yaml};
use realitysim_geometry::{LensModel, LensParameters};

/// What is read of a file. Other names are those of other samples and versions of OpenCV.
#[derive(Default, Deserialize)]
struct File {
    #[serde(alias = "Camera_Matrix", alias = "cameraMatrix", alias = "K")]
    camera_matrix: Option<Matrix>,
    #[serde(alias = "Distortion_Coefficients", alias = "distCoeffs", alias = "dist_coeffs", alias = "D")]
    distortion_coefficients: Option<Matrix>,
    #[serde(alias = "image_Width")]
    image_width: Option<u32>,
    #[serde(alias = "image_Height")]
    image_height: Option<u32>,
    /// 1 or 0, or true or false.
    fisheye_model: Option<String>,
    camera_name: Option<String>,
}

/// Keys by which YAML is told from that of other tools.
pub(super) const KEYS: [&str; 4] = ["camera_matrix", "Camera_Matrix", "cameraMatrix", "K"];

/// Whether a text is XML.
pub(super) fn is_xml(text: &str) -> bool {
    text.trim_start().starts_with('<')
}

/// Reads a file, for an image of a width and height in pixels if the file does not state them.
pub(super) fn read(text: &str, image_size: Option<[u32; 2]>) -> Result<Content, LensFileError> {
    let file: File = if is_xml(text) { xml(text)? } else { yaml(text)? };
    let missing = |key: &str, expected: &str| LensFileError::Missing { key: key.into(), expected: expected.into() };
    let matrix = file.camera_matrix.ok_or_else(|| missing("camera_matrix", "OpenCV's 3 x 3 matrix"))?;
    let coefficients = file
        .distortion_coefficients
        .ok_or_else(|| missing("distortion_coefficients", "OpenCV writes them beside camera_matrix"))?;
    let [width, height] = match (file.image_width, file.image_height, image_size) {
        (Some(width), Some(height), _) => [width, height],
        (None, None, Some(size)) => size,
        (None, None, None) => return Err(LensFileError::ImageSizeUnknown),
        (width, ..) => {
            let key = if width.is_some() { "image_height" } else { "image_width" };
            return Err(missing(key, "it stands beside the other"));
        }
    };
    let [fx, fy, cx, cy] = intrinsics("camera_matrix.data", &matrix.data)?;
    let model = model(&coefficients.data, file.fisheye_model.as_deref())?;
    Ok(Content {
        title: file.camera_name.unwrap_or_else(|| "OpenCV camera".into()),
        format: LensFormat::OpenCv,
        parameters: LensParameters { width, height, fx, fy, cx, cy, model, fov_deg: None },
        visual_mesh_pose: None,
    })
}

/// Finds the model by the number of coefficients and by what the file says about fisheyes.
fn model(d: &[f64], fisheye: Option<&str>) -> Result<LensModel, LensFileError> {
    let refused =
        |expected: &str| Err(LensFileError::value("distortion_coefficients.data", format_args!("{d:?}"), expected));
    let is_fisheye = match fisheye {
        None => None,
        Some("0" | "false") => Some(false),
        Some("1" | "true") => Some(true),
        Some(other) => return Err(LensFileError::value("fisheye_model", other, "it must be 0 or 1")),
    };
    match (d, is_fisheye) {
        (&[k1, k2, k3, k4], Some(true)) => Ok(LensModel::KannalaBrandt { k: [k1, k2, k3, k4] }),
        (_, Some(true)) => refused("with fisheye_model: 1 it must have 4, k1 to k4"),
        ([_, _, _, _], None) => refused(
            "4 numbers can be k1 to k4 of OpenCV's fisheye or k1, k2, p1, p2 of a pinhole: add `fisheye_model: 1` or \
             `fisheye_model: 0` to the file",
        ),
        (d, _) if [4, 5, 8, 12, 14].contains(&d.len()) => match LensModel::of_opencv(d) {
            Some(model) => Ok(model),
            None => refused("its last two, the tilt of the sensor, must be 0: calibrate without CALIB_TILTED_MODEL"),
        },
        _ => {
            refused("it must have 5 (k1, k2, p1, p2, k3), 8 (and k4 to k6), 12 (and s1 to s4), or 4 with fisheye_model")
        }
    }
}

/// Reads the elements of an XML file that a [`File`] has.
fn xml(text: &str) -> Result<File, LensFileError> {
    let mut elements = xml_elements(text)?;
    let mut take = |names: &[&str]| names.iter().find_map(|name| elements.remove(*name));
    let mut matrix = |names: [&str; 4]| {
        let names = names.map(|name| format!("{name}/data"));
        take(&names.each_ref().map(String::as_str)).map(|text| numbers(&names[0], &text)).transpose()
    };
    let camera_matrix = matrix(KEYS)?;
    let distortion_coefficients =
        matrix(["distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs"])?;
    let mut whole = |names: [&str; 2]| -> Result<Option<u32>, LensFileError> {
        let read = |text: String| {
            text.parse()
                .map_err(|_| LensFileError::value(names[0], format_args!("{text:?}"), "it must be a number of pixels"))
        };
        take(&names).map(read).transpose()
    };
    Ok(File {
        camera_matrix,
        distortion_coefficients,
        image_width: whole(["image_width", "image_Width"])?,
        image_height: whole(["image_height", "image_Height"])?,
        fisheye_model: take(&["fisheye_model"]),
        camera_name: take(&["camera_name"]),
    })
}

/// The text of each element below the root, by its path without the root: `camera_matrix/data`.
fn xml_elements(text: &str) -> Result<BTreeMap<String, String>, LensFileError> {
    let mut reader = Reader::from_str(text);
    let syntax = |error: String| LensFileError::Syntax(format!("XML: {error}"));
    let (mut path, mut elements): (Vec<String>, BTreeMap<String, String>) = Default::default();
    loop {
        match reader.read_event().map_err(|error| syntax(error.to_string()))? {
            Event::Start(_) if path.len() == MAX_XML_DEPTH => {
                return Err(syntax(format!("elements are nested more than {MAX_XML_DEPTH} deep, OpenCV's are not")));
            }
            Event::Start(start) => {
                let name = String::from_utf8_lossy(start.name().as_ref()).into_owned();
                if path.is_empty() && name != "opencv_storage" {
                    return Err(LensFileError::UnknownFormat);
                }
                path.push(name);
            }
            Event::End(_) => {
                path.pop();
            }
            Event::Text(found) if path.len() > 1 => {
                let found = found.decode().map_err(|error| syntax(error.to_string()))?;
                elements.entry(path[1..].join("/")).or_default().push_str(found.trim());
            }
            Event::Eof if path.is_empty() => return Ok(elements),
            Event::Eof => return Err(syntax(format!("the file ends inside <{}>", path.join("/")))),
            _ => {}
        }
    }
}

/// Largest depth of elements; a matrix has three.
const MAX_XML_DEPTH: usize = 16;

/// Reads numbers between spaces.
fn numbers(key: &str, text: &str) -> Result<Matrix, LensFileError> {
    let read = |word: &str| {
        let number: Option<f64> = word.parse().ok();
        number.ok_or_else(|| LensFileError::value(key, format_args!("{word:?}"), "it must have numbers between spaces"))
    };
    Ok(Matrix { data: text.split_whitespace().map(read).collect::<Result<_, _>>()? })
}
