//! Flaws of a cheap lens: stray light over the whole picture, and lateral chromatic aberration.

use serde::Deserialize;

use super::{EffectKind, Role};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use realitysim_geometry::Field;

/// Flaws of the lens.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Share of the light that is spread evenly over the picture.
    pub stray_light: f64,
    /// Shift of red outwards and of blue inwards at the farthest corner, pixels. It is proportional to the radius.
    pub lateral_colour_px: f64,
}

impl EffectKind for Optics {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.stray_light"), self.stray_light, 0.0..=0.5, "0 to 0.5 of the light")?;
        check_range(format_args!("{key}.lateral_colour_px"), self.lateral_colour_px, 0.0..=5.0, "0 to 5 pixels")
    }

    fn lacks(&self) -> Option<&'static str> {
        self.is_perfect().then_some("stray_light or lateral_colour_px above 0")
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.optics = Some(self.clone());
        Ok(())
    }
}

impl Optics {
    /// Whether the values change nothing.
    pub(super) fn is_perfect(&self) -> bool {
        self.stray_light == 0.0 && self.lateral_colour_px == 0.0
    }

    /// Applies the flaws to RGB pixels, `width` per row. `centre` is the pixel on the optical axis.
    pub(crate) fn apply(&self, width: usize, centre: [f64; 2], pixels: &mut [u8]) {
        if self.lateral_colour_px > 0.0 {
            self.scale_colours(width, centre, pixels);
        }
        if self.stray_light > 0.0 {
            self.add_stray_light(pixels);
        }
    }

    /// Enlarges red and shrinks blue about the centre, with bilinear interpolation.
    fn scale_colours(&self, width: usize, centre: [f64; 2], pixels: &mut [u8]) {
        let height = pixels.len() / 3 / width;
        let farthest = |at: f64, count: usize| at.max(count as f64 - 1.0 - at);
        let corner = libm::hypot(farthest(centre[0], width), farthest(centre[1], height));
        let sharp = pixels.to_vec();
        for (channel, outwards) in [(0, 1.0), (2, -1.0)] {
            // The source of a pixel that is shifted outwards lies nearer to the centre.
            let scale = 1.0 - outwards * self.lateral_colour_px / corner;
            let source = |at: usize, centre: f64, count: usize| {
                let from = (centre + (at as f64 - centre) * scale).clamp(0.0, count as f64 - 1.0);
                let first = (from as usize).min(count.saturating_sub(2));
                (first, (from - first as f64) as f32)
            };
            let columns: Vec<(usize, f32)> = (0..width).map(|u| source(u, centre[0], width)).collect();
            for (v, row) in pixels.chunks_exact_mut(3 * width).enumerate() {
                let (top, down) = source(v, centre[1], height);
                let value = |row: usize, column: usize| {
                    let (row, column) = (row.min(height - 1), column.min(width - 1));
                    f32::from(sharp[3 * (row * width + column) + channel])
                };
                for ((left, right), pixel) in columns.iter().zip(row.chunks_exact_mut(3)) {
                    let across = |row: usize| value(row, *left) * (1.0 - right) + value(row, left + 1) * right;
                    pixel[channel] = (across(top) * (1.0 - down) + across(top + 1) * down + 0.5) as u8;
                }
            }
        }
    }

    /// Mixes every pixel with the mean colour of the picture.
    fn add_stray_light(&self, pixels: &mut [u8]) {
        let sums = pixels
            .chunks_exact(3)
            .fold([0u64; 3], |sums, pixel| core::array::from_fn(|channel| sums[channel] + u64::from(pixel[channel])));
        let count = (pixels.len() / 3).max(1) as f64;
        let direct = (1.0 - self.stray_light) as f32;
        let stray = sums.map(|sum| (self.stray_light * sum as f64 / count + 0.5) as f32);
        for pixel in pixels.chunks_exact_mut(3) {
            pixel.iter_mut().zip(stray).for_each(|(value, stray)| *value = (f32::from(*value) * direct + stray) as u8);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn optics(stray_light: f64, lateral_colour_px: f64) -> Optics {
        Optics { role: None, stray_light, lateral_colour_px }
    }

    #[test]
    fn stray_light_keeps_the_mean_and_lowers_contrast() {
        let mut pixels: Vec<u8> = (0..300).map(|index| if index / 3 % 2 == 0 { 40 } else { 200 }).collect();
        optics(0.25, 0.0).apply(10, [4.5, 4.5], &mut pixels);
        assert!(pixels.iter().all(|value| value.abs_diff(60) <= 1 || value.abs_diff(180) <= 1), "{:?}", &pixels[..6]);
    }

    #[test]
    fn red_is_shifted_outwards_and_blue_inwards_as_stated() {
        // The picture has a white column 40 pixels right of the centre, and its corners are 50 pixels from the centre.
        let (width, height, centre) = (101, 3, [50.0, 1.0]);
        let mut pixels: Vec<u8> =
            (0..width * height).flat_map(|at| [if at % width == 90 { 200 } else { 0 }; 3]).collect();
        optics(0.0, 2.5).apply(width, centre, &mut pixels);
        let place = |channel: usize| {
            let row = &pixels[3 * width..6 * width];
            let values = || row.chunks_exact(3).map(|pixel| f64::from(pixel[channel]));
            values().enumerate().map(|(u, value)| u as f64 * value).sum::<f64>() / values().sum::<f64>()
        };
        assert!((place(0) - 92.0).abs() < 0.2 && (place(1) - 90.0).abs() < 1e-9 && (place(2) - 88.0).abs() < 0.2);
    }
}
