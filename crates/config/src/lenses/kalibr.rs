//! Kalibr's camchain YAML, which has one entry per camera: `cam0`, `cam1` and so on.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::distortion::DistortionKeys;
use super::{Content, LensFileError, LensFormat, yaml};
use realitysim_geometry::LensParameters;

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
    if camera.camera_model != "pinhole" {
        let expected = "only \"pinhole\" is supported, with radtan (wide) or equidistant (fisheye) distortion";
        return Err(LensFileError::value("camera_model", format_args!("{:?}", camera.camera_model), expected));
    }
    let &[fx, fy, cx, cy] = camera.intrinsics.as_slice() else {
        let found = format_args!("{:?}", camera.intrinsics).to_string();
        return Err(LensFileError::value("intrinsics", found, "a pinhole has four numbers: fx, fy, cx, cy"));
    };
    let [width, height] = camera.resolution;
    let model = KEYS.kalibr(&camera.distortion_model, &camera.distortion_coeffs)?;
    Ok(LensParameters { width, height, fx, fy, cx, cy, model, fov_deg: None })
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
