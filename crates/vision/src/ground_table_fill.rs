//! Filling the ground table: what the image shows at each cell, and how much that says about a painted line.

use super::bilinear::{self, SampledImage};
use super::carpet::Surface;
use super::contrast::{self, PARTS, UNITS};
use super::ground::{NEUTRAL, SIDE};
use super::ground_map::{BLOCK, BLOCKS, GroundMap};
use super::{WorkingScale, distance};
use realitysim_geometry::multiversion::rounded;
use realitysim_geometry::multiversioned;

/// The full contrast is learnt from cells whose line strength is at least this share of the best one in view.
const MIN_STRENGTH_SHARE: f32 = 0.5;
/// Number of cells below which no full contrast is learnt.
const MIN_CELLS: usize = 50;
/// Number of sampled cells below which every cell is used.
const ENOUGH_CELLS: usize = 500;
/// Step in cells at which the full contrast is sampled first.
const LEARN_STEP: usize = 23;
/// Line contrast of the faintest lines.
const MIN_CONTRAST: f32 = 0.06;
/// Noise of the smoothest carpet, in line contrast.
const MIN_NOISE: f32 = 0.006;
/// Smallest ratio of full contrast to noise.
const MIN_CONTRAST_TO_NOISE: f32 = 5.0;
/// Side of the square in which white cells are counted to find blobs, metres.
const BLOB_M: f64 = 0.25;
/// Share of white cells in that square above which it is a blob. A crossing of lines fills under half of it.
const BLOB_SHARE: f32 = 0.55;

/// What the image shows at each cell of the ground table.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    /// Line contrast of each cell, row by row, as [`contrast::LineContrast`] holds it, surface bits included. A cell outside of the view
    /// or of the carpet shows an occluder.
    pub(super) shown: Vec<i16>,
    /// White cells of each block.
    blobs: Vec<u16>,
    sums: Vec<u16>,
    /// For the sampled cells the contrast of a line of the best width and the line strength.
    samples: Vec<(f32, f32)>,
}

/// Tables of line strength and weight by the squared distance from the point below the camera.
#[derive(Clone, Debug, Default)]
pub(super) struct RangeTables {
    /// Line contrast of a painted line at each distance, as a share of that of a line of the best width.
    strengths: Vec<f32>,
    /// How much a cell at each distance counts, 0 to 1.
    weights: Vec<f32>,
    /// Number of entries for each square metre.
    per_square_metre: f64,
}

/// Content of a cell that is not seen.
const UNSEEN: i16 = Surface::Other as i16;
/// Number of steps of the tables by distance.
const STEPS: usize = 512;

impl Cells {
    /// Reads a half-resolution image at each cell: values bilinearly, surface bits from the nearest pixel.
    pub(super) fn read(
        &mut self,
        image: &[i16],
        width: usize,
        height: usize,
        map: &GroundMap,
        to_working: WorkingScale,
    ) {
        self.shown.clear();
        self.shown.resize(SIDE * SIDE, UNSEEN);
        if width < 2 || height < 2 {
            return;
        }
        bilinear::read(&SampledImage { image, width, height }, map, to_working, &mut self.shown);
        for (row, [from, to]) in self.shown.chunks_exact_mut(SIDE).zip(&map.columns) {
            row[..*from].fill(UNSEEN);
            row[*to..].fill(UNSEEN);
        }
    }

