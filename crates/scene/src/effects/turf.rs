//! Artificial turf instead of flat carpet: blades of varying brightness, blades that glint, and paint on them.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use realitysim_geometry::Field;

/// Look of artificial turf.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turf {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Standard deviation of the brightness of single blades, as a share of its mean.
    pub blades: f64,
    /// Share of the ground on which a blade reflects the lamps.
    pub glint_share: f64,
    /// Quality of the paint, from 0 (thin and greyish, blades show through) to 1 (well painted).
    pub paint: f64,
    /// Standard deviation of the edge of a line from a straight line, mm.
    pub ragged_mm: f64,
}

impl EffectKind for Turf {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.blades"), self.blades, 0.0..=1.0, "0 (flat carpet) to 1")?;
        check_range(format_args!("{key}.glint_share"), self.glint_share, 0.0..=0.1, "0 to 0.1 of the ground")?;
        check_range(format_args!("{key}.paint"), self.paint, 0.0..=1.0, "0 (thin and greyish) to 1 (well painted)")?;
        check_range(format_args!("{key}.ragged_mm"), self.ragged_mm, 0.0..=20.0, "0 to 20 mm")
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.turf = Some(self.clone());
        Ok(())
    }
}
