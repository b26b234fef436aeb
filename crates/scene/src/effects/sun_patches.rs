//! Sunlight that falls through windows onto the floor: bright patches with soft edges.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SunPatches {
    pub role: Option<Role>,
    /// Image values in the sun are this times those beside it.
    pub gain: f64,
    /// Share of the floor's panes of light that the sun comes through.
    pub share: f64,
    /// Length of a pane; it is half as wide.
    pub length_m: f64,
    /// Over which its light fades.
    pub edge_m: f64,
}

impl SunPatches {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.gain"), self.gain, 1.0..=4.0, "1 to 4 times the image values beside it")?;
        within(format_args!("{key}.share"), self.share, 0.0..=1.0, "0 to 1")?;
        within(format_args!("{key}.length_m"), self.length_m, 0.2..=10.0, "0.2 to 10 m")?;
        within(format_args!("{key}.edge_m"), self.edge_m, 0.01..=2.0, "0.01 to 2 m")
    }
}
