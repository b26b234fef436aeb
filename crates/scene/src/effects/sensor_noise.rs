//! Noise of the image sensor: constant read noise, and shot noise that grows with the square root of the brightness.

use std::sync::Arc;

use serde::Deserialize;

use super::{EffectKind, LightModel, Role};
use crate::SceneError;
use crate::check::check_range;
use crate::per_frame::Changing;
use crate::stream::{self, Purpose, Stream};
use realitysim_geometry::Field;

/// Noise of the image sensor. Values are in digital numbers (DN), the 0 to 255 of the image.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorNoise {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Standard deviation in the dark, DN.
    pub read_noise_dn: f64,
    /// Standard deviation of the shot noise divided by the square root of the value. 0.15 gives 2.1 DN at 200 DN.
    pub shot_noise_factor: f64,
}

/// Tables for the pixel loop. It uses integers only, so that it is fast and gives the same result on every machine.
#[derive(Clone, Debug)]
pub(crate) struct NoiseModel {
    seed: u64,
    /// Standard deviation for each image value, in 1/256 DN.
    deviation: Box<[i32; 256]>,
    /// Equally likely values of the standard normal distribution, in 1/4096.
    normal: Arc<[i16; NORMALS]>,
}

/// Number of equally likely values in the table of normals.
const NORMALS: usize = 4096;
/// Upper bound of the standard deviation, DN. Such an image is pure noise, and the products of the pixel loop stay within 32 bits.
const DEVIATION_CAP_DN: f64 = 500.0;
/// Number of 12 bit table indices that 64 bits hold.
const DRAWS_PER_HASH: usize = 5;

impl EffectKind for SensorNoise {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.read_noise_dn"), self.read_noise_dn, 0.0..=50.0, "0 to 50 DN")?;
        check_range(format_args!("{key}.shot_noise_factor"), self.shot_noise_factor, 0.0..=3.0, "0 to 3")
    }

    fn lacks(&self) -> Option<&'static str> {
        (self.read_noise_dn == 0.0 && self.shot_noise_factor == 0.0)
            .then_some("read_noise_dn or shot_noise_factor above 0")
    }

    fn set_in(&self, changing: &mut Changing, seed: u64) {
        let camera_gain = changing.light.as_ref().map_or(1.0, LightModel::camera_gain);
        changing.noise = Some(match &changing.noise {
            None => self.model(seed, camera_gain),
            Some(model) => model.with(self, camera_gain),
        });
    }
}

impl SensorNoise {
    /// Prepares the tables. `camera_gain` multiplies signal and noise alike, so the same image value has more noise.
    pub(crate) fn model(&self, seed: u64, camera_gain: f64) -> NoiseModel {
        let normal =
            core::array::from_fn(|index| libm::round(quantile((index as f64 + 0.5) / NORMALS as f64) * 4096.0) as i16);
        NoiseModel { seed, deviation: self.deviation(camera_gain), normal: Arc::new(normal) }
    }

    /// Standard deviation for each image value, in 1/256 DN: the root of (gain read)^2 + shot^2 gain value.
    fn deviation(&self, camera_gain: f64) -> Box<[i32; 256]> {
        let (read, shot) = (self.read_noise_dn * camera_gain, self.shot_noise_factor);
        let variance = |value: usize| read * read + shot * shot * camera_gain * value as f64;
        Box::new(core::array::from_fn(|value| (libm::sqrt(variance(value)).min(DEVIATION_CAP_DN) * 256.0 + 0.5) as i32))
    }
}

impl NoiseModel {
    /// The same random numbers with other standard deviations.
    pub(crate) fn with(&self, effect: &SensorNoise, camera_gain: f64) -> Self {
        Self { deviation: effect.deviation(camera_gain), ..self.clone() }
    }

    /// Adds noise to image values. The noise depends only on the seed, the frame and the values.
    pub(crate) fn apply(&self, frame: u64, pixels: &mut [u8]) {
        let key = Stream::new(self.seed, Purpose::SensorNoise, frame).key();
        for (counter, chunk) in pixels.chunks_mut(DRAWS_PER_HASH).enumerate() {
            let mut bits = stream::at(key, counter as u64);
            for value in chunk {
                let normal = i32::from(self.normal[bits as usize % NORMALS]);
                bits >>= 12;
                // The product is in units of 1/256 * 1/4096 = 2^-20 DN.
                let noise = (self.deviation[usize::from(*value)] * normal + (1 << 19)) >> 20;
                *value = (i32::from(*value) + noise).clamp(0, 255) as u8;
            }
        }
    }
}

/// Quantile of the standard normal distribution, by bisection.
fn quantile(probability: f64) -> f64 {
    let (mut low, mut high) = (-8.0, 8.0);
    for _ in 0..48 {
        let middle = (low + high) / 2.0;
        let below = 0.5 * libm::erfc(-middle * core::f64::consts::FRAC_1_SQRT_2);
        if below < probability { low = middle } else { high = middle }
    }
    (low + high) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_stated_deviation() {
        let effect = SensorNoise { role: None, read_noise_dn: 1.5, shot_noise_factor: 0.2 };
        let model = effect.model(3, 1.0);
        for value in [40u8, 100, 180] {
            let mut pixels = vec![value; 60_000];
            model.apply(9, &mut pixels);
            let n = pixels.len() as f64;
            let errors = || pixels.iter().map(|p| f64::from(*p) - f64::from(value));
            let mean = errors().sum::<f64>() / n;
            let variance = errors().map(|e| e * e).sum::<f64>() / n;
            // Rounding to integers adds a variance of 1/12.
            let expected = 1.5 * 1.5 + 0.04 * f64::from(value) + 1.0 / 12.0;
            assert!(mean.abs() < 0.05, "{mean}");
            assert!((variance / expected - 1.0).abs() < 0.03, "{variance} for {expected}");
        }
    }
}
