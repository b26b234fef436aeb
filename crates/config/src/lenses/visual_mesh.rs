//! The YAML beside the images of github.com/Fastcode/VisualMesh.

use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use super::{Content, LensFileError, LensFormat, VisualMeshPose, yaml};
use realitysim_geometry::{Isometry, LensModel, LensParameters};

#[derive(Deserialize)]
struct File {
    projection: String,
    /// Pixels.
    focal_length: f64,
    /// What must be added to the place of the lens axis to get to the middle of the image, pixels.
    centre: [f64; 2],
    #[serde(default)]
    k: Vec<f64>,
    /// Full angle, radians.
    fov: f64,
    /// The pose of the camera above the observation plane, row by row.
    #[serde(rename = "Hoc")]
    hoc: Option<[[f64; 4]; 4]>,
}

/// The files give six digits.
const ROTATION_TOLERANCE: f64 = 1e-4;

pub(super) fn read(text: &str, image_size: Option<[u32; 2]>) -> Result<Content, LensFileError> {
    let file: File = yaml(text)?;
    let Some([width, height]) = image_size else { return Err(LensFileError::ImageSizeUnknown) };
    if file.k.iter().any(|k| *k != 0.0) {
        // Their k undistorts: the ideal radius is r (1 + k1 r^2 + k2 r^4) of the drawn radius r in pixels. The models
        // here go from the ray to the pixel, for which VisualMesh itself has an approximation only.
        let expected = "only lenses with k = [0, 0] are supported: its polynomial runs from the distorted to the \
                        ideal radius, unlike those of plumb_bob and kannala_brandt";
        return Err(LensFileError::value("k", format_args!("{:?}", file.k), expected));
    }
    let model = match file.projection.as_str() {
        "RECTILINEAR" => LensModel::PlumbBob { d: [0.0; 5] },
        "EQUISOLID" => LensModel::Equisolid,
        "EQUIDISTANT" => LensModel::KannalaBrandt { k: [0.0; 4] },
        other => {
            let expected = "it must be RECTILINEAR, EQUISOLID or EQUIDISTANT";
            return Err(LensFileError::value("projection", format_args!("{other:?}"), expected));
        }
    };
    // Their (0, 0) is the top left corner of the image, ours is the centre of the pixel there.
    let axis = |size: u32, offset: f64| f64::from(size) / 2.0 - offset - 0.5;
    let parameters = LensParameters {
        width,
        height,
        fx: file.focal_length,
        fy: file.focal_length,
        cx: axis(width, file.centre[0]),
        cy: axis(height, file.centre[1]),
        model,
        fov_deg: Some(file.fov.to_degrees()),
    };
    let visual_mesh_pose = file.hoc.map(|hoc| pose(&hoc)).transpose()?;
    Ok(Content {
        title: format!("VisualMesh {}", file.projection),
        format: LensFormat::VisualMesh,
        parameters,
        visual_mesh_pose,
    })
}

fn pose(hoc: &[[f64; 4]; 4]) -> Result<VisualMeshPose, LensFileError> {
    let wrong = |expected| LensFileError::value("Hoc", format_args!("{hoc:?}"), expected);
    if hoc[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(wrong("its last row must be [0, 0, 0, 1]"));
    }
    let row = |i: usize| DVec3::new(hoc[i][0], hoc[i][1], hoc[i][2]);
    // glam takes columns.
    let rotation = DMat3::from_cols(row(0), row(1), row(2)).transpose();
    let off = rotation * rotation.transpose() - DMat3::IDENTITY;
    let largest = off.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    // Negated, so that NaN is refused.
    if !(largest <= ROTATION_TOLERANCE && rotation.determinant() > 0.0) {
        return Err(wrong("its upper left 3 x 3 must be a rotation"));
    }
    let translation = DVec3::new(hoc[0][3], hoc[1][3], hoc[2][3]);
    if !translation.is_finite() {
        return Err(wrong("its last column must be finite"));
    }
    Ok(VisualMeshPose { world_from_camera_link: Isometry::new(DQuat::from_mat3(&rotation), translation) })
}
