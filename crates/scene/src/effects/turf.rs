//! Artificial turf in place of flat carpet: blades whose brightness varies, blades that glint, and paint on them.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Turf {
    pub role: Option<Role>,
    /// Standard deviation of the brightness of single blades, as a share of its mean.
    pub blades: f64,
    /// Share of the ground where a blade reflects the lamps.
    pub glint_share: f64,
    /// 0 (thin and greyish, blades show through) to 1 (well painted).
    pub paint: f64,
    /// How far a line's edge strays from straight, one standard deviation.
    pub ragged_mm: f64,
}

impl Turf {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.blades"), self.blades, 0.0..=1.0, "0 (flat carpet) to 1")?;
        within(format_args!("{key}.glint_share"), self.glint_share, 0.0..=0.1, "0 to 0.1 of the ground")?;
        within(format_args!("{key}.paint"), self.paint, 0.0..=1.0, "0 (thin and greyish) to 1 (well painted)")?;
        within(format_args!("{key}.ragged_mm"), self.ragged_mm, 0.0..=20.0, "0 to 20 mm")
    }
}
