//! The ground table: a robot-centred square of the ground, whose cells say how clearly a line is seen there.
//!
//! For one frame the camera's height and tilt are the same for every particle, so the lens and the tilt are accounted for once,
//! here. A particle then costs a planar rigid motion and a lookup per line point.

use glam::DVec2;

use super::contrast::{LineContrast, PARTS, UNITS};
use super::ground_map::{BLOCK, BLOCKS, GroundMap};
use super::ground_table_fill::{Cells, RangeTables};
use super::{TableQuantity, VisionSettings, WorkingScale, distance};
use realitysim_geometry::multiversioned;

/// Number of cells along each side of the table.
pub const SIDE: usize = 320;

/// Largest distance on the ground at which the distance model looks for the nearest white cell, metres.
const NEAREST_REACH_M: f64 = 0.25;

/// Level of a cell about which nothing is known: it speaks neither for nor against a line.
pub const NEUTRAL: u8 = 64;

/// A square of `SIDE` x `SIDE` cells on the ground, centred on `base_footprint`, with a level from 0 to 255 in each.
///
/// Levels are packed so that one 32-bit load holds the four neighbours that bilinear interpolation needs.
#[derive(Clone, Debug, Default)]
pub struct GroundTable {
    /// For each cell, row by row, the levels of (this, next x, next y, next x and y), from the low byte up.
    quads: Vec<u32>,
    /// For each cell, row by row, how much it counts as seen, 0 to 255.
    seen: Vec<u8>,
    /// For each row of blocks the columns `[from, to)` outside of which every cell is neutral.
    spans: Vec<[u16; 2]>,
    /// Side of a cell, metres.
    cell_m: f64,
    readings: Readings,
}

/// How the levels of a ground table are turned back into values: value = (level - zero) x scale.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Readings {
    /// Value of a step of one level.
    pub scale: f64,
    /// Level that stands for the value 0.
    pub zero: u8,
}

/// Intermediate results of making ground tables, kept from frame to frame for their memory.
#[derive(Clone, Debug, Default)]
pub struct TableBuffers {
    map: GroundMap,
    cells: Cells,
    plain: Cells,
    range_tables: RangeTables,
    levels: Vec<u8>,
}

/// Scales of the image that do not change from frame to frame.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Transformation from the full-size image to the working image.
    pub to_working: WorkingScale,
    /// Focal length of the full-size image, pixels per radian.
    pub pixels_per_radian: f64,
    /// Width of the field's painted lines, metres.
    pub line_width_m: f64,
}

impl TableBuffers {
    /// The map from cells to pixels, which the caller fills before [`Self::tables`].
    pub fn map(&mut self) -> &mut GroundMap {
        &mut self.map
    }

    /// Fills `table` with the quantity of the settings, and `lines` with line contrast if that is another quantity.
    ///
    /// Returns the frame's full contrast: the line contrast of a line of the best width.
    pub fn tables(
        &mut self,
        image: &LineContrast,
        scale: Scale,
        settings: &VisionSettings,
        table: &mut GroundTable,
        lines: &mut Option<GroundTable>,
    ) -> f32 {
        let Self { map, cells, plain, range_tables, levels } = self;
        let Scale { to_working, pixels_per_radian, line_width_m } = scale;
        cells.read(&image.contrast, image.width, image.height, map, to_working);
        cells.hide_blobs(map.cell_m());
        range_tables.fill(map, line_width_m, pixels_per_radian * to_working.factor, settings.tilt_sigma_rad);
        let full = cells.full_contrast(map, range_tables);
        cells.levels(full, map, range_tables, levels, (&mut table.seen, &mut table.spans));
        if settings.reading == TableQuantity::Contrast {
            *lines = None;
            table.pack(levels, map.cell_m(), CONTRAST_READINGS);
            return full;
        }
        let lines = lines.get_or_insert_default();
        lines.seen.clone_from(&table.seen);
        lines.spans.clone_from(&table.spans);
        lines.pack(levels, map.cell_m(), CONTRAST_READINGS);
        match settings.reading {
            TableQuantity::Contrast => {}
            TableQuantity::Nearest => {
                table.pack(
                    &cells.nearest_levels(full, map, range_tables, NEAREST_REACH_M),
                    map.cell_m(),
                    CONTRAST_READINGS,
                );
            }
            TableQuantity::Gray | TableQuantity::NearestPixel => {
                let source = match settings.reading {
                    TableQuantity::Gray => image.narrow.iter().map(|value| *value as i16).collect::<Vec<i16>>(),
                    _ => nearest_pixel(image, full),
                };
                plain.read(&source, image.width, image.height, map, to_working);
                table.pack(&plain.plain_levels(cells), map.cell_m(), PLAIN_READINGS);
            }
        }
        full
    }
}