    /// Marks white areas that are wider than lines (a ball, a robot, a sheet of paper) and their edges as unseen.
    pub(super) fn hide_blobs(&mut self, cell_m: f64) {
        let reach = (libm::round(BLOB_M / 2.0 / cell_m / BLOCK as f64) as usize).max(1);
        let side = (2 * reach + 1) * BLOCK;
        self.blobs.clear();
        self.blobs.resize(BLOCKS * BLOCKS, 0);
        let mut white = 0u32;
        for (row, cells) in self.shown.chunks_exact(SIDE).enumerate() {
            let counts = &mut self.blobs[row / BLOCK * BLOCKS..][..BLOCKS];
            for (count, cells) in counts.iter_mut().zip(cells.as_chunks::<BLOCK>().0) {
                let whites: u16 = cells.iter().map(|cell| u16::from(cell & 3 == Surface::White as i16)).sum();
                *count += whites;
                white += u32::from(whites);
            }
        }
        let most = BLOB_SHARE * (side * side) as f32;
        if (white as f32) <= most {
            return;
        }
        box_sums(&mut self.blobs, &mut self.sums, reach);
        for count in &mut self.blobs {
            *count = u16::from(f32::from(*count) > most);
        }
        box_sums(&mut self.blobs, &mut self.sums, reach + 1);
        for (block, _) in self.blobs.iter().enumerate().filter(|(_, near)| **near > 0) {
            let first = block / BLOCKS * BLOCK * SIDE + block % BLOCKS * BLOCK;
            for row in 0..BLOCK {
                self.shown[first + row * SIDE..][..BLOCK].fill(UNSEEN);
            }
        }
    }

    /// Estimates the full contrast, that of a line of the best width, from the frame itself.
    ///
    /// It is the 98th percentile of what is seen, but well above the noise of plain carpet. It is infinite if too little is seen.
    pub(super) fn full_contrast(&mut self, map: &GroundMap, range_tables: &RangeTables) -> f32 {
        let Self { shown, samples: values, .. } = self;
        for step in [LEARN_STEP, 1] {
            values.clear();
            values.extend((0..SIDE * SIDE).step_by(step).filter(|cell| is_seen(shown[*cell])).map(|cell| {
                let strength = range_tables.strength(map.square_range(cell / SIDE / BLOCK, cell % SIDE / BLOCK));
                (contrast(shown[cell]) / strength, strength)
            }));
            let clearest = values.iter().map(|(_, strength)| *strength).fold(0.0, f32::max);
            values.retain(|(_, strength)| *strength > MIN_STRENGTH_SHARE * clearest);
            // A view of about a square metre needs every cell.
            if values.len() >= ENOUGH_CELLS {
                break;
            }
        }
        if values.len() < MIN_CELLS {
            return f32::INFINITY;
        }
        let mut nth = |share: f64| {
            let index = ((values.len() - 1) as f64 * share) as usize;
            values.select_nth_unstable_by(index, |a, b| a.0.total_cmp(&b.0)).1.0
        };
        let (low, middle, high) = (nth(0.16), nth(0.5), nth(0.98));
        let noise = (middle - low).max(MIN_NOISE);
        high.max(MIN_CONTRAST_TO_NOISE * noise).max(MIN_CONTRAST)
    }

