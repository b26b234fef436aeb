//! The pose that fits prediction and measured lines best.
//!
//! A measured line place is a ray of the camera that has to lie in the plane through camera and field line; its
//! residual is the angle between the two. The unknowns are errors in units of the prior's standard deviations, so the
//! prior is the identity and no view, however poor, leaves the system singular.

use glam::{DMat3, DVec3};
use nalgebra::{Cholesky, Matrix6, SMatrix, SVector, Vector6};

use super::offsets::Sight;
use super::triangular::{Rows, Triangular};
use super::{ErrorCovariance, Errors, OF_LENS, Prior, UNKNOWNS, moved_pose};

pub(super) struct Solution {
    pub(super) moved: Vector6<f64>,
    pub(super) covariance: Matrix6<f64>,
    pub(super) cost: f64,
    pub(super) residuals: Residuals,
}

/// Pose and lens together.
pub(super) struct Joint {
    pub(super) moved: Errors,
    pub(super) covariance: ErrorCovariance,
    pub(super) condition: f64,
}

/// How wrong a measured line place is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of a thin line's place.
    pub(super) sigma_px: f64,
    /// So many neighbours along a line share one error, of lens, paint or texture.
    pub(super) correlated: f64,
}

/// Of the measurements that fit, as if all were of thin lines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Residuals {
    pub(super) fitting: usize,
    squared_px: f64,
    /// Pairs of neighbours along a line, and the sum of their products.
    pairs: usize,
    products_px: f64,
    /// Of each line's deviations, added up: the sum of the squares of these sums.
    line_sums_px: f64,
}

const ITERATIONS: usize = 6;
/// Steps smaller than this, in standard deviations of the prior, change nothing that matters.
const SMALL_STEP: f64 = 1e-3;
/// A measurement fits within this many standard deviations.
const FITTING: f64 = 4.0;
/// Standard deviation of a thin line's place before the frame itself has told: pixels, JPEG, lens.
const SIGMA_PX: f64 = 0.25;
const USUAL_CORRELATED: f64 = 3.0;
/// What is usual weighs as much as this many measurements.
const USUAL_COUNTS: f64 = 10.0;
const LEAST_SIGMA_PX: f64 = 0.06;
/// What different lines share (lens, light) does not show between neighbours.
pub(super) const SHARED: f64 = 1.6;
/// A line that is off as a whole counts as one measurement, and for what lines share: of the square of its sum.
const WHOLE_LINES: f64 = 1.5;
const MOST_CORRELATION: f64 = 0.85;
/// What a line that should be seen and is not costs, as much as one far off.
pub(super) const MISS_COST: f64 = 0.5;

