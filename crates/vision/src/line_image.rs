//! The image in which refinement locates lines: luma at working resolution, what hides the ground, contrast and noise.

use super::WorkingScale;
use super::carpet::Surface;
use super::contrast::{STRAY_LEVELS, coarse_middle, coarse_size};
use super::picture::Picture;
use realitysim_geometry::multiversion::rounded;
use realitysim_geometry::multiversioned;

/// Number of samples of a profile that are computed together.
const BATCH: usize = 16;

/// The luma of a frame at working resolution, with its full contrast and noise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LineImage {
    width: usize,
    height: usize,
    luma: Vec<u8>,
    /// What each half-resolution pixel shows.
    pub(super) surfaces: Vec<Surface>,
    scale: WorkingScale,
    full_contrast: f32,
    noise: f32,
    /// Absolute contrast of sampled pixels of plain carpet.
    samples: Vec<f32>,
}

/// Share of a normal distribution that lies within one standard deviation.
const WITHIN_SIGMA: f64 = 0.683;
/// Step in coarse cells, each way, at which the noise of the carpet is sampled.
const NOISE_STEP: usize = 2;
/// Number of samples below which no noise is measured.
const MIN_SAMPLES: usize = 20;
/// Half the length of the section across which a sample's contrast is measured, in working pixels.
const REACH: usize = 5;

impl LineImage {
    /// Takes over the working image and measures its noise; `surfaces` must be filled already.
    ///
    /// `on_carpet` has one entry per cell of [`super::contrast::coarse_centres`].
    pub(super) fn fill(&mut self, working: &Picture, scale: WorkingScale, full_contrast: f32, on_carpet: &[bool]) {
        (self.width, self.height) = (working.width, working.height);
        self.luma.clone_from(&working.luma);
        (self.scale, self.full_contrast) = (scale, full_contrast);
        self.measure_noise(on_carpet);
    }

    /// Line contrast of a line of the best width, as a share of the carpet's brightness; infinite if too little was seen to estimate it.
    pub fn full_contrast(&self) -> f32 {
        self.full_contrast
    }

    /// Standard deviation of the contrast that plain carpet shows to a filter for lines three pixels wide, as a share of its brightness.
    ///
    /// It comes from blades of grass, glints, the sensor's noise and JPEG.
    pub fn noise(&self) -> f32 {
        self.noise
    }

    /// Measures the noise as a quantile of absolute contrast.
    ///
    /// Lines are a small part of the carpet, and a quantile does not depend on how far they stand out.
    fn measure_noise(&mut self, on_carpet: &[bool]) {
        let (columns, rows) = coarse_size(self.width, self.height);
        self.samples.clear();
        // Room for two samples of each cell, the largest possible number, so that no later frame allocates.
        self.samples.reserve(2 * columns.div_ceil(NOISE_STEP) * rows.div_ceil(NOISE_STEP));
        for row in (1..rows.saturating_sub(1)).step_by(NOISE_STEP) {
            for column in (1..columns.saturating_sub(1)).step_by(NOISE_STEP) {
                let (u, v) = (2 * coarse_middle(column) + 1, 2 * coarse_middle(row) + 1);
                let shows = self.surfaces.get(v / 2 * (self.width / 2) + u / 2);
                if on_carpet.get(row * columns + column) == Some(&true) && shows == Some(&Surface::Carpet) {
                    let at = v * self.width + u;
                    let across = [1, self.width].map(|step| self.local_contrast(at, step));
                    self.samples.extend(across);
                }
            }
        }
        self.noise = if self.samples.len() < MIN_SAMPLES {
            0.0
        } else {
            let index = ((self.samples.len() - 1) as f64 * WITHIN_SIGMA) as usize;
            *self.samples.select_nth_unstable_by(index, f32::total_cmp).1
        };
    }

    /// Absolute contrast of a pixel's band of three against its flanks, along a row (`step` 1) or a column (`step` the width).
    ///
    /// At least [`REACH`] pixels must lie on each side.
    fn local_contrast(&self, at: usize, step: usize) -> f32 {
        let value = |off: isize| f32::from(self.luma[at.wrapping_add_signed(off * step as isize)]);
        let band = (value(-1) + value(0) + value(1)) * (1.0 / 3.0);
        let reach = REACH as isize;
        let flank = (value(-reach) + value(1 - reach) + value(reach - 1) + value(reach)) * 0.25;
        (band - flank).abs() / (flank + STRAY_LEVELS)
    }

