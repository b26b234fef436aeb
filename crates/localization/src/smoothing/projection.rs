//! What the constants of a walk mean in the image: uncertainty of projection, difference of two lenses, bias of residuals.
//!
//! A lens that is shifted and a camera that is turned draw almost the same. As in mrcal, the rotation that explains most of a
//! change is taken out, so that what remains is an error that no mount can mend.

use glam::{DQuat, DVec2, DVec3};
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::{CONSTANTS, Constants, ConstantsCovariance, PlaceResidual};
use realitysim_geometry::{Lens, LensError, LensParameters};

/// Number of cells along the image's longer side.
const CELLS: u32 = 16;
/// Indices in [`Constants::values`] of what belongs to the lens.
const OF_LENS: [usize; 7] = [0, 1, 2, 3, 8, 9, 10];
/// Step of derivatives, as a share of a constant's standard deviation.
const STEP_SHARE: f64 = 1e-2;
/// Step of derivatives by rotation, radians.
const STEP_RAD: f64 = 1e-5;

/// Square cells over an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageGrid {
    /// Number of cells in a row.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// Side of a cell, pixels.
    pub side_px: f64,
}

/// How far the line places of a cell lie from where the fit draws them, all in the same direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellBias {
    /// Number of frames with line places in the cell.
    pub frames: usize,
    /// Mean displacement of what was found from what is drawn, pixels; 0 along lines that are seen from one side only.
    pub off_px: DVec2,
    /// The displacement in its standard deviations.
    pub sigmas: f64,
}

impl ImageGrid {
    /// The grid of a lens's image.
    pub fn new(lens: &LensParameters) -> Self {
        let side_px = f64::from(lens.width.max(lens.height)) / f64::from(CELLS);
        let cells = |pixels: u32| (libm::ceil(f64::from(pixels) / side_px) as usize).max(1);
        Self { columns: cells(lens.width), rows: cells(lens.height), side_px }
    }

    /// The middles of all cells, row by row, in pixels.
    pub fn middles(&self) -> impl Iterator<Item = DVec2> + use<> {
        let Self { columns, rows, side_px } = *self;
        let middle = move |number: usize| side_px * (number as f64 + 0.5) - 0.5;
        (0..rows).flat_map(move |row| (0..columns).map(move |column| DVec2::new(middle(column), middle(row))))
    }

    /// Number of the cell that holds a pixel of the image.
    pub fn cell(&self, pixel: DVec2) -> usize {
        let number = |at: f64, count: usize| (((at + 0.5) / self.side_px).max(0.0) as usize).min(count - 1);
        number(pixel.y, self.rows) * self.columns + number(pixel.x, self.columns)
    }

    /// Bias of the residuals in each cell. The residuals of one frame in one cell count as one, since neighbouring places of a
    /// line err together.
    pub fn bias(&self, residuals: &[Vec<PlaceResidual>], rms_px: f64) -> Vec<CellBias> {
        let mut cells = vec![(0, Matrix2::zeros(), Vector2::zeros()); self.rows * self.columns];
        for frame in residuals {
            let mut counts = vec![0usize; cells.len()];
            frame.iter().for_each(|residual| counts[self.cell(residual.pixel)] += 1);
            for residual in frame {
                let at = self.cell(residual.pixel);
                let scale = 1.0 / (residual.sigmas * libm::sqrt(counts[at] as f64));
                let across = Vector2::new(residual.across.x, residual.across.y) * scale;
                cells[at].1 += across * across.transpose();
                cells[at].2 += across * (residual.off_px * scale);
            }
            counts.iter().zip(&mut cells).for_each(|(count, cell)| cell.0 += usize::from(*count > 0));
        }
        cells.into_iter().map(|(frames, normal, right)| cell_bias(frames, normal, right, rms_px)).collect()
    }
}

/// Share of the normal matrix that holds a direction which no line of the cell shows at 0.
const RIDGE: f64 = 0.05;

