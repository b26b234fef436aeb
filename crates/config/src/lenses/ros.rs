//! Lenses as ROS describes them: in the YAML files of camera_calibration and in `sensor_msgs/CameraInfo`.

use serde::Deserialize;

use super::distortion::DistortionKeys;
use super::{Content, LensFileError, LensFormat, yaml};
use realitysim_geometry::LensParameters;

/// The keys that are read of the file.
#[derive(Deserialize)]
struct File {
    camera_name: Option<String>,
    image_width: u32,
    image_height: u32,
    camera_matrix: Matrix,
    distortion_model: String,
    distortion_coefficients: Option<Matrix>,
}

/// A matrix, row by row.
#[derive(Deserialize)]
pub(super) struct Matrix {
    pub data: Vec<f64>,
}

/// Converts the fields of a `sensor_msgs/CameraInfo` to the parameters of a lens.
///
/// `width` and `height` are pixels, `k` is the 3 x 3 intrinsic matrix, row by row, and `d` the distortion. The result is not
/// fully checked: [`realitysim_geometry::Lens::new`] does the rest. It is the lens of the whole image, of which a binned or cut
/// one (`binning_x`, `roi`) shows a part ([`LensParameters::cropped`], [`LensParameters::binned`]).
///
/// # Errors
///
/// Fails if the camera is not calibrated, the matrix has skew, or the distortion model is not supported.
pub fn lens_from_camera_info(
    width: u32,
    height: u32,
    distortion_model: &str,
    d: &[f64],
    k: &[f64; 9],
) -> Result<LensParameters, LensFileError> {
    let keys = DistortionKeys { model: "distortion_model", coefficients: "d" };
    parameters([width, height], "k", k, &keys, distortion_model, d)
}

/// Reads a YAML file of camera_calibration.
pub(super) fn read(text: &str) -> Result<Content, LensFileError> {
    let file: File = yaml(text)?;
    let keys = DistortionKeys { model: "distortion_model", coefficients: "distortion_coefficients.data" };
    let d = file.distortion_coefficients.map(|matrix| matrix.data).unwrap_or_default();
    let size = [file.image_width, file.image_height];
    let parameters =
        parameters(size, "camera_matrix.data", &file.camera_matrix.data, &keys, &file.distortion_model, &d)?;
    let title = file.camera_name.unwrap_or_else(|| "ROS camera".into());
    Ok(Content { title, format: LensFormat::Ros, parameters, visual_mesh_pose: None })
}

/// Checks intrinsics and distortion; `matrix_key` and `keys` name them in errors.
fn parameters(
    [width, height]: [u32; 2],
    matrix_key: &str,
    matrix: &[f64],
    keys: &DistortionKeys,
    model: &str,
    d: &[f64],
) -> Result<LensParameters, LensFileError> {
    let [fx, fy, cx, cy] = intrinsics(matrix_key, matrix)?;
    Ok(LensParameters { width, height, fx, fy, cx, cy, model: keys.ros(model, d)?, fov_deg: None })
}

/// Takes fx, fy, cx and cy of a 3 x 3 matrix, row by row, that has nothing else; errors call it `matrix_key`.
pub(super) fn intrinsics(matrix_key: &str, matrix: &[f64]) -> Result<[f64; 4], LensFileError> {
    let &[fx, skew, cx, below_fx, fy, cy, b0, b1, b2] = matrix else {
        let count = format!("{} numbers", matrix.len());
        return Err(LensFileError::value(matrix_key, count, "it must have 9: fx, 0, cx, 0, fy, cy, 0, 0, 1"));
    };
    for (index, focal) in [(0, fx), (4, fy)] {
        if focal == 0.0 {
            let expected = "a focal length is above 0 pixels; zero says that the camera has not been calibrated";
            return Err(LensFileError::value(format!("{matrix_key}[{index}]"), focal, expected));
        }
    }
    for (index, value, wanted) in [(1, skew, 0.0), (3, below_fx, 0.0), (6, b0, 0.0), (7, b1, 0.0), (8, b2, 1.0)] {
        if value != wanted {
            let expected = format!("it must be {wanted}: no supported lens has skew or a scaled matrix");
            return Err(LensFileError::value(format!("{matrix_key}[{index}]"), value, expected));
        }
    }
    Ok([fx, fy, cx, cy])
}

/// The text of a YAML file of camera_calibration with this lens.
///
/// ROS has no name for an equisolid lens: the file calls it `equisolid`, which only this program reads. It does not hold the angle
/// of view.
pub fn camera_calibration_yaml(lens: &LensParameters) -> String {
    let (model, d) = lens.model.ros_distortion();
    let LensParameters { width, height, fx, fy, cx, cy, .. } = *lens;
    let k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0];
    format!(
        "image_width: {width}\nimage_height: {height}\ncamera_name: camera\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: {k:?}\n\
         distortion_model: {model}\ndistortion_coefficients:\n  rows: 1\n  cols: {}\n  data: {d:?}\n",
        d.len()
    )
}

#[cfg(test)]
mod tests {
    use super::super::{lens_names, load_lens};
    use super::*;

    #[test]
    fn a_lens_that_is_written_is_read_as_the_same() {
        for name in lens_names() {
            let lens = load_lens(&name).expect("shipped").lens;
            let again = read(&camera_calibration_yaml(lens.parameters())).expect(&name).parameters;
            let written = LensParameters { fov_deg: None, ..lens.parameters().clone() };
            assert_eq!(again, written, "{name}");
        }
    }
}
