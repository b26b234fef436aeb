//! The ground table: a robot-centred square of the floor, each cell saying how much a line is seen there.
//!
//! For one frame the camera's height and tilt are the same for every particle, so lens and tilt are dealt with once,
//! here. A particle then costs a planar rigid motion and a lookup per line point.

use glam::{DVec2, DVec3};

use super::border::CarpetBorder;
use super::carpet::Surface;
use super::contrast::LineContrast;
use super::mask::BodyMask;
use super::{Reading, Seen, VisionSettings, WorkingScale, contrast, distance};
use crate::geometry::{Isometry, Lens};

/// Cells along each side of the table.
pub const SIDE: usize = 400;
/// The lens is asked at every fourth cell and interpolated between: facts on the error in docs/cost.md.
const NODE_STEP: usize = 4;
const NODES: usize = SIDE / NODE_STEP + 1;
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
/// Levels of a packed cell that say "nothing known": neither for nor against a line.
pub const NEUTRAL: u8 = 64;

/// Which pixel shows each cell: full-size image coordinates, NaN where the camera does not see.
#[derive(Clone, Debug)]
pub struct GroundMap {
    pixels: Vec<[f32; 2]>,
    range_m: f64,
    foot: DVec2,
    height_m: f64,
}

/// One number per cell, packed so that one 32-bit load holds the four neighbours that bilinear
/// interpolation needs.
#[derive(Clone, Debug)]
pub struct GroundTable {
    /// SIDE x SIDE cells, each with (this, next x, next y, next x and y) from the low byte up.
    quads: Vec<u32>,
    /// How far a cell counts as seen, 0 to 255, same layout without packing.
    seen: Vec<u8>,
    cell_m: f64,
    readings: Readings,
}

/// How the packed levels are to be read back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readings {
    /// Value of one level.
    pub scale: f64,
    /// The level that stands for 0.
    pub zero: u8,
}

impl GroundMap {
    pub fn new(lens: &Lens, footprint_from_optical: &Isometry, range_m: f64) -> Self {
        let optical_from_footprint = footprint_from_optical.inverse();
        let cell = 2.0 * range_m / SIDE as f64;
        let pixel_of = |x: f64, y: f64| -> Option<[f32; 2]> {
            let ray = optical_from_footprint.transform_point(DVec3::new(x, y, 0.0));
            let pixel = lens.project(ray)?;
            lens.contains(pixel).then_some([pixel.x as f32, pixel.y as f32])
        };
        let place = |index: usize| (index as f64 + 0.5) * cell - range_m;
        let looks_down = footprint_from_optical.translation.z > 0.0;
        let nodes: Vec<Option<[f32; 2]>> = (0..NODES * NODES)
            .map(|node| {
                let (row, column) = (node / NODES, node % NODES);
                if looks_down { pixel_of(place(column * NODE_STEP), place(row * NODE_STEP)) } else { None }
            })
            .collect();
        let mut pixels = vec![[f32::NAN; 2]; SIDE * SIDE];
        for block_row in 0..NODES - 1 {
            for block_column in 0..NODES - 1 {
                let node = block_row * NODES + block_column;
                let corners = [nodes[node], nodes[node + 1], nodes[node + NODES], nodes[node + NODES + 1]];
                let first = block_row * NODE_STEP * SIDE + block_column * NODE_STEP;
                match corners {
                    [None, None, None, None] => {}
                    [Some(a), Some(b), Some(c), Some(d)] => {
                        for dv in 0..NODE_STEP {
                            let fv = dv as f32 / NODE_STEP as f32;
                            for du in 0..NODE_STEP {
                                let fu = du as f32 / NODE_STEP as f32;
                                pixels[first + dv * SIDE + du] = [0, 1].map(|i| {
                                    let upper = a[i] + (b[i] - a[i]) * fu;
                                    let lower = c[i] + (d[i] - c[i]) * fu;
                                    upper + (lower - upper) * fv
                                });
                            }
                        }
                    }
                    // The image's edge runs through this block.
                    _ => {
                        for dv in 0..NODE_STEP {
                            for du in 0..NODE_STEP {
                                let (x, y) = (block_column * NODE_STEP + du, block_row * NODE_STEP + dv);
                                if let Some(pixel) = pixel_of(place(x), place(y)) {
                                    pixels[first + dv * SIDE + du] = pixel;
                                }
                            }
                        }
                    }
                }
            }
        }
        let foot = footprint_from_optical.translation.truncate();
        Self { pixels, range_m, foot, height_m: footprint_from_optical.translation.z }
    }

