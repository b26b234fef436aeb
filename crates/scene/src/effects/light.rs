//! Light that is not the renderer's even, white daylight: dusk, a bright side of the hall, coloured lamps.
//!
//! Works on image values, before the sensor. A camera in the dark first exposes longer, which costs no noise, and then
//! amplifies what it has, its noise with it. Light in a scene does not change with time, so an automatic exposure has
//! settled long ago: `camera_gain` is the amplification that it has settled at.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    pub role: Option<Role>,
    /// Image values are this times those of daylight. Of values, not of lux: with a camera's usual gamma 0.12 is
    /// about a hundredth of the light.
    pub gain: f64,
    /// How the light grows along x and y of `map`, as a share of that at the field's centre.
    #[serde(default)]
    pub gradient_per_m: [f64; 2],
    /// Red, green and blue of the lamps; white is 1, 1, 1.
    #[serde(default = "white")]
    pub colour: [f64; 3],
    /// What the camera multiplies the sensor's signal with, noise included.
    #[serde(default = "unity")]
    pub camera_gain: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LightModel {
    gain: [f32; 3],
    gradient_per_m: [f32; 2],
    camera_gain: f64,
}

/// However strong the gradient: some light comes from everywhere, and no lamp is that much brighter.
const RANGE: [f32; 2] = [0.1, 3.0];

fn white() -> [f64; 3] {
    [1.0; 3]
}

fn unity() -> f64 {
    1.0
}

impl Light {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.gain"), self.gain, 0.01..=3.0, "0.01 to 3 times the image values of daylight")?;
        for (axis, value) in ["x", "y"].iter().zip(self.gradient_per_m) {
            let key = format_args!("{key}.gradient_per_m ({axis})").to_string();
            within(key, value, -1.0..=1.0, "-1 to 1 per metre")?;
        }
        for (channel, value) in ["red", "green", "blue"].iter().zip(self.colour) {
            let key = format_args!("{key}.colour ({channel})").to_string();
            within(key, value, 0.0..=2.0, "0 to 2, where white is 1")?;
        }
        within(format_args!("{key}.camera_gain"), self.camera_gain, 1.0..=16.0, "an amplification of 1 to 16")
    }

    pub(super) fn is_daylight(&self) -> bool {
        let Self { role: _, gain, gradient_per_m, colour, camera_gain } = self;
        (*gain, *camera_gain) == (1.0, 1.0) && *gradient_per_m == [0.0; 2] && *colour == white()
    }

    pub(crate) fn model(&self) -> LightModel {
        LightModel {
            gain: self.colour.map(|channel| (self.gain * self.camera_gain * channel) as f32),
            gradient_per_m: self.gradient_per_m.map(|share| share as f32),
            camera_gain: self.camera_gain,
        }
    }
}

impl LightModel {
    pub(crate) fn camera_gain(&self) -> f64 {
        self.camera_gain
    }

    /// To an image of which nobody knows where it was taken.
    pub(crate) fn apply(&self, pixels: &mut [u8]) {
        for pixel in pixels.chunks_exact_mut(3) {
            for (value, gain) in pixel.iter_mut().zip(self.gain) {
                *value = (f32::from(*value) * gain + 0.5).min(255.0) as u8;
            }
        }
    }

    /// Red, green and blue above (x, y), as factors of the colour by daylight.
    pub(crate) fn at(&self, [x, y]: [f32; 2]) -> [f32; 3] {
        let [along_x, along_y] = self.gradient_per_m;
        let share = (1.0 + along_x * x + along_y * y).clamp(RANGE[0], RANGE[1]);
        self.gain.map(|gain| gain * share)
    }
}
