//! The pose that fits prediction and measured lines best.
//!
//! A measured line place is a ray of the camera that has to lie in the plane through camera and field line; its
//! residual is the angle between the two. The unknowns are errors in units of the prior's standard deviations, so the
//! prior is the identity and no view, however poor, leaves the system singular.

use glam::{DQuat, DVec3};
use nalgebra::{Cholesky, Matrix6, Vector6};

use super::offsets::Sight;
use super::triangular::Triangular;
use super::{Prior, moved_pose};

pub(super) struct Solution {
    pub(super) moved: Vector6<f64>,
    pub(super) covariance: Matrix6<f64>,
    pub(super) cost: f64,
    pub(super) condition: f64,
    pub(super) fitting: usize,
    /// Of those that fit, as if all were thin lines.
    pub(super) rms_px: f64,
}

const ITERATIONS: usize = 6;
/// Steps smaller than this, in standard deviations of the prior, change nothing that matters.
const SMALL_STEP: f64 = 1e-3;
/// A measurement fits within this many standard deviations.
const FITTING: f64 = 4.0;
/// Neighbours share the errors of lens, paint and texture: so many measurements count as one in the covariance.
const CORRELATED: f64 = 3.0;
/// What a line that should be seen and is not costs, as much as one far off.
pub(super) const MISS_COST: f64 = 0.5;

/// `start` is an error vector relative to the prior's pose, `scale` that of the robust loss (Geman-McClure), in standard
/// deviations of one measurement; `sigma_px` is that of a thin line. `None` if the prior is no covariance.
pub(super) fn solve(
    prior: &Prior,
    sights: &[Sight],
    start: &Vector6<f64>,
    scale: f64,
    sigma_px: f64,
) -> Option<Solution> {
    let spread = Cholesky::new(prior.covariance)?.unpack();
    let mut y = spread.solve_lower_triangular(start)?;
    let mut damping = 0.0;
    let mut here = Linearised::at(prior, &spread, sights, &y, scale, sigma_px);
    for _ in 0..ITERATIONS {
        let mut triangle = here.triangle.clone();
        if damping > 0.0 {
            for i in 0..6 {
                let mut row = [0.0; 6];
                row[i] = libm::sqrt(damping);
                triangle.push(row, 0.0);
            }
        }
        let step = triangle.solve();
        let next = Linearised::at(prior, &spread, sights, &(y + step), scale, sigma_px);
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
    let inverse = spread * here.triangle.inverse();
    let mut covariance = inverse * inverse.transpose();
    covariance = (covariance + covariance.transpose()) * 0.5;
    Some(Solution {
        moved: spread * y,
        covariance,
        cost: here.cost,
        condition: here.triangle.condition(),
        fitting: here.fitting,
        rms_px: libm::sqrt(here.squared_px / here.fitting.max(1) as f64),
    })
}

/// The problem about one pose.
struct Linearised {
    triangle: Triangular,
    cost: f64,
    fitting: usize,
    squared_px: f64,
}

impl Linearised {
    fn at(prior: &Prior, spread: &Matrix6<f64>, sights: &[Sight], y: &Vector6<f64>, scale: f64, sigma_px: f64) -> Self {
        let pose = moved_pose(&prior.map_from_optical, &(spread * y));
        let mut triangle = Triangular::identity(&-y);
        let (mut cost, mut fitting, mut squared_px) = (0.5 * y.norm_squared(), 0, 0.0);
        // Correlated neighbours share one vote.
        let vote = 1.0 / CORRELATED;
        for sight in sights {
            let Some((residual, gradient)) = sight.residual(&pose.rotation, pose.translation) else { continue };
            let sigma_rad = sigma_px * sight.sigmas / sight.pixels_per_rad;
            let deviation = residual / sigma_rad;
            let u = deviation / scale;
            let robust = 1.0 / (1.0 + u * u);
            cost += vote * 0.5 * deviation * deviation * robust;
            if deviation.abs() < FITTING {
                fitting += 1;
                squared_px += deviation * deviation * sigma_px * sigma_px;
            }
            let weight = libm::sqrt(vote) * robust / sigma_rad;
            let mut row = [0.0; 6];
            for (j, value) in row.iter_mut().enumerate() {
                let column = spread.column(j);
                // The spread's factor is lower triangular.
                *value = weight * (j..6).map(|i| gradient[i] * column[i]).sum::<f64>();
            }
            triangle.push(row, -weight * residual);
        }
        Self { triangle, cost, fitting, squared_px }
    }
}

impl Sight {
    /// The angle between ray and plane, and how it changes with the pose's error vector.
    fn residual(&self, map_from_optical: &DQuat, camera: DVec3) -> Option<(f64, [f64; 6])> {
        let ray = *map_from_optical * self.ray;
        let across = (self.point - camera).cross(self.tangent);
        let length = across.length();
        if length < 1e-9 {
            return None;
        }
        let normal = across / length;
        let turn = ray.cross(normal);
        let shift = -self.tangent.cross(ray) / length;
        Some((ray.dot(normal), [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z]))
    }
}