    /// Turns line contrast into levels.
    ///
    /// A cell with less than a quarter of the full contrast speaks against a line, one with more for a line; an unseen cell is
    /// neutral. `seen` receives how much each cell counts, `spans` the columns of each row of blocks outside of which nothing is seen.
    pub(super) fn levels(
        &self,
        full: f32,
        map: &GroundMap,
        range_tables: &RangeTables,
        levels: &mut Vec<u8>,
        (seen, spans): (&mut Vec<u8>, &mut Vec<[u16; 2]>),
    ) {
        levels.clear();
        levels.resize(SIDE * SIDE, NEUTRAL);
        seen.clear();
        seen.resize(SIDE * SIDE, 0);
        spans.clear();
        let (mut gains, mut weights) = ([0.0f32; SIDE], [0.0f32; SIDE]);
        for block_row in 0..BLOCKS {
            let rows = block_row * BLOCK..(block_row + 1) * BLOCK;
            let blocks = map.blocks(rows.clone());
            let used = blocks.start * BLOCK..blocks.end * BLOCK;
            let (gains, weights) = (&mut gains[used.clone()], &mut weights[used.clone()]);
            let of_blocks = gains.as_chunks_mut::<BLOCK>().0.iter_mut().zip(weights.as_chunks_mut::<BLOCK>().0);
            for ((gains, weights), block_column) in of_blocks.zip(blocks) {
                let square = map.square_range(block_row, block_column);
                gains.fill(255.0 / (full * range_tables.strength(square) * PARTS));
                weights.fill(range_tables.weight(square));
            }
            let mut any = [0u8; SIDE];
            let any = &mut any[..used.len()];
            for row in rows {
                let cells = row * SIDE + used.start..row * SIDE + used.end;
                let (shown, levels, seen) =
                    (&self.shown[cells.clone()], &mut levels[cells.clone()], &mut seen[cells.clone()]);
                let strengths = (&gains[..shown.len()], &weights[..shown.len()]);
                multiversioned!(|shown: &[i16],
                                 strengths: (&[f32], &[f32]),
                                 levels: &mut [u8],
                                 seen: &mut [u8],
                                 any: &mut [u8]| {
                    let targets = levels.iter_mut().zip(seen).zip(any);
                    let sources = shown.iter().zip(strengths.0).zip(strengths.1);
                    for (((level, seen), any), ((shown, gain), weight)) in targets.zip(sources) {
                        let visible = if shown & 2 == 0 { u32::MAX } else { 0 };
                        let shown = (f32::from(shown & !3) * gain).clamp(0.0, 255.0);
                        let drawn = rounded(f32::from(NEUTRAL) + (shown - f32::from(NEUTRAL)) * weight);
                        *level = (drawn & visible | u32::from(NEUTRAL) & !visible) as u8;
                        *seen = (rounded(weight * 255.0) & visible) as u8;
                        *any |= *seen;
                    }
                });
            }
            let first = any.iter().position(|seen| *seen > 0);
            let last = any.iter().rposition(|seen| *seen > 0);
            let column = |index: usize| (used.start + index) as u16;
            spans.push(first.zip(last).map_or([0, 0], |(first, last)| [column(first), column(last) + 1]));
        }
    }

    /// Turns the distance to the nearest cell with at least half a line's contrast into levels.
    ///
    /// At a distance of `reach_m` and more a cell speaks against a line.
    pub(super) fn nearest_levels(
        &self,
        full: f32,
        map: &GroundMap,
        range_tables: &RangeTables,
        reach_m: f64,
    ) -> Vec<u8> {
        let reach = (libm::ceil(reach_m / map.cell_m()) as usize).clamp(1, 60);
        let square = |cell: usize| map.square_range(cell / SIDE / BLOCK, cell % SIDE / BLOCK);
        let seen = |cell: usize| is_seen(self.shown[cell]);
        let is_line =
            |cell: usize| seen(cell) && contrast(self.shown[cell]) >= 0.5 * full * range_tables.strength(square(cell));
        let white: Vec<bool> = (0..SIDE * SIDE).map(is_line).collect();
        let nearest = distance::nearest(&white, SIDE, SIDE, reach);
        let neutral = f32::from(NEUTRAL);
        let level = |cell: usize| {
            let share = 1.0 - (nearest[cell] / reach as f32).min(1.0);
            (neutral + (share * 255.0 - neutral) * range_tables.weight(square(cell)) + 0.5) as u8
        };
        (0..SIDE * SIDE).map(|cell| if seen(cell) { level(cell) } else { NEUTRAL }).collect()
    }

    /// Turns blurred gray or distances in the image into levels, in whole gray levels or pixels; cells that `seen` does not show are 0.
    pub(super) fn plain_levels(&self, seen: &Cells) -> Vec<u8> {
        let level = |cell: usize| (f32::from(self.shown[cell]) / UNITS + 0.5) as u8;
        (0..SIDE * SIDE).map(|cell| if is_seen(seen.shown[cell]) { level(cell) } else { 0 }).collect()
    }
}

/// Whether a cell shows carpet or a line.
#[inline(always)]
fn is_seen(shown: i16) -> bool {
    !contrast::surface(shown).is_occluder()
}

/// The line contrast of a cell, as a share of the carpet's brightness.
#[inline(always)]
fn contrast(shown: i16) -> f32 {
    f32::from(shown & !3) * (1.0 / PARTS)
}

