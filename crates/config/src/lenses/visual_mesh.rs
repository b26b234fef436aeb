//! The YAML files beside the images of the VisualMesh data set (github.com/Fastcode/VisualMesh).

use glam::{DMat3, DQuat, DVec3};
use serde::Deserialize;

use super::{Content, LensFileError, LensFormat, VisualMeshPose, yaml};
use realitysim_geometry::{Isometry, LensModel, LensParameters};

/// The keys that are read of the file.
#[derive(Deserialize)]
struct File {
    projection: String,
    /// Focal length, pixels.
    focal_length: f64,
    /// Offset from the lens axis to the middle of the image, pixels.
    centre: [f64; 2],
    /// Coefficients of the polynomial that undistorts.
    #[serde(default)]
    k: Vec<f64>,
    /// Full angle of view, radians.
    fov: f64,
    /// Homogeneous pose of the camera above the observation plane, 4 x 4, row by row.
    #[serde(rename = "Hoc")]
    hoc: Option<[[f64; 4]; 4]>,
}

/// Largest deviation of R R^T from the identity; the files state six digits.
const ROTATION_TOLERANCE: f64 = 1e-4;

/// Reads a VisualMesh file for an image of the given width and height, pixels.
pub(super) fn read(text: &str, image_size: Option<[u32; 2]>) -> Result<Content, LensFileError> {
    let file: File = yaml(text)?;
    let Some([width, height]) = image_size else { return Err(LensFileError::ImageSizeUnknown) };
    if file.k.iter().any(|k| *k != 0.0) {
        // VisualMesh undistorts with k: a distorted radius of r pixels has the ideal radius r (1 + k1 r^2 + k2 r^4). The
        // models of this program go from the ray to the pixel, for which VisualMesh itself has only an approximation.
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
    // (0, 0) is the top left corner of the image in VisualMesh, and the centre of the top left pixel here.
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
    let visual_mesh_pose = file.hoc.map(|hoc| parse_pose(&hoc)).transpose()?;
    Ok(Content {
        title: format!("VisualMesh {}", file.projection),
        format: LensFormat::VisualMesh,
        parameters,
        visual_mesh_pose,
    })
}

/// Checks that `Hoc` is a rigid transformation.
fn parse_pose(hoc: &[[f64; 4]; 4]) -> Result<VisualMeshPose, LensFileError> {
    let wrong = |expected| LensFileError::value("Hoc", format_args!("{hoc:?}"), expected);
    if hoc[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(wrong("its last row must be [0, 0, 0, 1]"));
    }
    let row = |i: usize| DVec3::new(hoc[i][0], hoc[i][1], hoc[i][2]);
    // `DMat3` takes columns, and `hoc` has rows.
    let rotation = DMat3::from_cols(row(0), row(1), row(2)).transpose();
    let off = rotation * rotation.transpose() - DMat3::IDENTITY;
    let largest = off.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    // The comparison is negated so that NaN is refused.
    if !(largest <= ROTATION_TOLERANCE && rotation.determinant() > 0.0) {
        return Err(wrong("its upper left 3 x 3 must be a rotation"));
    }
    let translation = DVec3::new(hoc[0][3], hoc[1][3], hoc[2][3]);
    if !translation.is_finite() {
        return Err(wrong("its last column must be finite"));
    }
    Ok(VisualMeshPose { world_from_camera_link: Isometry::new(DQuat::from_mat3(&rotation), translation) })
}