/// `start` is an error vector relative to the prior's pose, `scale` that of the robust loss (Geman-McClure), in standard
/// deviations of one measurement. `None` if the prior is no covariance.
pub(super) fn solve(
    prior: &Prior,
    sights: &[Sight],
    start: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> Option<Solution> {
    let spread = Cholesky::new(prior.pose_covariance())?.unpack();
    let mut y = spread.solve_lower_triangular(start)?;
    let mut damping = 0.0;
    let mut here = ForPose::at(prior, &spread, sights, &y, scale, noise);
    for _ in 0..ITERATIONS {
        let step = here.triangle.damped(libm::sqrt(damping)).solve();
        let next = ForPose::at(prior, &spread, sights, &(y + step), scale, noise);
        if next.cost > here.cost {
            damping = (10.0 * damping).max(0.1 * sights.len() as f64);
            continue;
        }
        damping = 0.0;
        y += step;
        here = next;
        if step.norm() < SMALL_STEP {
            break;
        }
    }
    Some(Solution {
        moved: spread * y,
        covariance: here.covariance(&spread),
        cost: here.cost,
        residuals: here.residuals,
    })
}

/// The first step from `start`, in standard deviations of the prior, as [`solve`] takes it.
#[cfg(test)]
pub(super) fn step(
    prior: &Prior,
    sights: &[Sight],
    start: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> Option<Vector6<f64>> {
    let spread = Cholesky::new(prior.pose_covariance())?.unpack();
    let y = spread.solve_lower_triangular(start)?;
    Some(ForPose::at(prior, &spread, sights, &y, scale, noise).triangle.solve())
}

/// One step of the lens, which the pose follows, from a pose that has been solved for with the lens as it was believed to be and this
/// `noise`; the covariance of both is that with the `measured` one.
pub(super) fn joint(
    prior: &Prior,
    sights: &[Sight],
    moved: &Vector6<f64>,
    scale: f64,
    [noise, measured]: [Noise; 2],
) -> Option<Joint> {
    let spread = Cholesky::new(prior.covariance)?.unpack();
    let mut from = Errors::zeros();
    from.fixed_rows_mut::<6>(0).copy_from(moved);
    let y = spread.solve_lower_triangular(&from)?;
    let step = ForPoseAndLens::at(prior, &spread, sights, &y, scale, noise).triangle.solve_from(OF_LENS);
    let here = ForPoseAndLens::at(prior, &spread, sights, &y, scale, measured);
    Some(Joint {
        moved: spread * (y + step),
        covariance: here.covariance(&spread),
        condition: condition(&here.triangle.r()),
    })
}

/// Largest over smallest singular value: how many digits the solution can lose. At least 1.
fn condition(r: &ErrorCovariance) -> f64 {
    let values = r.singular_values();
    values.max() / values.min()
}

impl Residuals {
    pub(super) fn rms_px(&self) -> f64 {
        libm::sqrt(self.squared_px / self.fitting.max(1) as f64)
    }

    /// What the frame itself says of its noise, held back by what is usual as long as few lines say it.
    pub(super) fn noise(&self) -> Noise {
        let (count, usual) = (self.fitting as f64, SIGMA_PX * SIGMA_PX);
        let squared = (self.squared_px + USUAL_COUNTS * usual) / (count + USUAL_COUNTS);
        let variance = self.squared_px / count.max(1.0);
        let products = self.products_px / self.pairs.max(1) as f64;
        // Errors that fade like an autoregressive process along the line: of n, n (1 - rho) / (1 + rho) are independent.
        let rho = (products / variance.max(1e-12)).clamp(0.0, MOST_CORRELATION);
        let weight = self.pairs as f64 / (self.pairs as f64 + USUAL_COUNTS);
        let whole = self.line_sums_px / self.squared_px.max(1e-12);
        let correlated =
            weight * (WHOLE_LINES * whole).max(SHARED * (1.0 + rho) / (1.0 - rho)) + (1.0 - weight) * USUAL_CORRELATED;
        Noise { sigma_px: libm::sqrt(squared).max(LEAST_SIGMA_PX), correlated }
    }
}

impl Noise {
    /// Before the frame itself has told.
    pub(super) const USUAL: Self = Self { sigma_px: SIGMA_PX, correlated: USUAL_CORRELATED };
}

/// The problem about one pose, in the first N of the unknowns.
struct Linearised<const N: usize, const W: usize> {
    triangle: Triangular<N, W>,
    cost: f64,
    residuals: Residuals,
}

type ForPose = Linearised<6, 8>;
type ForPoseAndLens = Linearised<UNKNOWNS, 12>;

impl<const N: usize, const W: usize> Linearised<N, W> {
    /// With the lens as it is believed to be.
    fn at(
        prior: &Prior,
        spread: &SMatrix<f64, N, N>,
        sights: &[Sight],
        y: &SVector<f64, N>,
        scale: f64,
        noise: Noise,
    ) -> Self {
        let moved = spread * y;
        let pose = moved_pose(&prior.map_from_optical, &Vector6::from_fn(|i, _| moved[i]));
        let turn = DMat3::from_quat(pose.rotation);
        let mut rows = Rows::identity(&-y);
        let mut cost = 0.5 * y.norm_squared();
        let mut residuals = Residuals::default();
        // Correlated neighbours share one vote.
        let vote = 1.0 / noise.correlated;
        let mut last_px = None;
        let (mut line, mut line_sum_px) = (usize::MAX, 0.0);
        for sight in sights {
            let Some((residual, gradient)) = sight.residual::<N>(&turn, pose.translation) else { continue };
            let sigma_rad = noise.sigma_px * sight.sigmas / sight.pixels_per_rad;
            let deviation = residual / sigma_rad;
            let u = deviation / scale;
            let robust = 1.0 / (1.0 + u * u);
            cost += vote * 0.5 * deviation * deviation * robust;
            if deviation.abs() < FITTING {
                let off_px = deviation * noise.sigma_px;
                if sight.line != line {
                    residuals.line_sums_px += line_sum_px * line_sum_px;
                    (line, line_sum_px) = (sight.line, 0.0);
                }
                line_sum_px += off_px;
                residuals.fitting += 1;
                residuals.squared_px += off_px * off_px;
                if let Some(last_px) = last_px.filter(|_| sight.follows) {
                    residuals.pairs += 1;
                    residuals.products_px += off_px * last_px;
                }
                last_px = Some(off_px);
            } else {
                last_px = None;
            }
            let weight = libm::sqrt(vote) * robust / sigma_rad;
            let mut row = [0.0; N];
            for (j, value) in row.iter_mut().enumerate() {
                let column = spread.column(j);
                // The spread's factor is lower triangular.
                *value = weight * (j..N).map(|i| gradient[i] * column[i]).sum::<f64>();
            }
            rows.push(&row, -weight * residual);
        }
        residuals.line_sums_px += line_sum_px * line_sum_px;
        Self { triangle: rows.finish(), cost, residuals }
    }

    fn covariance(&self, spread: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
        let inverse = spread * self.triangle.inverse();
        let covariance = inverse * inverse.transpose();
        (covariance + covariance.transpose()) * 0.5
    }
}

impl Sight {
    /// The angle between ray and plane, and how it changes with the first N errors of pose and lens.
    fn residual<const N: usize>(&self, map_from_optical: &DMat3, camera: DVec3) -> Option<(f64, [f64; N])> {
        let ray = *map_from_optical * self.ray;
        let across = (self.point - camera).cross(self.tangent);
        let length = across.length();
        if length < 1e-9 {
            return None;
        }
        let normal = across / length;
        let turn = ray.cross(normal);
        let residual = ray.dot(normal);
        // The plane turns with the camera's place: its normal keeps its length.
        let shift = -self.tangent.cross(ray - normal * residual) / length;
        let by_pose = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
        let normal_in_camera = map_from_optical.transpose() * normal;
        let gradient = core::array::from_fn(|i| match i.checked_sub(OF_LENS) {
            None => by_pose[i],
            Some(of_lens) => normal_in_camera.dot(self.bends[of_lens]),
        });
        Some((residual, gradient))
    }
}
