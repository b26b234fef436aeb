//! A wrong calibration: the announced lens and mount differ from the true ones.

use glam::DVec2;
use serde::Deserialize;

use super::{EffectKind, Role};
use crate::check::{check_range, refuse};
use crate::{Mount, SceneError};
use realitysim_geometry::{Euler, Isometry, Lens, LensParameters};

/// Errors that are added to the true calibration when it is announced (`CameraInfo`, `/tf_static`).
///
/// Images and true poses do not change.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibrationError {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Error of fx and fy, percent.
    #[serde(default)]
    pub focal_percent: f64,
    /// Error of cx and cy, pixels.
    #[serde(default)]
    pub centre_px: [f64; 2],
    /// Error of the roll of the camera in the torso, degrees. Above 0 its right side is announced too low.
    #[serde(default)]
    pub mount_roll_deg: f64,
    /// Error of the pitch of the camera in the torso, degrees. Above 0 it is announced as looking too far down.
    #[serde(default)]
    pub mount_pitch_deg: f64,
    /// Error of the yaw of the camera in the torso, degrees. Above 0 it is announced as looking too far left.
    #[serde(default)]
    pub mount_yaw_deg: f64,
    /// Error of the height of the torso above the ground, metres.
    #[serde(default)]
    pub height_m: f64,
}

impl EffectKind for CalibrationError {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.focal_percent"), self.focal_percent, -20.0..=20.0, "-20 to 20 percent")?;
        for (axis, value) in ["x", "y"].iter().zip(self.centre_px) {
            let key = format_args!("{key}.centre_px ({axis})").to_string();
            check_range(key, value, -100.0..=100.0, "-100 to 100 pixels")?;
        }
        for (name, angle) in [
            ("mount_roll_deg", self.mount_roll_deg),
            ("mount_pitch_deg", self.mount_pitch_deg),
            ("mount_yaw_deg", self.mount_yaw_deg),
        ] {
            check_range(format_args!("{key}.{name}"), angle, -20.0..=20.0, "-20 to 20 degrees")?;
        }
        check_range(format_args!("{key}.height_m"), self.height_m, -0.2..=0.2, "-0.2 to 0.2 m")
    }

    fn lacks(&self) -> Option<&'static str> {
        self.has_no_effect().then_some("at least one of its keys other than 0")
    }

    fn add_to(&self, scene: &mut Scene, key: &str) -> Result<(), SceneError> {
        scene.announced_lens = self.lens(key, scene.lens.parameters())?;
        scene.calibration_error = Some(self.clone());
        Ok(())
    }
}

impl CalibrationError {
    /// Whether the values change nothing.
    pub(super) fn has_no_effect(&self) -> bool {
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

    /// The announced lens. Returns an error if the errors make the lens impossible.
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

    /// The announced static transforms.
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
use crate::Scene;
use realitysim_geometry::Field;
