//! What the robot believes about its camera is not what is so: the announced lens and mount are off the true ones.

use glam::DVec2;
use serde::Deserialize;

use super::Role;
use crate::check::{refuse, within};
use crate::{Mount, SceneError};
use realitysim_geometry::{Euler, Isometry, Lens, LensParameters};

/// Added to the truth where it is announced (`CameraInfo`, `/tf_static`). Images and true poses stay what they are.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationError {
    pub role: Option<Role>,
    /// Of fx and fy.
    #[serde(default)]
    pub focal_percent: f64,
    /// Of cx and cy.
    #[serde(default)]
    pub centre_px: [f64; 2],
    /// Of the camera in the torso: above 0 the right side is announced lower, the view lower, the view farther left.
    #[serde(default)]
    pub mount_roll_deg: f64,
    #[serde(default)]
    pub mount_pitch_deg: f64,
    #[serde(default)]
    pub mount_yaw_deg: f64,
    /// Of the torso above the ground.
    #[serde(default)]
    pub height_m: f64,
}

impl CalibrationError {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.focal_percent"), self.focal_percent, -20.0..=20.0, "-20 to 20 percent")?;
        for (axis, value) in ["x", "y"].iter().zip(self.centre_px) {
            let key = format_args!("{key}.centre_px ({axis})").to_string();
            within(key, value, -100.0..=100.0, "-100 to 100 pixels")?;
        }
        for (name, angle) in [
            ("mount_roll_deg", self.mount_roll_deg),
            ("mount_pitch_deg", self.mount_pitch_deg),
            ("mount_yaw_deg", self.mount_yaw_deg),
        ] {
            within(format_args!("{key}.{name}"), angle, -20.0..=20.0, "-20 to 20 degrees")?;
        }
        within(format_args!("{key}.height_m"), self.height_m, -0.2..=0.2, "-0.2 to 0.2 m")
    }

    pub(super) fn is_none(&self) -> bool {
        let Self {
            role: _,
            focal_percent,
            centre_px: [x, y],
            mount_roll_deg,
            mount_pitch_deg,
            mount_yaw_deg,
            height_m,
        } = self;
        [*focal_percent, *x, *y, *mount_roll_deg, *mount_pitch_deg, *mount_yaw_deg, *height_m] == [0.0; 7]
    }

    /// A lens that could not be is refused.
    pub(crate) fn lens(&self, key: &str, lens: &LensParameters) -> Result<LensParameters, SceneError> {
        let scale = 1.0 + self.focal_percent / 100.0;
        let centre = DVec2::new(lens.cx, lens.cy) + DVec2::from(self.centre_px);
        let announced =
            LensParameters { fx: lens.fx * scale, fy: lens.fy * scale, cx: centre.x, cy: centre.y, ..lens.clone() };
        match Lens::new(announced.clone()) {
            Ok(_) => Ok(announced),
            Err(error) => Err(refuse(key, "a lens that cannot be announced", error)),
        }
    }

    pub(crate) fn mount(&self, mount: &Mount) -> Mount {
        let mut announced = *mount;
        announced.base_footprint_from_base_link.translation.z += self.height_m;
        let camera = mount.base_link_from_camera_link;
        let true_angles = camera.euler();
        let angles = Euler {
            yaw: true_angles.yaw + self.mount_yaw_deg.to_radians(),
            pitch: true_angles.pitch + self.mount_pitch_deg.to_radians(),
            roll: true_angles.roll + self.mount_roll_deg.to_radians(),
        };
        announced.base_link_from_camera_link = Isometry::from_euler(angles, camera.translation);
        announced
    }
}
