//! The lens as a table: one unit ray per pixel, in `camera_link`.

use core::ops::Range;

use glam::{DVec2, DVec3};

use realitysim_geometry::{Isometry, Lens};

/// One pixel wider than the image on all sides, because differences of neighbours give the footprint.
#[derive(Clone, Debug)]
pub(super) struct RayTable {
    width: usize,
    height: usize,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Per row the columns that the lens draws on. A lens's view is convex, so these have no gap.
    seen: Vec<Range<usize>>,
}

impl RayTable {
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
        let seen = (0..height).map(|row| seen_columns(&rays[(row + 1) * stride + 1..][..width])).collect();
        let filled: Vec<DVec3> =
            (0..rays.len()).map(|at| rays[at].unwrap_or_else(|| extrapolated(&rays, at, stride))).collect();
        let axis = |pick: fn(&DVec3) -> f64| filled.iter().map(|ray| pick(ray) as f32).collect();
        Self { width, height, x: axis(|r| r.x), y: axis(|r| r.y), z: axis(|r| r.z), seen }
    }

    pub(super) fn width(&self) -> usize {
        self.width
    }

    pub(super) fn height(&self) -> usize {
        self.height
    }

    pub(super) fn seen(&self, row: usize) -> Range<usize> {
        self.seen[row].clone()
    }

    /// The ray of one pixel.
    #[inline]
    pub(super) fn at(&self, column: usize, row: usize) -> [f32; 3] {
        self.padded(column + 1, row + 1)
    }

    /// The same counted from the padding: (0, 0) is left of and above the image.
    #[inline]
    pub(super) fn padded(&self, column: usize, row: usize) -> [f32; 3] {
        let at = row * (self.width + 2) + column;
        [self.x[at], self.y[at], self.z[at]]
    }

    /// x, y and z of the padded row (0 is above the image).
    pub(super) fn padded_row(&self, row: usize) -> [&[f32]; 3] {
        let stride = self.width + 2;
        let range = row * stride..(row + 1) * stride;
        [&self.x[range.clone()], &self.y[range.clone()], &self.z[range]]
    }
}

fn seen_columns(row: &[Option<DVec3>]) -> Range<usize> {
    let first = row.iter().position(Option::is_some).unwrap_or(0);
    let end = row.iter().rposition(Option::is_some).map_or(first, |last| last + 1);
    first..end
}

/// Just outside the view the rays go on as they did just inside.
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