fn cell_bias(frames: usize, normal: Matrix2<f64>, right: Vector2<f64>, rms_px: f64) -> CellBias {
    let held = normal + Matrix2::identity() * (RIDGE * normal.trace());
    let Some(inverse) = held.try_inverse().filter(|_| frames > 0) else { return CellBias::default() };
    let off = inverse * right;
    let sigmas = libm::sqrt(off.dot(&(normal * off)).max(0.0)) / rms_px.max(1e-6);
    CellBias { frames, off_px: DVec2::new(off.x, off.y), sigmas }
}

/// Standard deviation with which a direction is drawn, in its worst direction of the image, by cell, pixels; `None` outside of
/// what the lens sees.
///
/// # Errors
///
/// A [`LensError`] if the lens is not valid.
pub fn uncertainty_px(
    lens: &LensParameters,
    covariance: &ConstantsCovariance,
    grid: &ImageGrid,
) -> Result<Vec<Option<f64>>, LensError> {
    let projection = Projection::new(lens, grid)?;
    let mut columns = Vec::new();
    for constant in OF_LENS {
        let step = (STEP_SHARE * libm::sqrt(covariance[(constant, constant)])).max(1e-12);
        let mut by = [0.0; CONSTANTS];
        by[constant] = step;
        let other = Lens::new(Constants::default().plus(&by).lens(lens))?;
        let moved = projection.unturned(projection.moved(|ray| other.project(ray)));
        columns.push(moved.into_iter().map(|moved| moved.map(|moved| moved / step)).collect::<Vec<_>>());
    }
    let sigma = |cell: usize| {
        let mut spread = Matrix2::zeros();
        for (a, i) in columns.iter().zip(OF_LENS) {
            for (b, j) in columns.iter().zip(OF_LENS) {
                let (a, b) = (a[cell]?, b[cell]?);
                spread += Vector2::new(a.x, a.y) * Vector2::new(b.x, b.y).transpose() * covariance[(i, j)];
            }
        }
        let (mean, half) = (spread.trace() / 2.0, (spread[(0, 0)] - spread[(1, 1)]) / 2.0);
        Some(libm::sqrt((mean + libm::hypot(half, spread[(0, 1)])).max(0.0)))
    };
    Ok((0..projection.seen.len()).map(sigma).collect())
}

/// Distance between where two lenses draw the same direction, by cell, pixels, after the rotation that brings both closest.
///
/// # Errors
///
/// A [`LensError`] if a lens is not valid.
pub fn difference_px(
    lens: &LensParameters,
    other: &LensParameters,
    grid: &ImageGrid,
) -> Result<Vec<Option<f64>>, LensError> {
    let (projection, other) = (Projection::new(lens, grid)?, Lens::new(other.clone())?);
    let moved = projection.unturned(projection.moved(|ray| other.project(ray)));
    Ok(moved.into_iter().map(|moved| moved.map(DVec2::length)).collect())
}

/// The directions that the middles of cells see, and how their pixels move when the camera turns.
struct Projection {
    seen: Vec<Option<Direction>>,
}

#[derive(Clone, Copy)]
struct Direction {
    pixel: DVec2,
    ray: DVec3,
    /// Movement of the pixel for each radian about the camera's axes, pixels.
    turns: [DVec2; 3],
}

impl Projection {
    fn new(parameters: &LensParameters, grid: &ImageGrid) -> Result<Self, LensError> {
        let lens = Lens::new(parameters.clone())?;
        let see = |pixel: DVec2| {
            let ray = lens.unproject(pixel).filter(|_| lens.contains(pixel))?;
            let by = |axis: DVec3| {
                let turned = lens.project(DQuat::from_scaled_axis(axis * STEP_RAD) * ray)?;
                Some((turned - pixel) / STEP_RAD)
            };
            Some(Direction { pixel, ray, turns: [by(DVec3::X)?, by(DVec3::Y)?, by(DVec3::Z)?] })
        };
        Ok(Self { seen: grid.middles().map(see).collect() })
    }

