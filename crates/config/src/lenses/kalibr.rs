//! Kalibr's camchain YAML, which has one entry per camera: `cam0`, `cam1` and so on.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::distortion::DistortionKeys;
use super::{Content, LensFileError, LensFormat, yaml};
use realitysim_geometry::{LensModel, LensParameters};

/// One camera of the file, with the keys that are read.
#[derive(Deserialize)]
struct Camera {
    rostopic: Option<String>,
    camera_model: String,
    intrinsics: Vec<f64>,
    distortion_model: String,
    #[serde(default)]
    distortion_coeffs: Vec<f64>,
    resolution: [u32; 2],
}

const KEYS: DistortionKeys = DistortionKeys { model: "distortion_model", coefficients: "distortion_coeffs" };

/// Reads the camera of this name.
pub(super) fn read(text: &str, wanted: &str) -> Result<Content, LensFileError> {
    let mut cameras: BTreeMap<String, Camera> = yaml(text)?;
    let Some(camera) = cameras.remove(wanted) else {
        let known: Vec<_> = cameras.into_keys().collect();
        let expected = format!("the file has {}: choose one by file#camera", known.join(", "));
        return Err(LensFileError::Missing { key: wanted.into(), expected });
    };
    parameters(&camera).map_err(|error| prefix_key(wanted, error)).map(|parameters| Content {
        title: camera.rostopic.unwrap_or_else(|| wanted.into()),
        format: LensFormat::Kalibr,
        parameters,
        visual_mesh_pose: None,
    })
}

fn parameters(camera: &Camera) -> Result<LensParameters, LensFileError> {
    let wrong = |expected: &str| LensFileError::value("intrinsics", format_args!("{:?}", camera.intrinsics), expected);
    let (model, [fx, fy, cx, cy]) = match (camera.camera_model.as_str(), camera.intrinsics.as_slice()) {
        ("pinhole", &[fx, fy, cx, cy]) => {
            (KEYS.kalibr(&camera.distortion_model, &camera.distortion_coeffs)?, [fx, fy, cx, cy])
        }
        ("pinhole", _) => return Err(wrong("a pinhole has four numbers: fx, fy, cx, cy")),
        ("ds", &[xi, alpha, fx, fy, cx, cy]) => {
            check_undistorted(camera)?;
            (LensModel::DoubleSphere { xi, alpha }, [fx, fy, cx, cy])
        }
        ("ds", _) => return Err(wrong("a double sphere has six numbers: xi, alpha, fx, fy, cx, cy")),
        ("eucm", &[alpha, beta, fx, fy, cx, cy]) => {
            check_undistorted(camera)?;
            (LensModel::Eucm { alpha, beta }, [fx, fy, cx, cy])
        }
        ("eucm", _) => return Err(wrong("an enhanced unified camera has six numbers: alpha, beta, fx, fy, cx, cy")),
        (other, _) => {
            let expected = "supported are pinhole (with radtan or equidistant distortion), ds and eucm; calibrate an omni lens \
                            as ds-none or pinhole-equi";
            return Err(LensFileError::value("camera_model", format_args!("{other:?}"), expected));
        }
    };
    let [width, height] = camera.resolution;
    Ok(LensParameters { width, height, fx, fy, cx, cy, model, fov_deg: None })
}

/// Refuses a distortion beside a model that bends rays by itself.
fn check_undistorted(camera: &Camera) -> Result<(), LensFileError> {
    match (camera.distortion_model.as_str(), &camera.distortion_coeffs) {
        ("none", d) if d.iter().all(|c| *c == 0.0) => Ok(()),
        (model, _) => {
            let expected = format!("{} is supported with \"none\" and no coefficients", camera.camera_model);
            Err(LensFileError::value("distortion_model", format_args!("{model:?}"), expected))
        }
    }
}

/// Puts the name of the camera before the key of an error.
fn prefix_key(camera: &str, error: LensFileError) -> LensFileError {
    match error {
        LensFileError::Value { key, found, expected } => {
            LensFileError::Value { key: format!("{camera}.{key}"), found, expected }
        }
        other => other,
    }
}
