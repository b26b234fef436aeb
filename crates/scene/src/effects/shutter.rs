//! Motion blur and rolling shutter: the camera moves while rows are exposed and read one after the other.

use core::ops::Range;

use serde::Deserialize;

use super::{Effect, EffectKind, Role, require};
use crate::SceneError;
use crate::check::check_range;
use crate::file::SceneFile;
use crate::per_frame::Changing;
use realitysim_geometry::Field;

/// Exposure over time. The stamp of a frame is the middle of the exposure of its middle row.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shutter {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Exposure time of each row, ms.
    pub exposure_ms: f64,
    /// Time from the first row to the last, ms. 0 means that all rows are exposed at once (global shutter).
    pub readout_ms: f64,
}

/// Maximum number of pictures that are averaged for one exposure. Below it there is one picture per pixel of motion.
const MAX_PICTURES: usize = 12;
/// Number of rows that are rendered at the same time. In their share of the readout the image moves by less than a pixel.
const BAND_ROWS: usize = 8;

impl EffectKind for Shutter {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        let exposure = self.exposure_ms;
        check_range(
            format_args!("{key}.exposure_ms"),
            exposure,
            0.01..=200.0,
            "0.01 to 200 ms: no light comes in 0 ms",
        )?;
        check_range(format_args!("{key}.readout_ms"), self.readout_ms, 0.0..=200.0, "0 (global shutter) to 200 ms")
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        require(
            file.effects.iter().any(Effect::moves_camera),
            "it needs gait_sway or head_motion with an amplitude above 0: without motion it shows nothing",
        )
    }

    fn set_in(&self, changing: &mut Changing, _: u64) {
        changing.shutter = Some(self.clone());
    }

    fn check_in(&self, key: &str, file: &SceneFile) -> Result<(), SceneError> {
        let period_ms = 1e3 / file.camera.rate_hz;
        let expected = format!(
            "a frame is exposed and read out before the next one: exposure_ms and readout_ms are at most {period_ms:.2} ms \
             together, at {} images per second",
            file.camera.rate_hz
        );
        let takes_ms = self.exposure_ms + self.readout_ms;
        check_range(format_args!("{key}.exposure_ms, with readout_ms,"), takes_ms, 0.0..=period_ms, &expected)
    }
}

impl Shutter {
    /// Ranges of rows that are exposed together.
    pub(crate) fn bands(&self, height: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let rows = if self.readout_ms == 0.0 { height } else { BAND_ROWS };
        (0..height).step_by(rows.max(1)).map(move |row| row..(row + rows).min(height))
    }

    /// Times at which a band of rows is rendered, seconds from the stamp of the frame. `speed` is in pixels per second.
    pub(crate) fn sample_times(
        &self,
        band: &Range<usize>,
        height: usize,
        speed: f64,
    ) -> impl Iterator<Item = f64> + use<> {
        let (exposure, readout) = (self.exposure_ms / 1e3, self.readout_ms / 1e3);
        let middle = (band.start + band.end) as f64 / (2 * height) as f64 - 0.5;
        let count = (libm::ceil(speed * exposure) as usize).clamp(1, MAX_PICTURES);
        (0..count).map(move |which| readout * middle + exposure * ((which as f64 + 0.5) / count as f64 - 0.5))
    }
}
