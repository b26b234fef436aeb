//! What the image shows at each cell of the ground table, and how much that says about a painted line.

use super::carpet::Surface;
use super::contrast::LineContrast;
use super::ground::{NEUTRAL, SIDE};
use super::ground_map::GroundMap;
use super::{WorkingScale, contrast, distance};

/// Painted lines are this wide on every field that is played on.
const LINE_WIDTH_M: f64 = 0.05;
/// The frame's full contrast is learnt where lines show at least this well, against the best place in view, ...
const CLEAR: f32 = 0.5;
/// ... on at least this many cells.
const FEWEST_CELLS: usize = 50;
/// A square of this side is never mostly white where lines are: a crossing fills under half of it.
const BLOB_M: f64 = 0.25;
const BLOB_SHARE: f32 = 0.55;
/// Darker places show nothing: the black surround of a fisheye's circle.
const BLACK: f32 = 8.0;

/// What the image shows at each cell.
pub(super) struct Cells {
    pub(super) seen: Vec<bool>,
    /// Coloured as lines are.
    pub(super) white: Vec<bool>,
    pub(super) contrast: Vec<f32>,
    pub(super) gray: Vec<f32>,
}

/// Contrast made comparable between frames and ranges.
pub(super) struct LinesSeen<'a> {
    pub(super) cells: &'a Cells,
    pub(super) strengths: &'a [f32],
    /// Gray levels that a line of the best width has in this frame.
    pub(super) full_contrast: f32,
}

impl Cells {
    pub(super) fn read(image: &LineContrast, map: &GroundMap, to_working: WorkingScale) -> Self {
        let count = SIDE * SIDE;
        let (mut seen, mut white) = (vec![false; count], vec![false; count]);
        let (mut contrast, mut gray) = (vec![0.0; count], vec![0.0; count]);
        if image.width >= 2 && image.height >= 2 {
            // Half-resolution coordinates: pixel i covers working pixels 2i and 2i + 1.
            let scale = (to_working.factor * 0.5) as f32;
            let offset = (to_working.offset * 0.5 - 0.25) as f32;
            let (last_u, last_v) = ((image.width - 1) as f32, (image.height - 1) as f32);
            for cell in 0..count {
                let [u, v] = map.pixels[cell].map(|x| x * scale + offset);
                // NaN fails both.
                if !(u >= 0.0 && u <= last_u && v >= 0.0 && v <= last_v) {
                    continue;
                }
                let (iu, iv) = ((u as usize).min(image.width - 2), (v as usize).min(image.height - 2));
                let (fu, fv) = (u - iu as f32, v - iv as f32);
                let at = iv * image.width + iu;
                let blend = |values: &[f32]| {
                    let upper = values[at] + (values[at + 1] - values[at]) * fu;
                    let lower =
                        values[at + image.width] + (values[at + image.width + 1] - values[at + image.width]) * fu;
                    upper + (lower - upper) * fv
                };
                gray[cell] = blend(&image.narrow);
                contrast[cell] = blend(&image.contrast);
                // Half-way to an occluder counts as hidden.
                let nearest = at + usize::from(fu >= 0.5) + if fv >= 0.5 { image.width } else { 0 };
                seen[cell] = gray[cell] >= BLACK && !image.surfaces[nearest].is_occluder();
                white[cell] = image.surfaces[nearest] == Surface::White;
            }
        }
        Self { seen, white, contrast, gray }
    }

    /// White areas wider than lines are (a ball, a robot, a sheet of paper) show no line, nor do their edges.
    pub(super) fn hide_blobs(&mut self, cell_m: f64) {
        let reach = (libm::round(BLOB_M / 2.0 / cell_m) as usize).max(1);
        let area = ((2 * reach + 1) * (2 * reach + 1)) as f32;
        let near = box_counts(&self.white, reach);
        let blob: Vec<bool> = near.iter().map(|count| *count as f32 > BLOB_SHARE * area).collect();
        if blob.contains(&true) {
            let around = box_counts(&blob, reach + 1);
            for (seen, near) in self.seen.iter_mut().zip(&around) {
                *seen &= *near == 0;
            }
        }
    }