/// Distance of each half-resolution pixel to the nearest white one, in pixels of the working image times [`UNITS`] (Eq. 1 as printed).
///
/// A pixel is white if it has at least half of the full contrast.
fn nearest_pixel(image: &LineContrast, full: f32) -> Vec<i16> {
    const REACH: usize = 127;
    let half = 0.5 * full * PARTS;
    let white: Vec<bool> = image.contrast.iter().map(|value| f32::from(*value) >= half).collect();
    let nearest = distance::nearest(&white, image.width, image.height, REACH);
    nearest.iter().map(|pixels| (2.0 * UNITS * pixels).min(255.0 * UNITS) as i16).collect()
}

/// Readings of line contrast: a full line is +1, plain carpet where a line should be is -1/3.
const CONTRAST_READINGS: Readings = Readings { scale: 1.0 / (255 - NEUTRAL) as f64, zero: NEUTRAL };
/// Readings of whole gray levels or pixels.
const PLAIN_READINGS: Readings = Readings { scale: 1.0, zero: 0 };

/// Step in cells at which clear lines are sampled; lines are wider.
const CLEAR_STEP: usize = 2;
/// Smallest amount (of 255) that a cell counts as seen to be a clear line. A cell that an error of the tilt moves far does not tell
/// on which line it lies.
const MIN_CLEAR_SEEN: u32 = 96;

impl GroundTable {
    /// Makes a table from `SIDE` x `SIDE` levels of line contrast, row by row; every cell counts as seen.
    pub fn from_levels(levels: &[u8], cell_m: f64) -> Self {
        let mut table = Self { seen: vec![255; SIDE * SIDE], spans: vec![[0, SIDE as u16]; BLOCKS], ..Self::default() };
        table.pack(levels, cell_m, CONTRAST_READINGS);
        table
    }

    /// Packs levels; `spans` must be filled already.
    fn pack(&mut self, levels: &[u8], cell_m: f64, readings: Readings) {
        pack(levels, readings.zero, &self.spans, &mut self.quads);
        (self.cell_m, self.readings) = (cell_m, readings);
    }

    /// The packed cells, row by row: levels of (this, next x, next y, next x and y), from the low byte up.
    pub fn quads(&self) -> &[u32] {
        &self.quads
    }

    /// How levels are turned back into values.
    pub fn readings(&self) -> Readings {
        self.readings
    }

    /// Side of a cell, metres.
    pub fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// The factor and the offset that turn x or y on the ground of `base_footprint` (metres) into a column or row of the table.
    ///
    /// The centre of the first cell has the coordinate 0.
    pub fn to_cells(&self) -> (f64, f64) {
        (1.0 / self.cell_m, SIDE as f64 / 2.0 - 0.5)
    }

    /// Whether any cell within `reach_m` of a point on the ground may be other than neutral.
    pub fn may_tell(&self, ground: DVec2, reach_m: f64) -> bool {
        let (scale, offset) = self.to_cells();
        // Interpolation reaches one cell farther.
        let (u, v, reach) = (ground.x * scale + offset, ground.y * scale + offset, reach_m * scale + 2.0);
        let block = |cell: f64| (cell / BLOCK as f64).clamp(0.0, BLOCKS as f64) as usize;
        let rows = block(v - reach)..block(v + reach + BLOCK as f64);
        self.spans[rows]
            .iter()
            .any(|[from, to]| from < to && u + reach >= f64::from(*from) && u - reach <= f64::from(*to))
    }

    /// How much a point on the ground of `base_footprint` counts as seen: 0 (not at all) to 1.
    pub fn seen(&self, ground: DVec2) -> f64 {
        let (scale, offset) = self.to_cells();
        let (u, v) = (libm::round(ground.x * scale + offset), libm::round(ground.y * scale + offset));
        let inside = u >= 0.0 && v >= 0.0 && u < SIDE as f64 && v < SIDE as f64;
        if inside { f64::from(self.seen[v as usize * SIDE + u as usize]) / 255.0 } else { 0.0 }
    }

