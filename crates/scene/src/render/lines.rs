//! Which painted lines can show in a pixel: grids of candidates, coarser ones for larger footprints.

use glam::DVec2;

use super::fixed::fixed;
use super::footprint::GroundPoint;
use super::shape::Shape;
use realitysim_geometry::Field;

#[derive(Clone, Debug)]
pub(super) struct LineMap {
    shapes: Vec<Shape>,
    half_extent: [f32; 2],
    /// Each twice as coarse as the one before.
    grids: Vec<Grid>,
}

/// For each cell the shapes that a pixel in it can touch.
#[derive(Clone, Debug)]
struct Grid {
    cells_per_metre: f32,
    columns: usize,
    rows: usize,
    /// One more than cells: cell i owns `items[starts[i]..starts[i + 1]]`.
    starts: Vec<u32>,
    items: Vec<u8>,
    /// Footprints up to this size are served, metres.
    reach: f32,
}

/// The finest grid's cells have a side of this, or more on large fields.
const FINEST_M: f64 = 0.08;
const MOST_CELLS_PER_SIDE: f64 = 256.0;

impl LineMap {
    pub(super) fn new(field: &Field) -> Self {
        // u8 indices: fields have some 20 strokes.
        let mut shapes = Shape::all(field);
        shapes.truncate(256);
        let half = field.carpet_half_extent();
        let longest = 2.0 * half.max_element();
        let mut grids = Vec::new();
        let mut side = FINEST_M.max(longest / MOST_CELLS_PER_SIDE);
        while side < longest {
            grids.push(Grid::new(&shapes, half, side));
            side *= 2.0;
        }
        // Whatever the footprint, everything is a candidate.
        grids.push(Grid { reach: f32::INFINITY, ..Grid::new(&shapes, half, 4.0 * longest) });
        Self { shapes, half_extent: half.as_vec2().to_array(), grids }
    }

    /// The part of the pixel that is painted. The pixel must be on or near the carpet.
    #[inline]
    pub(super) fn coverage(&self, p: &GroundPoint) -> f32 {
        let Some(grid) = self.grids.iter().find(|grid| p.reach <= grid.reach) else { return 0.0 };
        let mut bare = 1.0;
        for &which in grid.candidates(p.x + self.half_extent[0], p.y + self.half_extent[1]) {
            // Lines that cross do so at right angles: what one leaves bare the other covers in proportion.
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

    /// Just outside the carpet the nearest cell's candidates serve as well.
    #[inline]
    fn candidates(&self, x: f32, y: f32) -> &[u8] {
        let index =
            |metres: f32, count: usize| (fixed((metres * self.cells_per_metre).max(0.0)).0 as usize).min(count - 1);
        let (column, row) = (index(x, self.columns), index(y, self.rows));
        let cell = row * self.columns + column;
        &self.items[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }
}
