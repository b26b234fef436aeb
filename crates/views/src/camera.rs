//! A lens prepared for view synthesis: the rays of all its pixels, computed once.

use glam::{DVec2, DVec3};

use realitysim_geometry::{Lens, Projector};

/// A lens and the rays of its pixels. Construction takes some tens of milliseconds; one camera serves any number of views.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    projector: Projector,
    /// Unit rays in `camera_optical_frame`, row by row; NaN where the lens draws nothing.
    rays: Vec<[f32; 3]>,
    /// Unit rays at the corners of the cells, in `camera_optical_frame`; NaN where the lens draws nothing.
    nodes: Vec<DVec3>,
    /// For each pixel: whether the lens draws it.
    shows: Vec<bool>,
    /// For each cell: whether it lies in the image and the lens draws all of it.
    full_cells: Vec<bool>,
}

/// Side of a cell in pixels. Maps are computed at the corners of cells and interpolated in between.
pub(super) const CELL: usize = 8;
/// Number of pixels in a cell.
pub(super) const AREA: usize = CELL * CELL;

impl Camera {
    /// Computes the rays of all pixels of `lens`.
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

    /// The lens as calibrated.
    pub fn lens(&self) -> &Lens {
        self.projector.lens()
    }

    /// Width of the image in pixels.
    pub fn width(&self) -> usize {
        self.lens().width() as usize
    }

    /// Height of the image in pixels.
    pub fn height(&self) -> usize {
        self.lens().height() as usize
    }

    /// For each pixel, row by row: whether the lens draws it.
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

    /// Number of columns and rows of cells. The last column and row may reach beyond the image.
    pub(super) fn cells(&self) -> (usize, usize) {
        cells(self.width(), self.height())
    }

    /// Unit rays at the corners of the cells, row by row; one more corner than cells in each direction.
    pub(super) fn node_rays(&self) -> &[DVec3] {
        &self.nodes
    }

    /// Copies the rays of a cell's pixels into separate arrays of x, y and z. Entries beyond the image's edge keep their value.
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

    /// The unit ray of a pixel in `camera_optical_frame`, or `None` where the lens draws nothing.
    pub fn ray(&self, u: usize, v: usize) -> Option<DVec3> {
        let [x, y, z] = self.rays[v * self.width() + u];
        (!x.is_nan()).then(|| DVec3::new(f64::from(x), f64::from(y), f64::from(z)))
    }
}

fn cells(width: usize, height: usize) -> (usize, usize) {
    (width.div_ceil(CELL), height.div_ceil(CELL))
}
