//! A shutter that stays open while the camera moves, and a sensor that is read row by row.

use core::ops::Range;

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

/// A frame's stamp is the middle of the middle row's exposure.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shutter {
    pub role: Option<Role>,
    /// Of each row.
    pub exposure_ms: f64,
    /// From the first row to the last; 0: all rows at once (global shutter).
    pub readout_ms: f64,
}

/// Pictures that one exposure is made of: as many as the camera moves pixels, up to this.
const MOST_PICTURES: usize = 12;
/// Rows that are exposed together: their part of a readout moves by less than a pixel.
const BAND_ROWS: usize = 8;

impl Shutter {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        let exposure = self.exposure_ms;
        within(format_args!("{key}.exposure_ms"), exposure, 0.01..=200.0, "0.01 to 200 ms: no light comes in 0 ms")?;
        within(format_args!("{key}.readout_ms"), self.readout_ms, 0.0..=200.0, "0 (global shutter) to 200 ms")
    }

    /// Rows that are exposed together.
    pub(crate) fn bands(&self, height: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let rows = if self.readout_ms == 0.0 { height } else { BAND_ROWS };
        (0..height).step_by(rows.max(1)).map(move |row| row..(row + rows).min(height))
    }

    /// When a band is looked at, in seconds from the frame's stamp. `turning` is in pixels per second.
    pub(crate) fn times(&self, band: &Range<usize>, height: usize, turning: f64) -> impl Iterator<Item = f64> + use<> {
        let (exposure, readout) = (self.exposure_ms / 1e3, self.readout_ms / 1e3);
        let middle = (band.start + band.end) as f64 / (2 * height) as f64 - 0.5;
        let count = (libm::ceil(turning * exposure) as usize).clamp(1, MOST_PICTURES);
        (0..count).map(move |which| readout * middle + exposure * ((which as f64 + 0.5) / count as f64 - 0.5))
    }
}
