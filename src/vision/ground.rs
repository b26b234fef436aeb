//! The ground table: a robot-centred square of the floor, each cell saying how much a line is seen there.
//!
//! For one frame the camera's height and tilt are the same for every particle, so lens and tilt are dealt with once,
//! here. A particle then costs a planar rigid motion and a lookup per line point.

use glam::DVec2;

use super::cells::{Cells, LinesSeen, full_contrast, line_strengths, range_weights};
use super::contrast::LineContrast;
use super::ground_map::GroundMap;
use super::{Reading, VisionSettings, WorkingScale};

/// Cells along each side of the table.
pub const SIDE: usize = 400;

/// Levels of a packed cell that say "nothing known": neither for nor against a line.
pub const NEUTRAL: u8 = 64;

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

/// Fills the table that the observation model wants, and the one of line contrast if that is another; with the gray
/// levels of a full line.
pub fn tables(
    image: &LineContrast,
    map: &GroundMap,
    to_working: WorkingScale,
    pixels_per_radian: f64,
    settings: &VisionSettings,
) -> (GroundTable, Option<GroundTable>, f32) {
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
    (table(settings.reading), lines, full_contrast)
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