    pub(super) fn gray_levels(&self) -> Vec<u8> {
        self.gray.iter().zip(&self.seen).map(|(gray, seen)| if *seen { (gray + 0.5) as u8 } else { 0 }).collect()
    }

    /// Distances in image pixels, as printed: measured in the image, then read at each cell.
    pub(super) fn nearest_pixel_levels(
        &self,
        image: &LineContrast,
        map: &GroundMap,
        to_working: WorkingScale,
        full_contrast: f32,
    ) -> Vec<u8> {
        const REACH: usize = 127;
        let half = 0.5 * full_contrast;
        let white: Vec<bool> = image.contrast.iter().map(|value| *value >= half).collect();
        let nearest = distance::nearest(&white, image.width, image.height, REACH);
        let (scale, offset) = (to_working.factor * 0.5, to_working.offset * 0.5 - 0.25);
        map.pixels
            .iter()
            .zip(&self.seen)
            .map(|(pixel, seen)| {
                if !seen {
                    return 0;
                }
                let [u, v] = pixel.map(|x| libm::round(f64::from(x) * scale + offset) as usize);
                let at = v.min(image.height - 1) * image.width + u.min(image.width - 1);
                (2.0 * nearest[at]).min(255.0) as u8
            })
            .collect()
    }
}

impl LinesSeen<'_> {
    /// 0 plain carpet .. 1 as bright as a line is here.
    pub(super) fn share(&self, cell: usize) -> f32 {
        (self.cells.contrast[cell] / (self.full_contrast * self.strengths[cell])).clamp(0.0, 1.0)
    }

    /// Shares as levels: below a quarter a place speaks against a line, above it for one; what is unseen says nothing.
    pub(super) fn levels(&self, weights: &[f32], share: impl Fn(usize) -> f32) -> Vec<u8> {
        let neutral = f32::from(NEUTRAL);
        (0..SIDE * SIDE)
            .map(|cell| {
                if !self.cells.seen[cell] {
                    return NEUTRAL;
                }
                let level = share(cell) * 255.0;
                (neutral + (level - neutral) * weights[cell] + 0.5) as u8
            })
            .collect()
    }

    pub(super) fn nearest_levels(&self, weights: &[f32], cell_m: f64, reach_m: f64) -> Vec<u8> {
        let reach = (libm::ceil(reach_m / cell_m) as usize).clamp(1, 60);
        let white: Vec<bool> = (0..SIDE * SIDE).map(|cell| self.cells.seen[cell] && self.share(cell) >= 0.5).collect();
        let nearest = distance::nearest(&white, SIDE, SIDE, reach);
        let per_cell = 1.0 / reach as f32;
        self.levels(weights, |cell| 1.0 - (nearest[cell] * per_cell).min(1.0))
    }
}

/// A place that the expected tilt error moves by more than a line's width says little: its weight falls with the
/// shift (h^2 + r^2) / h x sigma, against 5 cm.
pub(super) fn range_weights(map: &GroundMap, tilt_sigma_rad: f64) -> Vec<f32> {
    let height = map.height_m.max(0.01);
    let per_square_metre = tilt_sigma_rad / height / LINE_WIDTH_M;
    let floor = height * height * per_square_metre;
    let squares = |centre: f64| -> Vec<f64> {
        (0..SIDE).map(|index| map.place(index) - centre).map(|d| d * d * per_square_metre).collect()
    };
    let (xs, ys) = (squares(map.foot.x), squares(map.foot.y));
    let mut weights = Vec::with_capacity(SIDE * SIDE);
    for y in &ys {
        weights.extend(xs.iter().map(|x| {
            let shift = (floor + x + y) as f32;
            1.0 / (1.0 + shift * shift).sqrt()
        }));
    }
    weights
}

