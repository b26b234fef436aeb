//! Worn paint: lines are fainter where feet and tape have rubbed them off, in patches of different strength.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::check_range;

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

impl WornLines {
    /// Checks the values. `key` is the key of the effect in the file, for error messages.
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        check_range(format_args!("{key}.share"), self.share, 0.0..=1.0, "0 (new paint) to 1 (none left)")?;
        check_range(format_args!("{key}.patch_m"), self.patch_m, 0.05..=2.0, "0.05 to 2 m")
    }
}