/// Replaces each block's number by the sum over the square of 2 `reach` + 1 blocks around it.
fn box_sums(blocks: &mut [u16], scratch: &mut Vec<u16>, reach: usize) {
    scratch.clear();
    scratch.resize(blocks.len(), 0);
    for (source, target) in blocks.as_chunks::<BLOCKS>().0.iter().zip(scratch.as_chunks_mut::<BLOCKS>().0) {
        let mut sum: u16 = source[..reach].iter().sum();
        for (column, target) in target.iter_mut().enumerate() {
            sum += source.get(column + reach).unwrap_or(&0);
            *target = sum;
            sum -= column.checked_sub(reach).map_or(0, |column| source[column]);
        }
    }
    let rows = scratch.as_chunks::<BLOCKS>().0;
    let mut sums = [0u16; BLOCKS];
    let add =
        |sums: &mut [u16; BLOCKS], row: &[u16; BLOCKS]| sums.iter_mut().zip(row).for_each(|(sum, add)| *sum += add);
    rows[..reach].iter().for_each(|row| add(&mut sums, row));
    for (row, target) in blocks.as_chunks_mut::<BLOCKS>().0.iter_mut().enumerate() {
        if let Some(next) = rows.get(row + reach) {
            add(&mut sums, next);
        }
        *target = sums;
        if let Some(row) = row.checked_sub(reach) {
            sums.iter_mut().zip(&rows[row]).for_each(|(sum, less)| *sum -= less);
        }
    }
}

impl RangeTables {
    /// Fills both tables.
    ///
    /// The strength follows from the width at which a line is drawn: a far line is thinner than a pixel, a near one wider than the
    /// wide blur. The geometric mean of lines across and along the view is taken. The weight is the strength, less where the
    /// expected tilt error moves a point by more than a line's width: by (h^2 + r^2) / h x sigma, for height h and distance r.
    pub(super) fn fill(&mut self, map: &GroundMap, line_width_m: f64, pixels_per_radian: f64, tilt_sigma_rad: f64) {
        let height = map.height_m.max(0.01);
        let farthest = 2.0 * (2.0 * map.range_m) * (2.0 * map.range_m);
        self.per_square_metre = STEPS as f64 / farthest;
        self.strengths.clear();
        self.weights.clear();
        for step in 0..=STEPS {
            let square = height * height + farthest * step as f64 / STEPS as f64;
            let slant = libm::sqrt(square);
            let width_px = pixels_per_radian * line_width_m * libm::sqrt(height / (slant * slant * slant));
            let strength = contrast::line_response(width_px);
            let shift = square / height * tilt_sigma_rad / line_width_m;
            self.strengths.push(strength as f32);
            self.weights.push((strength / libm::sqrt(1.0 + shift * shift)) as f32);
        }
    }

    /// Strength of a line at a squared distance in square metres.
    #[inline(always)]
    fn strength(&self, square_range: f64) -> f32 {
        self.strengths[((square_range * self.per_square_metre) as usize).min(STEPS)]
    }

    /// Weight of a cell at a squared distance in square metres.
    #[inline(always)]
    fn weight(&self, square_range: f64) -> f32 {
        self.weights[((square_range * self.per_square_metre) as usize).min(STEPS)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn box_sums_agree_with_adding() {
        let values: Vec<u16> = (0..BLOCKS * BLOCKS).map(|i| ((i * 2_654_435_761) % 97 / 9) as u16).collect();
        for reach in [1, 2, 4] {
            let mut sums = values.clone();
            box_sums(&mut sums, &mut Vec::new(), reach);
            let last = BLOCKS - 1;
            for (row, column) in [(0, 0), (3, last), (50, 17), (last, 2), (last, last)] {
                let within = |centre: usize| centre.saturating_sub(reach)..(centre + reach + 1).min(BLOCKS);
                let sum: u16 =
                    within(row).flat_map(|v| within(column).map(move |u| v * BLOCKS + u)).map(|i| values[i]).sum();
                assert_eq!(sums[row * BLOCKS + column], sum);
            }
        }
    }
}
