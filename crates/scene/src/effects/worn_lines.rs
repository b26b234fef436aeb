//! Worn paint: lines are fainter where feet and tape have rubbed them off, in patches of different strength.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use realitysim_geometry::Field;

/// Wear of the lines.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WornLines {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Average share of the paint that is gone, 0 to 1.
    pub share: f64,
    /// Size of the largest patches, metres.
    pub patch_m: f64,
}

impl EffectKind for WornLines {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.share"), self.share, 0.0..=1.0, "0 (new paint) to 1 (none left)")?;
        check_range(format_args!("{key}.patch_m"), self.patch_m, 0.05..=2.0, "0.05 to 2 m")
    }

    fn lacks(&self) -> Option<&'static str> {
        (self.share == 0.0).then_some("a share above 0")
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.worn_lines = Some(self.clone());
        Ok(())
    }
}