    fn cell_m(&self) -> f64 {
        2.0 * self.range_m / SIDE as f64
    }

    /// Metres from the robot of a row's or column's centre.
    fn place(&self, index: usize) -> f64 {
        (index as f64 + 0.5) * self.cell_m() - self.range_m
    }

    /// Sets what lies beyond the carpet or behind the robot's body to unseen.
    pub fn hide(&mut self, border: Option<&CarpetBorder>, body: Option<&BodyMask>) {
        const UNSEEN: [f32; 2] = [f32::NAN; 2];
        let places: Vec<f64> = (0..SIDE).map(|index| self.place(index)).collect();
        for (row, pixels) in self.pixels.chunks_exact_mut(SIDE).enumerate() {
            if let Some(border) = border {
                let (low, high) = border.row(places[row]).unwrap_or((f64::INFINITY, f64::NEG_INFINITY));
                for (pixel, x) in pixels.iter_mut().zip(&places) {
                    if !(low..=high).contains(x) {
                        *pixel = UNSEEN;
                    }
                }
            }
            if let Some(body) = body {
                for pixel in pixels.iter_mut() {
                    if body.hides(DVec2::new(f64::from(pixel[0]), f64::from(pixel[1]))) {
                        *pixel = UNSEEN;
                    }
                }
            }
        }
    }
}

/// Fills the table that the observation model wants, and the one of line contrast.
pub fn tables(
    image: &LineContrast,
    map: &GroundMap,
    to_working: WorkingScale,
    pixels_per_radian: f64,
    settings: &VisionSettings,
) -> Seen {
    let mut cells = Cells::read(image, map, to_working);
    let strengths = line_strengths(map, pixels_per_radian * to_working.factor);
    let weights = range_weights(map, settings.tilt_sigma_rad);
    let weights: Vec<f32> = weights.iter().zip(&strengths).map(|(weight, strength)| weight * strength).collect();
    cells.hide_blobs(map.cell_m());
    let full_contrast = full_contrast(&cells, &strengths);
    let lines_seen = LinesSeen { cells: &cells, strengths: &strengths, full_contrast };
    let seen: Vec<u8> =
        cells.seen.iter().zip(&weights).map(|(seen, weight)| if *seen { (weight * 255.0) as u8 } else { 0 }).collect();
    let table = |reading: Reading| {
        let (levels, readings) = match reading {
            Reading::Contrast => (lines_seen.levels(&weights, |cell| lines_seen.share(cell)), SHARES),
            Reading::Nearest => (lines_seen.nearest_levels(&weights, map.cell_m(), settings.nearest_reach_m), SHARES),
            Reading::Gray => (cells.gray_levels(), PLAIN),
            Reading::NearestPixel => {
                (cells.nearest_pixel_levels(image, map, to_working, lines_seen.full_contrast), PLAIN)
            }
        };
        GroundTable { quads: packed(&levels, readings.zero), seen: seen.clone(), cell_m: map.cell_m(), readings }
    };
    let lines = (settings.reading != Reading::Contrast).then(|| table(Reading::Contrast));
    Seen { table: table(settings.reading), lines }
}

/// A full line is +1; plain carpet, where a line should be, -1/3.
const SHARES: Readings = Readings { scale: 1.0 / (255 - NEUTRAL) as f64, zero: NEUTRAL };
const PLAIN: Readings = Readings { scale: 1.0, zero: 0 };

impl GroundTable {
    /// A table from SIDE x SIDE levels, `NEUTRAL` meaning nothing known; everything counts as seen.
    #[cfg(test)]
    pub(crate) fn from_levels(levels: &[u8], cell_m: f64) -> Self {
        Self { quads: packed(levels, NEUTRAL), seen: vec![255; SIDE * SIDE], cell_m, readings: SHARES }
    }

    pub fn quads(&self) -> &[u32] {
        &self.quads
    }

