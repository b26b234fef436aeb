//! The light in which everything is seen.

use super::super::effects::LightModel;
use super::macro_texture::Colour;

/// `place` is x and y of what is lit. By daylight nothing is computed, and colours keep their bits.
#[inline]
pub(super) fn lit(light: Option<&LightModel>, colour: Colour, place: impl FnOnce() -> [f32; 2]) -> Colour {
    let Some(light) = light else { return colour };
    let gain = light.at(place());
    core::array::from_fn(|channel| colour[channel] * gain[channel])
}
