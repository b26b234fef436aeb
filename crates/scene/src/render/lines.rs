//! Search for the painted lines that a pixel may show: grids of candidates, with coarser ones for larger footprints.

use glam::DVec2;

use super::fixed::fixed;
use super::footprint::GroundPoint;
use super::shape::Shape;
use realitysim_geometry::Field;

/// The painted lines of a field with grids for the search.
#[derive(Clone, Debug)]
pub(super) struct LineMap {
    shapes: Vec<Shape>,
    half_extent: [f32; 2],
    /// Grids from fine to coarse, each twice as coarse as the one before.
    grids: Vec<Grid>,
}

/// For each cell the indices of the shapes that a pixel in it may touch.
#[derive(Clone, Debug)]
struct Grid {
    cells_per_metre: f32,
    columns: usize,
    rows: usize,
    /// Cell i has `items[starts[i]..starts[i + 1]]`. There is one start more than there are cells.
    starts: Vec<u32>,
    items: Vec<u8>,
    /// Largest reach of a pixel for which the grid is valid, metres.
    reach: f32,
}

/// Side of a cell of the finest grid, metres. It is larger on large fields.
const MIN_CELL_M: f64 = 0.08;
/// Maximum number of cells along a side of the finest grid.
const MAX_CELLS_PER_SIDE: f64 = 256.0;

impl LineMap {
    pub(super) fn new(field: &Field) -> Self {
        // Indices are u8. Fields have some 20 strokes.
        let mut shapes = Shape::all(field);
        shapes.truncate(256);
        let half = field.carpet_half_extent();
        let longest = 2.0 * half.max_element();
        let mut grids = Vec::new();
        let mut side = MIN_CELL_M.max(longest / MAX_CELLS_PER_SIDE);
        while side < longest {
            grids.push(Grid::new(&shapes, half, side));
            side *= 2.0;
        }
        // In the coarsest grid every shape is a candidate, for footprints of any size.
        grids.push(Grid { reach: f32::INFINITY, ..Grid::new(&shapes, half, 4.0 * longest) });
        Self { shapes, half_extent: half.as_vec2().to_array(), grids }
    }

    /// Share of the pixel that is painted, 0 to 1. The pixel must be on or near the carpet.
    #[inline]
    pub(super) fn coverage(&self, p: &GroundPoint) -> f32 {
        let Some(grid) = self.grids.iter().find(|grid| p.reach <= grid.reach) else { return 0.0 };
        let mut bare = 1.0;
        for &which in grid.candidates(p.x + self.half_extent[0], p.y + self.half_extent[1]) {
            // Crossing lines are perpendicular, so their covered shares are independent of each other.
            bare *= 1.0 - self.shapes[usize::from(which)].coverage(p);
        }
        1.0 - bare
    }
}

impl Grid {
    fn new(shapes: &[Shape], half: DVec2, side: f64) -> Self {
        let count = |half: f64| libm::ceil(2.0 * half / side).max(1.0) as usize;
        let (columns, rows) = (count(half.x), count(half.y));
        let reach = side as f32;
        let (mut starts, mut items) = (vec![0], Vec::new());
        for cell in 0..columns * rows {
            let centre = DVec2::new((cell % columns) as f64 + 0.5, (cell / columns) as f64 + 0.5) * side - half;
            let centre = centre.as_vec2().to_array();
            let near = |shape: &Shape| shape.near(centre, reach / 2.0, reach);
            items.extend((0..shapes.len()).filter(|&which| near(&shapes[which])).map(|which| which as u8));
            starts.push(items.len() as u32);
        }
        Self { cells_per_metre: (1.0 / side) as f32, columns, rows, starts, items, reach }
    }

    /// Candidates at (x, y), metres from the corner of the carpet. Outside the carpet they are those of the nearest cell.
    #[inline]
    fn candidates(&self, x: f32, y: f32) -> &[u8] {
        let index =
            |metres: f32, count: usize| (fixed((metres * self.cells_per_metre).max(0.0)).0 as usize).min(count - 1);
        let (column, row) = (index(x, self.columns), index(y, self.rows));
        let cell = row * self.columns + column;
        &self.items[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}
