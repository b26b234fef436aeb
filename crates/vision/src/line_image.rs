//! What refinement measures lines in: the picture's luma at working resolution, and where it shows no floor.

use super::WorkingScale;
use super::carpet::Surface;
use super::contrast::{STRAY_LEVELS, coarse_middle, coarse_size};
use super::picture::Picture;
use realitysim_geometry::multiversion::rounded;
use realitysim_geometry::multiversioned;

/// Places of a profile that are calculated together.
const TOGETHER: usize = 16;

#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineImage {
    width: usize,
    height: usize,
    luma: Vec<u8>,
    /// Of half-resolution pixels.
    pub(super) surfaces: Vec<Surface>,
    scale: WorkingScale,
    /// Share of the carpet's brightness by which a line of the best width stands out of it in the narrow blur; infinite if none
    /// does.
    full_contrast: f32,
    noise: f32,
    /// How far single places of the carpet stand out of their neighbours.
    samples: Vec<f32>,
}

/// Of the places of the carpet, the share that stands out less than one standard deviation of a normal distribution.
const WITHIN_SIGMA: f64 = 0.683;
/// One place in so many cells of the carpet is looked at, each way.
const NOISE_STEP: usize = 2;
const FEWEST_SAMPLES: usize = 20;
/// Half of what is looked at across a place of the carpet, in pixels.
const REACH: usize = 5;

impl LineImage {
    /// `on_carpet` has one entry per cell of [`super::contrast::coarse_centres`].
    pub(super) fn fill(&mut self, working: &Picture, scale: WorkingScale, full_contrast: f32, on_carpet: &[bool]) {
        (self.width, self.height) = (working.width, working.height);
        self.luma.clone_from(&working.luma);
        (self.scale, self.full_contrast) = (scale, full_contrast);
        self.measure_noise(on_carpet);
    }

    pub fn full_contrast(&self) -> f32 {
        self.full_contrast
    }

    /// Standard deviation, as a share of its brightness, of how far plain carpet stands out where a line of three pixels is looked
    /// for: blades, glints, the sensor's noise, JPEG.
    pub fn noise(&self) -> f32 {
        self.noise
    }

    /// Lines are a small part of the carpet, and what stands out far does not move the quantile.
    fn measure_noise(&mut self, on_carpet: &[bool]) {
        let (columns, rows) = coarse_size(self.width, self.height);
        self.samples.clear();
        // Two of each place: as many as there can be, so that no later frame needs more.
        self.samples.reserve(2 * columns.div_ceil(NOISE_STEP) * rows.div_ceil(NOISE_STEP));
        for row in (1..rows.saturating_sub(1)).step_by(NOISE_STEP) {
            for column in (1..columns.saturating_sub(1)).step_by(NOISE_STEP) {
                let (u, v) = (2 * coarse_middle(column) + 1, 2 * coarse_middle(row) + 1);
                let shows = self.surfaces.get(v / 2 * (self.width / 2) + u / 2);
                if on_carpet.get(row * columns + column) == Some(&true) && shows == Some(&Surface::Carpet) {
                    let at = v * self.width + u;
                    let across = [1, self.width].map(|step| self.stands_out(at, step));
                    self.samples.extend(across);
                }
            }
        }
        self.noise = if self.samples.len() < FEWEST_SAMPLES {
            0.0
        } else {
            let index = ((self.samples.len() - 1) as f64 * WITHIN_SIGMA) as usize;
            *self.samples.select_nth_unstable_by(index, f32::total_cmp).1
        };
    }

    /// `step` from pixel to pixel; at least [`REACH`] of them lie on each side.
    fn stands_out(&self, at: usize, step: usize) -> f32 {
        let value = |off: isize| f32::from(self.luma[at.wrapping_add_signed(off * step as isize)]);
        let band = (value(-1) + value(0) + value(1)) * (1.0 / 3.0);
        let reach = REACH as isize;
        let flank = (value(-reach) + value(1 - reach) + value(reach - 1) + value(reach)) * 0.25;
        (band - flank).abs() / (flank + STRAY_LEVELS)
    }

    /// Full-size image coordinates to those of this image.
    pub fn scale(&self) -> WorkingScale {
        self.scale
    }

    /// Luma between pixels along a straight line, in this image's coordinates: `values[k]` is that of `middle` and
    /// `k - values.len() / 2` times `step`. False if a part of it lies outside.
    pub fn profile(&self, middle: [f32; 2], step: [f32; 2], values: &mut [f32]) -> bool {
        let half = (values.len() / 2) as f32;
        let ends = [-half, values.len() as f32 - 1.0 - half];
        let place = |steps: f32| [middle[0] + steps * step[0], middle[1] + steps * step[1]];
        if !ends.iter().all(|end| self.holds(place(*end))) {
            return false;
        }
        for (chunk, values) in values.chunks_mut(TOGETHER).enumerate() {
            let first = (chunk * TOGETHER) as f32 - half;
            let Places { at, shares } = Places::along(middle, step, first, self.width as u32);
            let (mut upper, mut lower) = ([[0u8; 2]; TOGETHER], [[0u8; 2]; TOGETHER]);
            for (k, at) in at.iter().enumerate().take(values.len()) {
                let at = *at as usize;
                upper[k].copy_from_slice(&self.luma[at..at + 2]);
                lower[k].copy_from_slice(&self.luma[at + self.width..at + self.width + 2]);
            }
            let blended = blended(&shares, &upper, &lower);
            values.copy_from_slice(&blended[..values.len()]);
        }
        true
    }

