//! `[camera]`: the lens, and the parts of the image that show the robot itself.

use serde::{Deserialize, Serialize};

use super::check_range;

/// The lens of the camera, and masks of the robot's own body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSettings {
    /// Name of a shipped camera (`config/cameras`), path of a lens file, or `equidistant:180deg`; it takes the place of the log's `camera_info`.
    pub lens: Option<String>,
    /// Full angle of view, degrees; it takes the place of the one in the lens file. A `camera_info` states none.
    pub fov_deg: Option<f64>,
    /// Masks of the robot's own body. The first one whose ranges hold the pose of the head is used.
    pub body_mask: Vec<BodyMaskFile>,
}

/// A mask of the robot's own body for some poses of the head; without ranges it fits every pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyMaskFile {
    /// Path of a PNG of the camera's size whose dark pixels hide the body.
    pub png: String,
    /// Least and greatest pan of the head, degrees.
    pub pan_deg: Option<[f64; 2]>,
    /// Least and greatest tilt of the head, degrees.
    pub tilt_deg: Option<[f64; 2]>,
}

impl CameraSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        if let Some(fov) = self.fov_deg {
            check_range("camera.fov_deg", fov, 1.0, 360.0)?;
        }
        for (index, mask) in self.body_mask.iter().enumerate() {
            for (key, range) in [("pan_deg", mask.pan_deg), ("tilt_deg", mask.tilt_deg)] {
                if range.is_some_and(|[low, high]| low.is_nan() || high.is_nan() || low > high) {
                    return Err(format!(
                        "camera.body_mask[{index}].{key}: the first number must not exceed the second"
                    ));
                }
            }
        }
        Ok(())
    }
}