    /// How far the pixel of each direction moves with another way to draw.
    fn moved(&self, draw: impl Fn(DVec3) -> Option<DVec2>) -> Vec<Option<DVec2>> {
        self.seen.iter().map(|seen| seen.and_then(|seen| Some(draw(seen.ray)? - seen.pixel))).collect()
    }

    /// What of these movements no rotation of the camera explains.
    fn unturned(&self, moved: Vec<Option<DVec2>>) -> Vec<Option<DVec2>> {
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for (Direction { turns, .. }, moved) in
            self.seen.iter().zip(&moved).filter_map(|(seen, moved)| seen.zip(*moved))
        {
            normal += Matrix3::from_fn(|i, j| turns[i].dot(turns[j]));
            right += Vector3::from_fn(|i, _| turns[i].dot(moved));
        }
        let turn = normal.try_inverse().map_or_else(Vector3::zeros, |inverse| inverse * right);
        let rest = |(seen, moved): (&Option<Direction>, Option<DVec2>)| {
            let (Direction { turns, .. }, moved) = seen.zip(moved)?;
            Some(moved - turns[0] * turn[0] - turns[1] * turn[1] - turns[2] * turn[2])
        };
        self.seen.iter().zip(moved).map(rest).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_geometry::LensModel;

    fn lens() -> LensParameters {
        let model = LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] };
        LensParameters { width: 640, height: 480, fx: 205.0, fy: 205.0, cx: 322.0, cy: 236.0, model, fov_deg: None }
    }

    #[test]
    fn a_longer_focal_length_moves_pixels_by_its_share_of_the_radius() {
        let grid = ImageGrid::new(&lens());
        let mut covariance = ConstantsCovariance::zeros();
        covariance[(0, 0)] = 1e-6;
        let found = uncertainty_px(&lens(), &covariance, &grid).expect("a lens");
        for (pixel, sigma) in grid.middles().zip(found).filter_map(|(pixel, sigma)| Some((pixel, sigma?))) {
            let radius = pixel.distance(DVec2::new(322.0, 236.0));
            assert!((sigma - 1e-3 * radius).abs() < 0.02, "{pixel}: {sigma}");
        }
    }

    #[test]
    fn a_shifted_centre_is_mostly_a_turned_camera_and_a_difference_knows_it() {
        let grid = ImageGrid::new(&lens());
        let shifted = LensParameters { cx: 324.0, ..lens() };
        let off = difference_px(&lens(), &shifted, &grid).expect("a lens");
        let largest = off.iter().flatten().copied().fold(0.0, f64::max);
        let mean = off.iter().flatten().sum::<f64>() / off.iter().flatten().count() as f64;
        assert!(mean > 0.0 && mean < 1.2 && largest < 2.5, "{mean} {largest}");
        let same = difference_px(&lens(), &lens(), &grid).expect("a lens");
        assert!(same.iter().flatten().all(|off| *off < 1e-6));
    }

    #[test]
    fn residuals_to_one_side_are_a_bias_and_noise_is_none() {
        let grid = ImageGrid::new(&lens());
        let (pixel, other) = (DVec2::new(100.0, 400.0), DVec2::new(500.0, 300.0));
        let frame = |number: usize| {
            let noise = if number.is_multiple_of(2) { 0.2 } else { -0.2 };
            let at = |pixel, across, off_px| PlaceResidual { pixel, across, off_px, sigmas: 1.0, ground: None };
            vec![at(pixel, DVec2::X, 0.3 + noise), at(pixel, DVec2::Y, noise), at(other, DVec2::X, noise)]
        };
        let bias = grid.bias(&(0..100).map(frame).collect::<Vec<_>>(), 0.25);
        let there = bias[grid.cell(pixel)];
        assert!((there.off_px - DVec2::new(0.3, 0.0)).length() < 0.04 && there.sigmas > 5.0, "{there:?}");
        assert!(bias[grid.cell(other)].sigmas < 1.0 && bias[grid.cell(other)].frames == 100);
        assert_eq!(bias[0], CellBias::default());
    }
}
