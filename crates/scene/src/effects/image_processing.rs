//! Image processing in the camera: interpolation of the colour mosaic (demosaicing), and sharpening.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use realitysim_geometry::Field;

/// Demosaicing and sharpening in the camera.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageProcessing {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// If true, each pixel measures one colour of the Bayer pattern RGGB, and the others are the means of its neighbours.
    pub colour_filter: bool,
    /// Multiple of the difference between a pixel and the mean of its 3 x 3 neighbourhood that is added to the pixel.
    ///
    /// Edges get a halo.
    pub sharpening: f64,
}

impl EffectKind for ImageProcessing {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.sharpening"), self.sharpening, 0.0..=3.0, "0 to 3")
    }

    fn lacks(&self) -> Option<&'static str> {
        self.has_no_effect().then_some("colour_filter, or sharpening above 0")
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.image_processing = Some(self.clone());
        Ok(())
    }
}

impl ImageProcessing {
    /// Whether the values change nothing.
    pub(super) fn has_no_effect(&self) -> bool {
        !self.colour_filter && self.sharpening == 0.0
    }

    /// Processes RGB pixels, `width` per row. The pixels at the border stay as they are.
    pub(crate) fn apply(&self, width: usize, pixels: &mut [u8]) {
        if self.colour_filter {
            demosaic(width, pixels);
        }
        if self.sharpening > 0.0 {
            self.sharpen(width, pixels);
        }
    }

    fn sharpen(&self, width: usize, pixels: &mut [u8]) {
        let soft = pixels.to_vec();
        let height = pixels.len() / 3 / width;
        let amount = (256.0 * self.sharpening) as i32;
        for v in 1..height.max(1) - 1 {
            for index in 3 * (v * width + 1)..3 * ((v + 1) * width - 1) {
                let across = |at: usize| [at - 3, at, at + 3].map(|at| i32::from(soft[at])).iter().sum::<i32>();
                let sum = across(index - 3 * width) + across(index) + across(index + 3 * width);
                let own = i32::from(soft[index]);
                pixels[index] = (own + (amount * (9 * own - sum)) / (9 * 256)).clamp(0, 255) as u8;
            }
        }
    }
}

/// Channel that a pixel of the Bayer mosaic measures: 0 red, 1 green, 2 blue.
fn bayer_channel(u: usize, v: usize) -> usize {
    [[0, 1], [1, 2]][v % 2][u % 2]
}

/// Keeps one channel of each pixel and interpolates the others bilinearly.
fn demosaic(width: usize, pixels: &mut [u8]) {
    let height = pixels.len() / 3 / width;
    let seen: Vec<u16> = pixels
        .chunks_exact(3)
        .enumerate()
        .map(|(at, pixel)| u16::from(pixel[bayer_channel(at % width, at / width)]))
        .collect();
    for v in 1..height.max(1) - 1 {
        for u in 1..width.max(1) - 1 {
            let at = v * width + u;
            let beside = (seen[at - 1] + seen[at + 1]).div_ceil(2);
            let above = (seen[at - width] + seen[at + width]).div_ceil(2);
            let cross = (seen[at - 1] + seen[at + 1] + seen[at - width] + seen[at + width] + 2) / 4;
            let corners =
                (seen[at - width - 1] + seen[at - width + 1] + seen[at + width - 1] + seen[at + width + 1] + 2) / 4;
            let own = seen[at];
            let colours = match (v % 2, u % 2) {
                (0, 0) => [own, cross, corners],
                (0, _) => [beside, own, above],
                (_, 0) => [above, own, beside],
                _ => [corners, cross, own],
            };
            pixels[3 * at..3 * at + 3].iter_mut().zip(colours).for_each(|(value, colour)| *value = colour as u8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_image_is_not_changed() {
        let plain: Vec<u8> = [90, 120, 60].repeat(80);
        let mut pixels = plain.clone();
        ImageProcessing { role: None, colour_filter: true, sharpening: 2.0 }.apply(10, &mut pixels);
        assert_eq!(pixels, plain);
    }

    #[test]
    fn a_brightness_gradient_is_recovered_from_the_mosaic() {
        let slope: Vec<u8> = (0..12 * 9).flat_map(|at| [(4 * (at % 12) + 6 * (at / 12)) as u8; 3]).collect();
        let mut pixels = slope.clone();
        ImageProcessing { role: None, colour_filter: true, sharpening: 0.0 }.apply(12, &mut pixels);
        assert!(pixels.iter().zip(&slope).all(|(own, true_one)| own.abs_diff(*true_one) <= 1));
    }

    #[test]
    fn an_edge_gets_a_halo_on_both_sides() {
        let mut pixels: Vec<u8> = (0..8 * 5).flat_map(|at| [if at % 8 < 4 { 60 } else { 150 }; 3]).collect();
        ImageProcessing { role: None, colour_filter: false, sharpening: 1.0 }.apply(8, &mut pixels);
        let row: Vec<u8> = pixels[2 * 24..3 * 24].chunks_exact(3).map(|pixel| pixel[0]).collect();
        assert_eq!(row, [60, 60, 60, 30, 180, 150, 150, 150]);
    }
}
