//! Coverage of a database: a grid of x, y and yaw whose cells count images, and a picture of it.

use glam::DVec2;
use image::{Rgb, RgbImage};

use super::index::Index;
use realitysim_geometry::{Field, PoseGrid};

/// Side of a cell in the picture. It is smaller if the picture would become larger than [`MAX_SIDE_PX`].
const CELL_PX: usize = 26;
/// Longest side of the picture.
const MAX_SIDE_PX: usize = 4096;
/// Colour of poses without images.
const MISSING: [u8; 3] = [222, 226, 222];
const CARPET: [u8; 3] = [246, 248, 246];
const LINE: [u8; 3] = [120, 150, 120];
/// Colours of poses with one image and with the most images; those between are mixed on a logarithmic scale.
const ONE: [f64; 3] = [150.0, 205.0, 150.0];
const MANY: [f64; 3] = [10.0, 95.0, 45.0];

/// Counts the images of each pose: cells of side `cell_m` metres on the carpet, each with `sectors` headings.
pub fn coverage(index: &Index, field: &Field, cell_m: f64, sectors: usize) -> PoseGrid {
    let mut grid = PoseGrid::new(field.carpet_half_extent(), cell_m, sectors);
    for record in index.records() {
        grid.add(&record.pose());
    }
    grid
}

/// Draws the field from above, y up. Each cell is a disc whose sectors are the headings, darker the more images there are.
pub fn coverage_picture(grid: &PoseGrid, field: &Field) -> RgbImage {
    let cell_px = (MAX_SIDE_PX / grid.columns.max(grid.rows)).clamp(1, CELL_PX);
    let (width, height) = (grid.columns * cell_px, grid.rows * cell_px);
    let most = grid.counts().iter().copied().max().unwrap_or(0).max(2);
    let pixel = |u: u32, v: u32| {
        let (u, v) = (u as usize, height - 1 - v as usize);
        let place = DVec2::new(u as f64 + 0.5, v as f64 + 0.5) / cell_px as f64 * grid.cell_m - grid.half_extent();
        let half_pixel = 0.7 * grid.cell_m / cell_px as f64;
        let off =
            DVec2::new((u % cell_px) as f64 + 0.5, (v % cell_px) as f64 + 0.5) - DVec2::splat(cell_px as f64 / 2.0);
        if field.distance_to_centre_line(place) <= (field.line_width() / 4.0).max(half_pixel) {
            return Rgb(LINE);
        }
        if off.length() > cell_px as f64 / 2.0 - 1.5 {
            return Rgb(CARPET);
        }
        match grid.count(u / cell_px, v / cell_px, libm::atan2(off.y, off.x)) {
            0 => Rgb(MISSING),
            count => {
                let share = libm::log(f64::from(count)) / libm::log(f64::from(most));
                Rgb(core::array::from_fn(|c| (ONE[c] + (MANY[c] - ONE[c]) * share.min(1.0)) as u8))
            }
        }
    };
    RgbImage::from_fn(width as u32, height as u32, pixel)
}
