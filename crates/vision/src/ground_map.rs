//! The map from the cells of the ground table to the pixels that show them.

use core::ops::Range;

use glam::{DVec2, DVec3};

use super::border::CarpetBorder;
use super::ground::SIDE;
use realitysim_geometry::{Isometry, Projector};

/// Side of a block in cells. The lens is evaluated at the corners of blocks and interpolated within.
pub(super) const BLOCK: usize = 4;
/// Number of blocks along each side of the table.
pub(super) const BLOCKS: usize = SIDE / BLOCK;
/// Number of block corners along each side of the table.
const NODES: usize = BLOCKS + 1;

/// The pixels of the full-size image that show the corners of the table's blocks.
#[derive(Clone, Debug, Default)]
pub struct GroundMap {
    /// Pixel of each block corner, row by row; NaN where the camera does not see it.
    nodes: Vec<[f32; 2]>,
    /// Columns `[from, to)` of each row of cells that lie within the carpet's border.
    pub(super) columns: Vec<[usize; 2]>,
    /// Half the side of the table, metres.
    pub(super) range_m: f64,
    /// Point below the camera on the ground of `base_footprint`, metres.
    pub(super) foot: DVec2,
    /// Height of the camera above the ground, metres.
    pub(super) height_m: f64,
}

impl GroundMap {
    /// Projects the block corners that lie within the carpet's border, for a table of half side `range_m`.
    pub fn fill(
        &mut self,
        projector: &Projector,
        footprint_from_optical: &Isometry,
        range_m: f64,
        border: &CarpetBorder,
    ) {
        self.range_m = range_m;
        self.foot = footprint_from_optical.translation.truncate();
        self.height_m = footprint_from_optical.translation.z;
        self.columns.clear();
        for row in 0..SIDE {
            let inside = border.row(self.place(row)).unwrap_or((f64::INFINITY, f64::NEG_INFINITY));
            let column = |x: f64| libm::ceil((x + range_m) / self.cell_m() - 0.5).clamp(0.0, SIDE as f64) as usize;
            let (from, to) = (column(inside.0), column(inside.1));
            self.columns.push([from, to.max(from)]);
        }
        let optical_from_footprint = footprint_from_optical.inverse();
        let axis = |x: f64, y: f64| optical_from_footprint.transform_vector(DVec3::new(x, y, 0.0));
        let cell = self.cell_m();
        let first = optical_from_footprint.transform_point(DVec3::new(self.place(0), self.place(0), 0.0));
        let (along, up) = (axis(cell * BLOCK as f64, 0.0), axis(0.0, cell * BLOCK as f64));
        self.nodes.clear();
        self.nodes.resize(NODES * NODES, [f32::NAN; 2]);
        if footprint_from_optical.translation.z <= 0.0 {
            return;
        }
        for node_row in 0..NODES {
            // Only nodes that are a corner of a block on the carpet are projected.
            let rows = (node_row * BLOCK).saturating_sub(BLOCK)..((node_row + 1) * BLOCK).min(SIDE);
            let from = self.columns[rows.clone()].iter().map(|c| c[0]).min().unwrap_or(0);
            let to = self.columns[rows].iter().map(|c| c[1]).max().unwrap_or(0);
            if from >= to {
                continue;
            }
            for column in from / BLOCK..=to.div_ceil(BLOCK).min(NODES - 1) {
                let ray = first + up * node_row as f64 + along * column as f64;
                if let Some(pixel) = projector.project_inside(ray) {
                    self.nodes[node_row * NODES + column] = [pixel.x as f32, pixel.y as f32];
                }
            }
        }
    }

    /// The blocks that lie on the carpet in any of these rows of cells, widened to whole pairs of blocks.
    pub(super) fn blocks(&self, rows: Range<usize>) -> Range<usize> {
        let from = self.columns[rows.clone()].iter().map(|columns| columns[0]).min().unwrap_or(0);
        let to = self.columns[rows].iter().map(|columns| columns[1]).max().unwrap_or(0);
        let pair = 2 * BLOCK;
        if from < to { from / pair * 2..to.div_ceil(pair) * 2 } else { 0..0 }
    }

    /// Side of a cell, metres.
    pub(super) fn cell_m(&self) -> f64 {
        2.0 * self.range_m / SIDE as f64
    }

    /// Coordinate of the centre of a row or column on the ground of `base_footprint`, metres.
    pub(super) fn place(&self, index: usize) -> f64 {
        (index as f64 + 0.5) * self.cell_m() - self.range_m
    }

    /// Squared distance on the ground between the middle of a block and the point below the camera, square metres.
    pub(super) fn square_range(&self, block_row: usize, block_column: usize) -> f64 {
        let middle =
            |block: usize| (block * BLOCK) as f64 * self.cell_m() + 0.5 * BLOCK as f64 * self.cell_m() - self.range_m;
        DVec2::new(middle(block_column), middle(block_row)).distance_squared(self.foot)
    }

    /// Pixels of a block's four corners, first row, then second; `None` unless the camera sees all four.
    #[inline(always)]
    pub(super) fn corners(&self, block_row: usize, block_column: usize) -> Option<[[f32; 2]; 4]> {
        let node = block_row * NODES + block_column;
        let corners = [self.nodes[node], self.nodes[node + 1], self.nodes[node + NODES], self.nodes[node + NODES + 1]];
        let sum = (corners[0][0] + corners[1][0]) + (corners[2][0] + corners[3][0]);
        // A single NaN makes the sum NaN.
        (!sum.is_nan()).then_some(corners)
    }
}
