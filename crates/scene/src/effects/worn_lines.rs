//! Paint that feet and tape have rubbed off: lines are fainter, in patches more so.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WornLines {
    pub role: Option<Role>,
    /// How much of the paint is gone: 0 to 1, on average.
    pub share: f64,
    /// Size of the largest patches.
    pub patch_m: f64,
}

impl WornLines {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.share"), self.share, 0.0..=1.0, "0 (new paint) to 1 (none left)")?;
        within(format_args!("{key}.patch_m"), self.patch_m, 0.05..=2.0, "0.05 to 2 m")
    }
}