/// How strongly a painted line shows at each cell, against one of the best width: a far line is thinner than a pixel, a
/// near one wider than the wide blur. Of lines across and along the view the geometric mean is taken.
pub(super) fn line_strengths(map: &GroundMap, pixels_per_radian: f64) -> Vec<f32> {
    const STEPS: usize = 512;
    let height = map.height_m.max(0.01);
    let farthest = 2.0 * (2.0 * map.range_m) * (2.0 * map.range_m);
    let by_square: Vec<f32> = (0..=STEPS)
        .map(|step| {
            let slant = libm::sqrt(farthest * step as f64 / STEPS as f64 + height * height);
            let width_px = pixels_per_radian * LINE_WIDTH_M * libm::sqrt(height / (slant * slant * slant));
            contrast::line_response(width_px) as f32
        })
        .collect();
    let per_square_metre = STEPS as f64 / farthest;
    let squares = |centre: f64| -> Vec<f32> {
        (0..SIDE).map(|index| map.place(index) - centre).map(|d| (d * d * per_square_metre) as f32).collect()
    };
    let (xs, ys) = (squares(map.foot.x), squares(map.foot.y));
    let mut strengths = Vec::with_capacity(SIDE * SIDE);
    for y in &ys {
        strengths.extend(xs.iter().map(|x| by_square[((x + y) as usize).min(STEPS)]));
    }
    strengths
}

/// Gray levels that a line of the best width has, from the frame itself: the brightest few per cent of
/// what is seen, but well above the noise of plain carpet.
pub(super) fn full_contrast(cells: &Cells, strengths: &[f32]) -> f32 {
    let looked_at = || (0..SIDE * SIDE).step_by(7).filter(|cell| cells.seen[*cell]);
    let clearest = looked_at().map(|cell| strengths[cell]).fold(0.0, f32::max);
    let mut values: Vec<f32> = looked_at()
        .filter(|cell| strengths[*cell] > CLEAR * clearest)
        .map(|cell| cells.contrast[cell] / strengths[cell])
        .collect();
    if values.len() < FEWEST_CELLS {
        return f32::INFINITY;
    }
    let mut nth = |share: f64| {
        let index = ((values.len() - 1) as f64 * share) as usize;
        *values.select_nth_unstable_by(index, f32::total_cmp).1
    };
    let (low, middle, high) = (nth(0.16), nth(0.5), nth(0.98));
    let noise = (middle - low).max(0.5);
    high.max(5.0 * noise).max(5.0)
}

/// How many cells are set in the square of 2 `reach` + 1 cells around each.
fn box_counts(set: &[bool], reach: usize) -> Vec<u16> {
    let mut rows = vec![0u16; SIDE * SIDE];
    for (counts, set) in rows.chunks_exact_mut(SIDE).zip(set.chunks_exact(SIDE)) {
        let mut sum: u16 = set[..reach].iter().map(|s| u16::from(*s)).sum();
        for (column, count) in counts.iter_mut().enumerate() {
            sum += u16::from(set.get(column + reach).copied().unwrap_or(false));
            *count = sum;
            sum -= column.checked_sub(reach).map_or(0, |left| u16::from(set[left]));
        }
    }
    let mut counts = vec![0u16; SIDE * SIDE];
    let mut sums = vec![0u16; SIDE];
    let add =
        |sums: &mut [u16], row: usize| sums.iter_mut().zip(&rows[row * SIDE..][..SIDE]).for_each(|(s, c)| *s += c);
    (0..reach).for_each(|row| add(&mut sums, row));
    for row in 0..SIDE {
        if row + reach < SIDE {
            add(&mut sums, row + reach);
        }
        counts[row * SIDE..][..SIDE].copy_from_slice(&sums);
        if let Some(top) = row.checked_sub(reach) {
            sums.iter_mut().zip(&rows[top * SIDE..][..SIDE]).for_each(|(s, c)| *s -= c);
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_counts_agree_with_counting() {
        let set: Vec<bool> = (0..SIDE * SIDE).map(|i| (i * 2_654_435_761) % 97 < 9).collect();
        for reach in [1, 4, 7] {
            let counts = box_counts(&set, reach);
            for (row, column) in [(0, 0), (3, 399), (200, 117), (399, 2), (399, 399)] {
                let within = |centre: usize| centre.saturating_sub(reach)..(centre + reach + 1).min(SIDE);
                let count =
                    within(row).flat_map(|v| within(column).map(move |u| v * SIDE + u)).filter(|i| set[*i]).count();
                assert_eq!(usize::from(counts[row * SIDE + column]), count);
            }
        }
    }
}
