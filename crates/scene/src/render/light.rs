//! The light of the scene applied to rendered colours.

use super::super::effects::LightModel;
use super::macro_texture::Colour;

/// The colour of a surface in the light of the scene. `place` gives x and y of the surface in `map`.
///
/// Without a light model the colour is returned unchanged, bit for bit, and `place` is not called.
#[inline]
pub(super) fn illuminate(light: Option<&LightModel>, colour: Colour, place: impl FnOnce() -> [f32; 2]) -> Colour {
    let Some(light) = light else { return colour };
    let gain = light.at(place());
    core::array::from_fn(|channel| colour[channel] * gain[channel])
}