    /// Whether four pixels lie around a place; not for NaN.
    fn holds(&self, [u, v]: [f32; 2]) -> bool {
        u >= 0.0 && v >= 0.0 && u < (self.width - 1) as f32 && v < (self.height - 1) as f32
    }

    /// Whether something stands between camera and floor there (a robot, a person, the own body), or the place lies outside.
    pub fn hides(&self, u: f32, v: f32) -> bool {
        if !(u >= 0.0 && v >= 0.0) {
            return true;
        }
        let (column, row) = (u as usize / 2, v as usize / 2);
        let width = self.width / 2;
        column >= width || self.surfaces.get(row * width + column).is_none_or(|surface| *surface == Surface::Other)
    }
}

/// Places on a straight line: the upper left of the four pixels around each, and how far on it lies, across and down.
struct Places {
    at: [u32; TOGETHER],
    shares: [[f32; TOGETHER]; 2],
}

impl Places {
    /// None of them may lie outside of the image.
    fn along(middle: [f32; 2], step: [f32; 2], first: f32, width: u32) -> Self {
        multiversioned!(|middle: [f32; 2], step: [f32; 2], first: f32, width: u32| -> Places {
            let mut places = Places { at: [0; TOGETHER], shares: [[0.0; TOGETHER]; 2] };
            for k in 0..TOGETHER {
                let steps = first + k as i32 as f32;
                let (u, v) = (middle[0] + steps * step[0], middle[1] + steps * step[1]);
                // The whole number below, or at a whole number the one before, whose neighbour then has all of the weight.
                let (column, row) = (rounded((u - 0.5).max(0.0)), rounded((v - 0.5).max(0.0)));
                places.at[k] = row * width + column;
                places.shares[0][k] = u - column as i32 as f32;
                places.shares[1][k] = v - row as i32 as f32;
            }
            places
        })
    }
}

fn blended(shares: &[[f32; TOGETHER]; 2], upper: &[[u8; 2]; TOGETHER], lower: &[[u8; 2]; TOGETHER]) -> [f32; TOGETHER] {
    type Pairs = [[u8; 2]; TOGETHER];
    multiversioned!(|shares: &[[f32; TOGETHER]; 2], upper: &Pairs, lower: &Pairs| -> [f32; TOGETHER] {
        let mut blended = [0.0; TOGETHER];
        for k in 0..TOGETHER {
            let across = |pair: [u8; 2]| {
                let pair = i32::from(u16::from_le_bytes(pair));
                let (left, right) = ((pair & 255) as f32, (pair >> 8) as f32);
                left + (right - left) * shares[0][k]
            };
            let (above, below) = (across(upper[k]), across(lower[k]));
            blended[k] = above + (below - above) * shares[1][k];
        }
        blended
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn image() -> LineImage {
        let luma: Vec<u8> = (0..40 * 30u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        LineImage { width: 40, height: 30, luma, ..LineImage::default() }
    }

    proptest! {
        #[test]
        fn a_profile_is_what_lies_between_the_pixels(
            u in -1.0..41.0f32, v in -1.0..31.0f32, du in -1.5..1.5f32, dv in -1.5..1.5f32, count in 1usize..40,
        ) {
            let image = image();
            let mut values = vec![f32::NAN; count];
            // Whole numbers too, which a rounding may get wrong.
            let [u, v] = if count % 3 == 0 { [u.round(), v.round()] } else { [u, v] };
            let places: Vec<[f32; 2]> = (0..count)
                .map(|k| k as f32 - (count / 2) as f32)
                .map(|steps| [u + steps * du, v + steps * dv])
                .collect();
            let inside = image.profile([u, v], [du, dv], &mut values);
            prop_assert_eq!(inside, places.iter().all(|place| image.holds(*place)));
            if inside {
                for ([u, v], value) in places.into_iter().zip(values) {
                    let (column, row) = (u as usize, v as usize);
                    let (fu, fv) = (u - column as f32, v - row as f32);
                    let pixel = |du: usize, dv: usize| f32::from(image.luma[(row + dv) * 40 + column + du]);
                    let upper = pixel(0, 0) + (pixel(1, 0) - pixel(0, 0)) * fu;
                    let lower = pixel(0, 1) + (pixel(1, 1) - pixel(0, 1)) * fu;
                    prop_assert_eq!(upper + (lower - upper) * fv, value);
                }
            }
        }
    }
}
