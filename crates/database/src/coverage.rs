//! Coverage of a database: a grid of x, y and yaw whose cells count images.

use super::index::Index;
use realitysim_geometry::{Field, PoseGrid};

/// Counts the images of each pose: cells of side `cell_m` metres on the carpet, each with `sectors` headings.
pub fn coverage(index: &Index, field: &Field, cell_m: f64, sectors: usize) -> PoseGrid {
    let mut grid = PoseGrid::new(field.carpet_half_extent(), cell_m, sectors);
    for record in index.records() {
        grid.add(&record.pose());
    }
    grid
}
