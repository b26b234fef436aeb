//! Sunlight through windows: bright patches with soft edges on the floor.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use realitysim_geometry::Field;

/// A grid of panes of sunlight on the floor. The seed selects its direction and the lit panes.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SunPatches {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Factor of the image values in the sun.
    pub gain: f64,
    /// Share of the panes that the sun comes through.
    pub share: f64,
    /// Length of a pane, metres. Its width is half of that.
    pub length_m: f64,
    /// Width of the soft edge of a pane, metres.
    pub edge_m: f64,
}

impl EffectKind for SunPatches {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.gain"), self.gain, 1.0..=4.0, "1 to 4 times the image values beside it")?;
        check_range(format_args!("{key}.share"), self.share, 0.0..=1.0, "0 to 1")?;
        check_range(format_args!("{key}.length_m"), self.length_m, 0.2..=10.0, "0.2 to 10 m")?;
        check_range(format_args!("{key}.edge_m"), self.edge_m, 0.01..=2.0, "0.01 to 2 m")
    }

    fn lacks(&self) -> Option<&'static str> {
        (self.gain == 1.0 || self.share == 0.0).then_some("a gain above 1 and a share above 0")
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.sun_patches = Some(self.clone());
        Ok(())
    }
}
