//! The lens as a table of unit rays, one per pixel, in `camera_link`.

use core::ops::Range;

use glam::{DVec2, DVec3};

use realitysim_geometry::{Isometry, Lens};

/// Unit rays of all pixels. The table is one pixel wider than the image on all sides, because the footprint of a pixel is
/// computed from differences of its neighbours.
#[derive(Clone, Debug)]
pub(super) struct RayTable {
    width: usize,
    height: usize,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Columns in each row that the lens sees. The view of a lens is convex, so they have no gap.
    visible_columns: Vec<Range<usize>>,
}

impl RayTable {
    /// Computes the rays of a lens.
    pub(super) fn new(lens: &Lens) -> Self {
        let (width, height) = (lens.width() as usize, lens.height() as usize);
        let stride = width + 2;
        let link_from_optical = Isometry::link_from_optical();
        let rays: Vec<Option<DVec3>> = (0..stride * (height + 2))
            .map(|at| {
                let pixel = DVec2::new((at % stride) as f64 - 1.0, (at / stride) as f64 - 1.0);
                lens.unproject(pixel).map(|ray| link_from_optical.transform_vector(ray))
            })
            .collect();
        let visible_columns =
            (0..height).map(|row| find_visible_columns(&rays[(row + 1) * stride + 1..][..width])).collect();
        let filled: Vec<DVec3> =
            (0..rays.len()).map(|at| rays[at].unwrap_or_else(|| extrapolated(&rays, at, stride))).collect();
        let axis = |pick: fn(&DVec3) -> f64| filled.iter().map(|ray| pick(ray) as f32).collect();
        Self { width, height, x: axis(|r| r.x), y: axis(|r| r.y), z: axis(|r| r.z), visible_columns }
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    pub(super) fn height(&self) -> usize {
        self.height
    }

    /// Columns of a row that the lens sees.
    pub(super) fn visible_columns(&self, row: usize) -> Range<usize> {
        self.visible_columns[row].clone()
    }

    /// The ray of one pixel.
    #[inline]
    pub(super) fn at(&self, column: usize, row: usize) -> [f32; 3] {
        self.padded(column + 1, row + 1)
    }

    /// The ray of one pixel with indices of the padded table: (0, 0) is left of and above the image.
    #[inline]
    pub(super) fn padded(&self, column: usize, row: usize) -> [f32; 3] {
        let at = row * (self.width + 2) + column;
        [self.x[at], self.y[at], self.z[at]]
    }

    /// x, y and z of all rays in a row of the padded table (0 is above the image).
    pub(super) fn padded_row(&self, row: usize) -> [&[f32]; 3] {
        let stride = self.width + 2;
        let range = row * stride..(row + 1) * stride;
        [&self.x[range.clone()], &self.y[range.clone()], &self.z[range]]
    }
}

/// Range from the first to the last ray that exists.
fn find_visible_columns(row: &[Option<DVec3>]) -> Range<usize> {
    let first = row.iter().position(Option::is_some).unwrap_or(0);
    let end = row.iter().rposition(Option::is_some).map_or(first, |last| last + 1);
    first..end
}

/// Ray just outside the view, extrapolated linearly from two rays inside.
fn extrapolated(rays: &[Option<DVec3>], at: usize, stride: usize) -> DVec3 {
    let ray = |index: Option<usize>| index.and_then(|index| rays.get(index).copied().flatten());
    let steps = [1, stride];
    let pairs = steps.iter().flat_map(|&step| {
        [(at.checked_sub(step), at.checked_sub(2 * step)), (at.checked_add(step), at.checked_add(2 * step))]
    });
    let mut nearest = DVec3::X;
    for (near, far) in pairs {
        let Some(near) = ray(near) else { continue };
        let Some(far) = ray(far) else {
            nearest = near;
            continue;
        };
        return near * 2.0 - far;
    }
    nearest
}