    /// The transformation from full-size image coordinates to those of this image.
    pub fn scale(&self) -> WorkingScale {
        self.scale
    }

    /// Samples the luma bilinearly along a straight line, in this image's coordinates.
    ///
    /// `values[k]` becomes the luma at `middle + (k - values.len() / 2) * step`. Returns false, and leaves `values` as they are, if a
    /// part of the line lies outside the image.
    pub fn profile(&self, middle: [f32; 2], step: [f32; 2], values: &mut [f32]) -> bool {
        let half = (values.len() / 2) as f32;
        let ends = [-half, values.len() as f32 - 1.0 - half];
        let place = |steps: f32| [middle[0] + steps * step[0], middle[1] + steps * step[1]];
        if !ends.iter().all(|end| self.contains(place(*end))) {
            return false;
        }
        for (chunk, values) in values.chunks_mut(BATCH).enumerate() {
            let first = (chunk * BATCH) as f32 - half;
            let Positions { at, shares } = Positions::along(middle, step, first, self.width as u32);
            let (mut upper, mut lower) = ([[0u8; 2]; BATCH], [[0u8; 2]; BATCH]);
            for (k, at) in at.iter().enumerate().take(values.len()) {
                let at = *at as usize;
                upper[k].copy_from_slice(&self.luma[at..at + 2]);
                lower[k].copy_from_slice(&self.luma[at + self.width..at + self.width + 2]);
            }
            let blended = blend(&shares, &upper, &lower);
            values.copy_from_slice(&blended[..values.len()]);
        }
        true
    }

    /// Whether four pixels lie around a point, so that its luma can be interpolated; false for NaN.
    fn contains(&self, [u, v]: [f32; 2]) -> bool {
        u >= 0.0 && v >= 0.0 && u < (self.width - 1) as f32 && v < (self.height - 1) as f32
    }

    /// Whether something hides the ground at a working pixel (a robot, a person, the robot's own body), or the pixel lies outside.
    pub fn hides(&self, u: f32, v: f32) -> bool {
        if !(u >= 0.0 && v >= 0.0) {
            return true;
        }
        let (column, row) = (u as usize / 2, v as usize / 2);
        let width = self.width / 2;
        column >= width || self.surfaces.get(row * width + column).is_none_or(|surface| *surface == Surface::Other)
    }
}

/// The positions of samples on a straight line.
struct Positions {
    /// Index of the upper left of the four pixels around each sample.
    at: [u32; BATCH],
    /// Fractions by which each sample lies to the right of that pixel and below it.
    shares: [[f32; BATCH]; 2],
}

impl Positions {
    /// Computes the positions; every sample must lie within the image.
    fn along(middle: [f32; 2], step: [f32; 2], first: f32, width: u32) -> Self {
        multiversioned!(|middle: [f32; 2], step: [f32; 2], first: f32, width: u32| -> Positions {
            let mut places = Positions { at: [0; BATCH], shares: [[0.0; BATCH]; 2] };
            for k in 0..BATCH {
                let steps = first + k as i32 as f32;
                let (u, v) = (middle[0] + steps * step[0], middle[1] + steps * step[1]);
                // Rounded down, or at an integer possibly to the one before: its neighbour then has all of the weight.
                let (column, row) = (rounded((u - 0.5).max(0.0)), rounded((v - 0.5).max(0.0)));
                places.at[k] = row * width + column;
                places.shares[0][k] = u - column as i32 as f32;
                places.shares[1][k] = v - row as i32 as f32;
            }
            places
        })
    }
}

/// Interpolates bilinearly between the upper and lower pairs of pixels.
fn blend(shares: &[[f32; BATCH]; 2], upper: &[[u8; 2]; BATCH], lower: &[[u8; 2]; BATCH]) -> [f32; BATCH] {
    type Pairs = [[u8; 2]; BATCH];
    multiversioned!(|shares: &[[f32; BATCH]; 2], upper: &Pairs, lower: &Pairs| -> [f32; BATCH] {
        let mut blended = [0.0; BATCH];
        for k in 0..BATCH {
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
            // Integer coordinates are tested too, because rounding may get them wrong.
            let [u, v] = if count % 3 == 0 { [u.round(), v.round()] } else { [u, v] };
            let places: Vec<[f32; 2]> = (0..count)
                .map(|k| k as f32 - (count / 2) as f32)
                .map(|steps| [u + steps * du, v + steps * dv])
                .collect();
            let inside = image.profile([u, v], [du, dv], &mut values);
            prop_assert_eq!(inside, places.iter().all(|place| image.contains(*place)));
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
