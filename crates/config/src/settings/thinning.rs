//! Which frames a recording keeps.

use serde::{Deserialize, Serialize};

/// `[recording.thinning]`: fewer images of the same view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThinningSettings {
    pub mode: ThinningMode,
    /// Of mode `rate`: at most so many frames a second.
    pub rate_hz: f64,
    /// Of modes `novelty` and `coverage`: so far moved ...
    pub novelty_cm: f64,
    /// ... or turned since the last frame that was kept.
    pub novelty_deg: f64,
    /// Of the same modes: so many a second while the pose is not known.
    pub unknown_hz: f64,
    /// A pose is known if its standard deviation along its longer axis is at most this.
    pub max_sigma_cm: f64,
    /// Side of a cell of the pose grid.
    pub cell_m: f64,
    /// Headings told apart in a cell.
    pub headings: u16,
    /// Of mode `coverage`: a cell with so many has enough.
    pub images_per_cell: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ThinningMode {
    /// Every frame is written.
    #[default]
    All,
    Rate,
    Novelty,
    /// Novel ones, of cells that lack images.
    Coverage,
}

impl Default for ThinningSettings {
    fn default() -> Self {
        Self {
            mode: ThinningMode::All,
            rate_hz: 5.0,
            novelty_cm: 10.0,
            novelty_deg: 10.0,
            unknown_hz: 1.0,
            max_sigma_cm: 4.0,
            cell_m: 0.5,
            headings: 8,
            images_per_cell: 3,
        }
    }
}

impl ThinningSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        let within = |key, value, low, high| super::within(&format!("recording.thinning.{key}"), value, low, high);
        within("rate_hz", self.rate_hz, 0.001, 1000.0)?;
        within("novelty_cm", self.novelty_cm, 0.1, 1000.0)?;
        within("novelty_deg", self.novelty_deg, 0.1, 180.0)?;
        within("unknown_hz", self.unknown_hz, 0.001, 1000.0)?;
        within("max_sigma_cm", self.max_sigma_cm, 0.1, 100.0)?;
        within("cell_m", self.cell_m, 0.1, 5.0)?;
        within("headings", f64::from(self.headings), 1.0, 72.0)?;
        within("images_per_cell", f64::from(self.images_per_cell), 1.0, 1e6)
    }
}
