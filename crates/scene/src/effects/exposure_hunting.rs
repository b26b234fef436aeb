//! An automatic exposure that does not settle: pictures become brighter and darker again.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureHunting {
    pub role: Option<Role>,
    /// The brightest picture is so much brighter than the mean, as a share of it, and the darkest so much darker.
    pub amplitude: f64,
    pub period_s: f64,
}

impl ExposureHunting {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.amplitude"), self.amplitude, 0.0..=0.8, "0 to 0.8 of the mean")?;
        within(format_args!("{key}.period_s"), self.period_s, 0.1..=60.0, "0.1 to 60 s")
    }

    /// RGB of the picture taken at this time of the scene.
    pub(crate) fn apply(&self, time_s: f64, pixels: &mut [u8]) {
        let gain = 1.0 + self.amplitude * libm::sin(core::f64::consts::TAU * time_s / self.period_s);
        let table: [u8; 256] = core::array::from_fn(|value| libm::round(value as f64 * gain).min(255.0) as u8);
        pixels.iter_mut().for_each(|value| *value = table[usize::from(*value)]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_of_a_period_is_brightest_and_three_are_darkest() {
        let hunting = ExposureHunting { role: None, amplitude: 0.5, period_s: 4.0 };
        for (time_s, expected) in [(0.0, 100), (1.0, 150), (2.0, 100), (3.0, 50), (4.0, 100)] {
            let mut pixels = [100];
            hunting.apply(time_s, &mut pixels);
            assert_eq!(pixels[0], expected, "{time_s} s");
        }
    }
}
