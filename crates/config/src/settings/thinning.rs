//! `[recording.thinning]`: which frames a recording keeps.

use serde::{Deserialize, Serialize};

/// How many images of the same view a recording keeps. Every frame is tagged, whether its image is written or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ThinningSettings {
    /// Rule by which frames are chosen.
    pub mode: ThinningMode,
    /// Mode `rate`: largest number of frames a second.
    pub rate_hz: f64,
    /// Modes `novelty` and `coverage`: distance from the last written frame that makes a frame novel, centimetres.
    pub novelty_cm: f64,
    /// Modes `novelty` and `coverage`: turn since the last written frame that makes a frame novel, degrees.
    pub novelty_deg: f64,
    /// Modes `novelty` and `coverage`: frames a second while the pose is not known.
    pub unknown_hz: f64,
    /// Modes `novelty` and `coverage`: largest standard deviation of a known pose along its longer axis, centimetres.
    pub max_sigma_cm: f64,
    /// Side of a cell of the pose grid, metres.
    pub cell_m: f64,
    /// Number of headings that the pose grid tells apart in each cell.
    pub headings: u16,
    /// Mode `coverage`: number of images at which a cell has enough.
    pub images_per_cell: u32,
}

/// A rule by which the frames to write are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ThinningMode {
    /// Every frame is written.
    #[default]
    All,
    /// At most a certain number of frames a second is written.
    Rate,
    /// Only frames from novel poses are written.
    Novelty,
    /// Only frames from novel poses in cells of the pose grid that lack images are written.
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
        let check_range =
            |key, value, low, high| super::check_range(&format!("recording.thinning.{key}"), value, low, high);
        check_range("rate_hz", self.rate_hz, 0.001, 1000.0)?;
        check_range("novelty_cm", self.novelty_cm, 0.1, 1000.0)?;
        check_range("novelty_deg", self.novelty_deg, 0.1, 180.0)?;
        check_range("unknown_hz", self.unknown_hz, 0.001, 1000.0)?;
        check_range("max_sigma_cm", self.max_sigma_cm, 0.1, 100.0)?;
        check_range("cell_m", self.cell_m, 0.1, 5.0)?;
        check_range("headings", f64::from(self.headings), 1.0, 72.0)?;
        check_range("images_per_cell", f64::from(self.images_per_cell), 1.0, 1e6)
    }
}
