//! A lens prepared for views: the rays of all its pixels, known once and for all.

use glam::{DVec2, DVec3};

use realitysim_geometry::{Lens, Projector};

/// A lens with its rays. Making one takes some tens of milliseconds; it serves any number of views.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    projector: Projector,
    /// Unit rays in `camera_optical_frame`, row by row; NaN where the lens draws nothing.
    rays: Vec<[f32; 3]>,
    /// The same at the corners of the cells.
    nodes: Vec<DVec3>,
    shows: Vec<bool>,
    /// By cell: it lies in the image, and all of it is drawn.
    full_cells: Vec<bool>,
}

/// Side of a cell, pixels: maps are calculated at its corners and interpolated within.
pub(super) const CELL: usize = 8;
/// Its pixels.
pub(super) const AREA: usize = CELL * CELL;

impl Camera {
    pub fn new(lens: &Lens) -> Self {
        let (width, height) = (lens.width() as usize, lens.height() as usize);
        let ray = |u: usize, v: usize| lens.unproject(DVec2::new(u as f64, v as f64)).unwrap_or(DVec3::NAN);
        let pixels = (0..height).flat_map(|v| (0..width).map(move |u| (u, v)));
        let rays: Vec<[f32; 3]> = pixels.map(|(u, v)| ray(u, v).as_vec3().to_array()).collect();
        let (columns, rows) = cells(width, height);
        let corners = (0..=rows).flat_map(|row| (0..=columns).map(move |column| (column, row)));
        let nodes = corners.map(|(column, row)| ray(column * CELL, row * CELL)).collect();
        let shows: Vec<bool> = rays.iter().map(|ray| !ray[0].is_nan()).collect();
        let is_full = |(column, row): (usize, usize)| {
            let (left, top) = (column * CELL, row * CELL);
            let lines = (top..top + CELL).map(|v| shows.get(v * width + left..v * width + left + CELL));
            left + CELL <= width && lines.into_iter().all(|line| line.is_some_and(|line| !line.contains(&false)))
        };
        let full_cells = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row))).map(is_full).collect();
        Self { projector: Projector::new(lens), rays, nodes, shows, full_cells }
    }

    pub fn lens(&self) -> &Lens {
        self.projector.lens()
    }

    pub fn width(&self) -> usize {
        self.lens().width() as usize
    }

    pub fn height(&self) -> usize {
        self.lens().height() as usize
    }

    /// Which pixels the lens draws, row by row.
    pub fn shows(&self) -> &[bool] {
        &self.shows
    }

    /// Whether a cell lies in the image and the lens draws all of it.
    pub(super) fn is_full(&self, (column, row): (usize, usize)) -> bool {
        self.full_cells[row * self.cells().0 + column]
    }

    pub(super) fn projector(&self) -> &Projector {
        &self.projector
    }

    /// Columns and rows of cells; the last ones may reach over the edge.
    pub(super) fn cells(&self) -> (usize, usize) {
        cells(self.width(), self.height())
    }

    /// Corners of the cells, row by row, one more each way than cells.
    pub(super) fn node_rays(&self) -> &[DVec3] {
        &self.nodes
    }

    /// Those of a cell's pixels, x, y and z apart; what lies beyond the image's edge stays as it is.
    pub(super) fn cell_rays(&self, column: usize, row: usize, [xs, ys, zs]: &mut [[f32; AREA]; 3]) {
        let (left, top) = (column * CELL, row * CELL);
        let (width, count) = (self.width(), CELL.min(self.width() - left));
        for line in 0..CELL.min(self.height() - top) {
            let rays = &self.rays[(top + line) * width + left..][..count];
            for (i, [x, y, z]) in rays.iter().enumerate() {
                (xs[line * CELL + i], ys[line * CELL + i], zs[line * CELL + i]) = (*x, *y, *z);
            }
        }
    }

    /// The unit ray of a pixel in `camera_optical_frame`; `None` where the lens draws nothing.
    pub fn ray(&self, u: usize, v: usize) -> Option<DVec3> {
        let [x, y, z] = self.rays[v * self.width() + u];
        (!x.is_nan()).then(|| DVec3::new(f64::from(x), f64::from(y), f64::from(z)))
    }
}

fn cells(width: usize, height: usize) -> (usize, usize) {
    (width.div_ceil(CELL), height.div_ceil(CELL))
}
