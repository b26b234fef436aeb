//! Light that differs from the even, white daylight of the renderer: dusk, a bright side of the hall, coloured lamps.
//!
//! The effect scales image values before the noise of the sensor. A camera in the dark first exposes longer, which adds no
//! noise, and then amplifies the signal together with its noise. Light in a scene does not change with time, so an
//! automatic exposure has settled: `camera_gain` is the amplification at which it has settled.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::SceneError;
use crate::check::check_range;
use crate::per_frame::Changing;
use realitysim_geometry::Field;

/// Light of the hall.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Factor of the image values, compared with daylight.
    ///
    /// It is a factor of values, not of lux: with the usual gamma of a camera 0.12 is about a hundredth of the light.
    pub gain: f64,
    /// Growth of the light per metre along x and y of `map`, as a share of the light at the centre of the field.
    #[serde(default)]
    pub gradient_per_m: [f64; 2],
    /// Red, green and blue of the lamps. White is 1, 1, 1.
    #[serde(default = "white")]
    pub colour: [f64; 3],
    /// Amplification of the sensor's signal in the camera, noise included.
    #[serde(default = "unity")]
    pub camera_gain: f64,
}

/// The light, prepared for the pixel loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LightModel {
    /// Factors of red, green and blue at the centre of the field.
    gain: [f32; 3],
    gradient_per_m: [f32; 2],
    camera_gain: f64,
}

/// Bounds of the gradient's factor. Some light comes from everywhere, and no lamp is more than three times as bright.
const GRADIENT_BOUNDS: [f32; 2] = [0.1, 3.0];

fn white() -> [f64; 3] {
    [1.0; 3]
}

fn unity() -> f64 {
    1.0
}

impl EffectKind for Light {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.gain"), self.gain, 0.01..=3.0, "0.01 to 3 times the image values of daylight")?;
        for (axis, value) in ["x", "y"].iter().zip(self.gradient_per_m) {
            let key = format_args!("{key}.gradient_per_m ({axis})").to_string();
            check_range(key, value, -1.0..=1.0, "-1 to 1 per metre")?;
        }
        for (channel, value) in ["red", "green", "blue"].iter().zip(self.colour) {
            let key = format_args!("{key}.colour ({channel})").to_string();
            check_range(key, value, 0.0..=2.0, "0 to 2, where white is 1")?;
        }
        check_range(format_args!("{key}.camera_gain"), self.camera_gain, 1.0..=16.0, "an amplification of 1 to 16")
    }

    fn lacks(&self) -> Option<&'static str> {
        self.is_daylight().then_some("a gain or camera_gain other than 1, a gradient or a colour other than white")
    }

    fn set_in(&self, changing: &mut Changing, _: u64) {
        changing.light = Some(self.model());
    }
}

impl Light {
    /// Whether the values change nothing.
    pub(super) fn is_daylight(&self) -> bool {
        let Self { role: _, gain, gradient_per_m, colour, camera_gain } = self;
        (*gain, *camera_gain) == (1.0, 1.0) && *gradient_per_m == [0.0; 2] && *colour == white()
    }

    /// Prepares the light for the pixel loop.
    pub(crate) fn model(&self) -> LightModel {
        LightModel {
            gain: self.colour.map(|channel| (self.gain * self.camera_gain * channel) as f32),
            gradient_per_m: self.gradient_per_m.map(|share| share as f32),
            camera_gain: self.camera_gain,
        }
    }
}

impl LightModel {
    /// Amplification of the signal in the camera.
    pub(crate) fn camera_gain(&self) -> f64 {
        self.camera_gain
    }

    /// Applies the light to an RGB image of unknown pose, without the gradient.
    pub(crate) fn apply(&self, pixels: &mut [u8]) {
        for pixel in pixels.chunks_exact_mut(3) {
            for (value, gain) in pixel.iter_mut().zip(self.gain) {
                *value = (f32::from(*value) * gain + 0.5).min(255.0) as u8;
            }
        }
    }

    /// Factors of red, green and blue at (x, y) in `map`, compared with daylight.
    pub(crate) fn at(&self, [x, y]: [f32; 2]) -> [f32; 3] {
        let [along_x, along_y] = self.gradient_per_m;
        let share = (1.0 + along_x * x + along_y * y).clamp(GRADIENT_BOUNDS[0], GRADIENT_BOUNDS[1]);
        self.gain.map(|gain| gain * share)
    }
}
