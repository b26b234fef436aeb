//! What a cheap lens adds: light that strays over the whole picture, and colours that are not equally large.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Optics {
    pub role: Option<Role>,
    /// Share of the light that is spread evenly over the picture.
    pub stray_light: f64,
    /// At the farthest corner, by how many pixels red is drawn too far out and blue too far in.
    pub lateral_colour_px: f64,
}

impl Optics {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.stray_light"), self.stray_light, 0.0..=0.5, "0 to 0.5 of the light")?;
        within(format_args!("{key}.lateral_colour_px"), self.lateral_colour_px, 0.0..=5.0, "0 to 5 pixels")
    }

    pub(super) fn is_perfect(&self) -> bool {
        self.stray_light == 0.0 && self.lateral_colour_px == 0.0
    }

    /// RGB, `width` pixels a row, seen through a lens whose axis meets the picture at `centre`.
    pub(crate) fn apply(&self, width: usize, centre: [f64; 2], pixels: &mut [u8]) {
        if self.lateral_colour_px > 0.0 {
            self.scale_colours(width, centre, pixels);
        }
        if self.stray_light > 0.0 {
            self.spread(pixels);
        }
    }

    fn scale_colours(&self, width: usize, centre: [f64; 2], pixels: &mut [u8]) {
        let height = pixels.len() / 3 / width;
        let farthest = |at: f64, count: usize| at.max(count as f64 - 1.0 - at);
        let corner = libm::hypot(farthest(centre[0], width), farthest(centre[1], height));
        let sharp = pixels.to_vec();
        for (channel, outwards) in [(0, 1.0), (2, -1.0)] {
            // What is drawn too far out is found nearer to the centre.
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

    fn spread(&self, pixels: &mut [u8]) {
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
    fn red_is_drawn_out_and_blue_in_by_so_many_pixels_at_the_corner() {
        // A white column 40 pixels right of the centre, in a picture whose corner is 50 away along the middle row.
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