    pub fn readings(&self) -> Readings {
        self.readings
    }

    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Table coordinates (cells, the first cell's centre at 0) of a place on the ground of `base_footprint`.
    pub fn to_cells(&self) -> (f64, f64) {
        (1.0 / self.cell_m, SIDE as f64 / 2.0 - 0.5)
    }

    /// How far the place counts as seen: 0 (not at all) to 1.
    pub fn seen(&self, ground: DVec2) -> f64 {
        let (scale, offset) = self.to_cells();
        let (u, v) = (libm::round(ground.x * scale + offset), libm::round(ground.y * scale + offset));
        let inside = u >= 0.0 && v >= 0.0 && u < SIDE as f64 && v < SIDE as f64;
        if inside { f64::from(self.seen[v as usize * SIDE + u as usize]) / 255.0 } else { 0.0 }
    }

    /// The unpacked level of a cell, for pictures and tests.
    pub fn level(&self, column: usize, row: usize) -> u8 {
        (self.quads[row * SIDE + column] & 255) as u8
    }
}

/// Neighbours into one word. The rim, and with it everything outside, reads as `zero`.
fn packed(levels: &[u8], zero: u8) -> Vec<u32> {
    let level = |row: usize, column: usize| {
        let rim = row == 0 || column == 0 || row >= SIDE - 1 || column >= SIDE - 1;
        if rim { zero } else { levels[row * SIDE + column] }
    };
    let mut quads = Vec::with_capacity(SIDE * SIDE);
    let mut this: Vec<u8> = (0..=SIDE).map(|column| level(0, column)).collect();
    for row in 0..SIDE {
        let next: Vec<u8> = (0..=SIDE).map(|column| level(row + 1, column)).collect();
        quads.extend(this.windows(2).zip(next.windows(2)).map(|(a, b)| u32::from_le_bytes([a[0], a[1], b[0], b[1]])));
        this = next;
    }
    quads
}

/// A place that the expected tilt error moves by more than a line's width says little: its weight falls with the
/// shift (h^2 + r^2) / h x sigma, against 5 cm.
fn range_weights(map: &GroundMap, tilt_sigma_rad: f64) -> Vec<f32> {
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
fn line_strengths(map: &GroundMap, pixels_per_radian: f64) -> Vec<f32> {
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

/// Gray levels that a line of the best width has, from the frame itself: the brightest few per cent of what is seen, but well above the
/// noise of plain carpet.
fn full_contrast(cells: &Cells, strengths: &[f32]) -> f32 {
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

/// Contrast made comparable between frames and ranges.
struct LinesSeen<'a> {
    cells: &'a Cells,
    strengths: &'a [f32],
    /// Gray levels that a line of the best width has in this frame.
    full_contrast: f32,
}

impl LinesSeen<'_> {
    /// 0 plain carpet .. 1 as bright as a line is here.
    fn share(&self, cell: usize) -> f32 {
        (self.cells.contrast[cell] / (self.full_contrast * self.strengths[cell])).clamp(0.0, 1.0)
    }

    /// Shares as levels: below a quarter a place speaks against a line, above it for one; what is unseen says nothing.
    fn levels(&self, weights: &[f32], share: impl Fn(usize) -> f32) -> Vec<u8> {
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

    fn nearest_levels(&self, weights: &[f32], cell_m: f64, reach_m: f64) -> Vec<u8> {
        let reach = (libm::ceil(reach_m / cell_m) as usize).clamp(1, 60);
        let white: Vec<bool> = (0..SIDE * SIDE).map(|cell| self.cells.seen[cell] && self.share(cell) >= 0.5).collect();
        let nearest = distance::nearest(&white, SIDE, SIDE, reach);
        let per_cell = 1.0 / reach as f32;
        self.levels(weights, |cell| 1.0 - (nearest[cell] * per_cell).min(1.0))
    }
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

/// What the image shows at each cell.
struct Cells {
    seen: Vec<bool>,
    /// Coloured as lines are.
    white: Vec<bool>,
    contrast: Vec<f32>,
    gray: Vec<f32>,
}

impl Cells {
    fn read(image: &LineContrast, map: &GroundMap, to_working: WorkingScale) -> Self {
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
    fn hide_blobs(&mut self, cell_m: f64) {
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

    fn gray_levels(&self) -> Vec<u8> {
        self.gray.iter().zip(&self.seen).map(|(gray, seen)| if *seen { (gray + 0.5) as u8 } else { 0 }).collect()
    }

    /// Distances in image pixels, as printed: measured in the image, then read at each cell.
    fn nearest_pixel_levels(
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
