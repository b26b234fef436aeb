//! `[camera]`: the lens, and what of the image is the robot itself.

use serde::{Deserialize, Serialize};

use super::within;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSettings {
    /// A lens file (`config/cameras`) in place of the log's camera_info.
    pub lens: Option<String>,
    /// Full angle of view, in place of what the lens file states; camera_info states none.
    pub fov_deg: Option<f64>,
    /// Dark pixels of these PNGs hide the robot's own body.
    pub body_mask: Vec<BodyMaskFile>,
}

/// The first mask whose ranges hold the head is used; without ranges it fits every head pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyMaskFile {
    pub png: String,
    pub pan_deg: Option<[f64; 2]>,
    pub tilt_deg: Option<[f64; 2]>,
}

impl CameraSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        if let Some(fov) = self.fov_deg {
            within("camera.fov_deg", fov, 1.0, 360.0)?;
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
