//! An automatic exposure that does not settle: the brightness of the pictures swings as a sine.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use realitysim_geometry::Field;

/// Swing of the automatic exposure.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExposureHunting {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Amplitude of the brightness, as a share of its mean.
    pub amplitude: f64,
    /// Period of the swing, seconds.
    pub period_s: f64,
}

impl EffectKind for ExposureHunting {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.amplitude"), self.amplitude, 0.0..=0.8, "0 to 0.8 of the mean")?;
        check_range(format_args!("{key}.period_s"), self.period_s, 0.1..=60.0, "0.1 to 60 s")
    }

    fn lacks(&self) -> Option<&'static str> {
        (self.amplitude == 0.0).then_some("an amplitude above 0")
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.exposure_hunting = Some(self.clone());
        Ok(())
    }
}

impl ExposureHunting {
    /// Scales the RGB values of a picture that is taken at `time_s`, seconds since the start.
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
    fn a_picture_is_brightest_after_one_and_darkest_after_three_quarters() {
        let hunting = ExposureHunting { role: None, amplitude: 0.5, period_s: 4.0 };
        for (time_s, expected) in [(0.0, 100), (1.0, 150), (2.0, 100), (3.0, 50), (4.0, 100)] {
            let mut pixels = [100];
            hunting.apply(time_s, &mut pixels);
            assert_eq!(pixels[0], expected, "{time_s} s");
        }
    }
}
