//! The light in which everything is seen.

use super::super::effects::LightModel;
use super::sheet::Colour;

/// Daylight is `()`: then nothing is computed, and colours keep their bits.
pub(super) trait Lit {
    /// `place` is x and y of what is lit.
    fn lit(&self, colour: Colour, place: impl FnOnce() -> [f32; 2]) -> Colour;
}

impl Lit for () {
    #[inline]
    fn lit(&self, colour: Colour, _: impl FnOnce() -> [f32; 2]) -> Colour {
        colour
    }
}

impl Lit for LightModel {
    #[inline]
    fn lit(&self, colour: Colour, place: impl FnOnce() -> [f32; 2]) -> Colour {
        let gain = self.at(place());
        core::array::from_fn(|channel| colour[channel] * gain[channel])
    }
}