    /// Makes a copy in which every line, or whatever has the highest levels, is wider by `by_m` on each side.
    pub fn widen(&self, by_m: f64, widened: &mut Self) {
        let reach = (libm::round(by_m / self.cell_m) as usize).clamp(1, SIDE / 4);
        let mut levels: Vec<u8> = self.quads.iter().map(|quad| (quad & 255) as u8).collect();
        let mut along = levels.clone();
        let (rows, widened_rows) = (&mut levels[..], &mut along[..]);
        multiversioned!(|reach: usize, rows: &mut [u8], widened_rows: &mut [u8]| {
            for (source, target) in rows.chunks_exact(SIDE).zip(widened_rows.chunks_exact_mut(SIDE)) {
                for step in 1..=reach {
                    raise(&mut target[step..], &source[..SIDE - step]);
                    raise(&mut target[..SIDE - step], &source[step..]);
                }
            }
            rows.copy_from_slice(widened_rows);
            for step in (1..=reach).map(|rows| rows * SIDE) {
                raise(&mut rows[step..], &widened_rows[..SIDE * SIDE - step]);
                raise(&mut rows[..SIDE * SIDE - step], &widened_rows[step..]);
            }
        });
        widened.seen.clone_from(&self.seen);
        widened.spans.clear();
        widened.spans.resize(BLOCKS, [0, SIDE as u16]);
        widened.pack(&levels, self.cell_m, self.readings);
    }

    /// Iterates over the points on the ground of `base_footprint` (metres) that clearly show a line, each with its certainty, 0 to 1.
    ///
    /// The table must hold line contrast. Every second cell of each row and column is looked at.
    pub fn clear_lines(&self) -> impl Iterator<Item = (DVec2, f64)> + '_ {
        let (scale, offset) = self.to_cells();
        let rows = (0..SIDE).step_by(CLEAR_STEP);
        rows.flat_map(move |row| {
            let [from, to] = self.spans[row / BLOCK].map(usize::from);
            let y = (row as f64 - offset) / scale;
            (from..to).step_by(CLEAR_STEP).filter_map(move |column| {
                let cell = row * SIDE + column;
                let (level, seen) = (self.quads[cell] & 255, u32::from(self.seen[cell]));
                // The less a cell counts as seen, the closer its level is to neutral.
                let shows = seen >= MIN_CLEAR_SEEN
                    && level >= NEUTRAL.into()
                    && (level - u32::from(NEUTRAL)) * 255 >= 64 * seen;
                shows.then(|| (DVec2::new((column as f64 - offset) / scale, y), f64::from(seen) / 255.0))
            })
        })
    }

    /// Area of ground that each point of [`Self::clear_lines`] represents, square metres.
    pub fn clear_line_m2(&self) -> f64 {
        let side = CLEAR_STEP as f64 * self.cell_m;
        side * side
    }

    /// The level of a single cell, for pictures and tests.
    pub fn level(&self, column: usize, row: usize) -> u8 {
        (self.quads[row * SIDE + column] & 255) as u8
    }
}

/// Replaces each value by the other one, if that is higher.
#[inline(always)]
fn raise(values: &mut [u8], others: &[u8]) {
    for (value, other) in values.iter_mut().zip(others) {
        *value = (*value).max(*other);
    }
}

/// Packs each cell with its neighbours into one word. The rim of the table and everything outside of the spans reads as `zero`.
fn pack(levels: &[u8], zero: u8, spans: &[[u16; 2]], quads: &mut Vec<u32>) {
    quads.resize(SIDE * SIDE, 0);
    let (mut this, mut next) = ([zero; SIDE + 1], [zero; SIDE + 1]);
    let nothing = u32::from(zero) * 0x0101_0101;
    let span = |row: usize| spans[row.min(SIDE - 1) / BLOCK].map(usize::from);
    for (row, quads) in quads.chunks_exact_mut(SIDE).enumerate() {
        let below = row + 1;
        let [from, to] = span(below);
        next.fill(zero);
        if below < SIDE - 1 && from < to {
            let inner = from.max(1)..to.min(SIDE - 1);
            next[inner.clone()].copy_from_slice(&levels[below * SIDE + inner.start..below * SIDE + inner.end]);
        }
        let ([a, b], [c, d]) = (span(row), [from, to]);
        let from = if a < b { if c < d { a.min(c) } else { a } } else { c }.saturating_sub(1);
        let to = b.max(d).max(from);
        quads[..from].fill(nothing);
        quads[to..].fill(nothing);
        let (quads, this_row, next_row) = (&mut quads[from..to], &this[from..=to], &next[from..=to]);
        multiversioned!(|quads: &mut [u32], this_row: &[u8], next_row: &[u8]| {
            for (column, quad) in quads.iter_mut().enumerate() {
                *quad = u32::from(this_row[column])
                    | u32::from(this_row[column + 1]) << 8
                    | u32::from(next_row[column]) << 16
                    | u32::from(next_row[column + 1]) << 24;
            }
        });
        core::mem::swap(&mut this, &mut next);
    }
}
