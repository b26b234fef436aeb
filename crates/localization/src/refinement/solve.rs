//! The pose that fits the prediction and the measured lines best.
//!
//! A measured line place is a ray of the camera that has to lie in the plane through camera and field line. Its residual is
//! the angle between the two. The unknowns are errors in units of the prior's standard deviations, so that the prior is the
//! identity and no view, however poor, makes the system singular.

use glam::{DMat3, DVec3};
use nalgebra::{Cholesky, Matrix3, Matrix6, SMatrix, SVector, Vector6};

use super::line_measurement::LineMeasurement;
use super::paint_displacement::{self, LINES_APART, Pulls};
use super::qr_accumulator::{Rows, Triangular};
use super::{ErrorCovariance, Errors, OF_LENS, Prior, UNKNOWNS, moved_pose};

/// A solution for the pose, with the lens as believed.
pub(super) struct Solution {
    /// Error vector relative to the prior's pose.
    pub(super) moved: Vector6<f64>,
    pub(super) covariance: Matrix6<f64>,
    /// Half the squared deviation from the prior plus the robust cost of the lines.
    pub(super) cost: f64,
    pub(super) residuals: Residuals,
}

/// A solution for pose and lens together. The fields are those of [`super::Refined`].
pub(super) struct Joint {
    pub(super) moved: Errors,
    pub(super) covariance: ErrorCovariance,
    pub(super) by_paint: Matrix6<f64>,
    pub(super) condition: f64,
}

/// Noise of measured line places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of a line of the best width.
    pub(super) sigma_px: f64,
    /// Number of neighbours along a line that share one error, of lens, paint or texture.
    pub(super) correlated: f64,
}

/// Statistics of the measurements that fit, scaled to lines of the best width.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Residuals {
    /// Number of measurements that fit.
    pub(super) fitting: usize,
    /// Sum of their visibilities.
    pub(super) visible: f64,
    /// Sum of their squared deviations.
    squared_px: f64,
    /// Number of pairs of neighbours along a line.
    pairs: usize,
    /// Sum of the products of their deviations.
    products_px: f64,
    /// Sum, over lines, of the squared sum of a line's deviations.
    line_sums_px: f64,
}

/// Largest number of iterations.
const ITERATIONS: usize = 6;
/// Iteration ends at smaller steps, in standard deviations of the prior.
const MIN_STEP: f64 = 1e-3;
/// A measurement fits if it deviates by fewer standard deviations.
const FITTING_SIGMAS: f64 = 4.0;
/// Usual standard deviation of a line of the best width, before the frame itself has shown its noise: pixels, JPEG, lens.
const SIGMA_PX: f64 = 0.25;
/// Usual number of neighbours that share one error.
const USUAL_CORRELATED: f64 = 3.0;
/// The usual noise weighs as much as this many measurements ...
const USUAL_COUNTS: f64 = 3.0;
/// ... and the usual correlation as much as this many pairs of neighbours.
const USUAL_PAIRS: f64 = 10.0;
/// Smallest standard deviation that a frame may claim.
const MIN_SIGMA_PX: f64 = 0.05;
/// Factor for errors common to different lines (lens, light), which do not show between neighbours.
pub(super) const SHARED_FACTOR: f64 = 2.0;
/// Factor for lines that are off as a whole: such a line counts as one measurement, and lines share errors among each other.
const WHOLE_LINE_FACTOR: f64 = 2.0;
/// Largest correlation of neighbours.
const CORRELATION_LIMIT: f64 = 0.85;
/// Cost of an expected line that is not seen, as much as that of one far off.
pub(super) const MISS_COST: f64 = 0.5;

/// Solves for the pose. `start` is an error vector relative to the prior's pose, `scale` that of the robust loss
/// (Geman-McClure) in standard deviations of one measurement. `None` if the prior's covariance is not positive definite.
pub(super) fn solve(
    prior: &Prior,
    measurements: &[LineMeasurement],
    start: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> Option<Solution> {
    let spread = Cholesky::new(prior.pose_covariance())?.unpack();
    let mut y = spread.solve_lower_triangular(start)?;
    let mut damping = 0.0;
    let mut here = Linearised::at(prior, &spread, measurements, &y, scale, noise);
    for _ in 0..ITERATIONS {
        let step = here.triangle.damped(libm::sqrt(damping)).solve();
        let next = Linearised::at(prior, &spread, measurements, &(y + step), scale, noise);
        if next.cost > here.cost {
            damping = (10.0 * damping).max(0.1 * measurements.len() as f64);
            continue;
        }
        damping = 0.0;
        y += step;
        here = next;
        if step.norm() < MIN_STEP {
            break;
        }
    }
    Some(Solution {
        moved: spread * y,
        covariance: covariance(&here.triangle.inverse(), &spread),
        cost: here.cost,
        residuals: here.residuals,
    })
}

/// The first step of [`solve`] from `start`, in standard deviations of the prior.
#[cfg(test)]
pub(super) fn step(
    prior: &Prior,
    measurements: &[LineMeasurement],
    start: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> Option<Vector6<f64>> {
    let spread = Cholesky::new(prior.pose_covariance())?.unpack();
    let y = spread.solve_lower_triangular(start)?;
    Some(Linearised::at(prior, &spread, measurements, &y, scale, noise).triangle.solve())
}

/// Takes one step of the lens, which the pose follows, from the solution of [`solve`].
///
/// `noises` holds the noise that [`solve`] used and the measured one, which the covariance is computed with. The camera may
/// have moved unmeasured during the readout, and rotated if there is no gyro: that motion is solved for and marginalised.
pub(super) fn joint(
    prior: &Prior,
    measurements: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    noises: [Noise; 2],
) -> Option<Joint> {
    let way = Cholesky::new(prior.unseen_way_m2())?.unpack();
    if prior.turn_is_measured {
        return joint_with::<3, WITH_WAY, 16>(prior, &way, measurements, moved, scale, noises);
    }
    joint_without_gyro(prior, &way, measurements, moved, scale, noises)
}

/// [`joint`] without a gyro. It is a function of its own so that the usual path stays fast.
#[cold]
#[inline(never)]
fn joint_without_gyro(
    prior: &Prior,
    way: &Matrix3<f64>,
    measurements: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    noises: [Noise; 2],
) -> Option<Joint> {
    let mut motion = Matrix6::identity() * libm::sqrt(prior.unmeasured_turn_rad2());
    motion.fixed_view_mut::<3, 3>(0, 0).copy_from(way);
    joint_with::<6, WITH_MOTION, 24>(prior, &motion, measurements, moved, scale, noises)
}

/// [`joint`] with M = N - UNKNOWNS unknowns of motion that are marginalised. `unseen` is the lower triangular factor of their
/// covariance.
fn joint_with<const M: usize, const N: usize, const W: usize>(
    prior: &Prior,
    unseen: &SMatrix<f64, M, M>,
    measurements: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    [noise, measured]: [Noise; 2],
) -> Option<Joint> {
    let spread = Cholesky::new(prior.covariance)?.unpack();
    let mut from = Errors::zeros();
    from.fixed_rows_mut::<6>(0).copy_from(moved);
    let y = spread.solve_lower_triangular(&from)?;
    let (lines, pulls) = line_rows::<M, N, W>(prior, (&spread, unseen), measurements, moved, scale, noise);
    // Both noises are factors of each row's weight.
    let weight = (noise.sigma_px / measured.sigma_px) * libm::sqrt(noise.correlated / measured.correlated);
    let mut back = SVector::<f64, N>::zeros();
    back.fixed_rows_mut::<UNKNOWNS>(0).copy_from(&-y);
    let [believed, shown] = [1.0, weight].map(|weight| lines.weighed(weight, &back));
    let step = believed.solve_from(OF_LENS);
    let inverse = shown.inverse();
    Some(Joint {
        moved: spread * (y + step.fixed_rows::<UNKNOWNS>(0)),
        covariance: covariance(&inverse, &spread),
        by_paint: paint_displacement::covariance(&pulls, weight * weight, &inverse, &spread),
        condition: condition(&shown.r(), &inverse),
    })
}

/// The rows of the lines alone, for pose, lens and unmeasured motion, and how each line pulls if it is displaced.
fn line_rows<const M: usize, const N: usize, const W: usize>(
    prior: &Prior,
    (spread, unseen): (&ErrorCovariance, &SMatrix<f64, M, M>),
    measurements: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> (Triangular<N, W>, Pulls<N>) {
    let pose = moved_pose(&prior.map_from_optical, moved);
    let mut pulls: Pulls<N> = [SVector::zeros(); LINES_APART];
    let turn = DMat3::from_quat(pose.rotation);
    let into_camera = turn.transpose();
    let mut rows = Rows::none();
    for measurement in measurements {
        let Some(off) = measurement.residual(&turn, pose.translation) else { continue };
        let normal = into_camera * off.normal;
        let by_motion =
            [normal / measurement.distance, measurement.ray.cross(normal)].map(|by| (by * measurement.row).to_array());
        let by_lens = measurement.ray_by_lens.map(|bend| normal.dot(bend));
        let by_pose_and_lens =
            core::array::from_fn(|i| if i < OF_LENS { off.by_pose[i] } else { by_lens[i - OF_LENS] });
        let weighing = WeightedResidual::of(measurement, off.radians, scale, noise);
        let mut row = [0.0; N];
        row[..UNKNOWNS].copy_from_slice(&weighing.row(&by_pose_and_lens, spread));
        row[UNKNOWNS..].copy_from_slice(&weighing.row(&core::array::from_fn(|i| by_motion[i / 3][i % 3]), unseen));
        rows.push(&row, -weighing.weight * off.radians);
        // A line that moves aside is drawn as if the camera had moved the other way.
        let aside = measurement.tangent.cross(DVec3::Z);
        let by_aside = -aside.dot(DVec3::from_slice(&off.by_pose));
        pulls[measurement.line.min(LINES_APART - 1)] += SVector::from(row) * (weighing.weight * by_aside);
    }
    (rows.finish(), pulls)
}

/// Condition number of pose and lens in the 1-norm, as LAPACK's `trcon` defines it: how many digits the solution can lose. At least 1.
fn condition<const N: usize>(r: &SMatrix<f64, N, N>, inverse: &SMatrix<f64, N, N>) -> f64 {
    let norm = |of: &SMatrix<f64, N, N>| {
        let columns = (0..UNKNOWNS).map(|j| (0..=j).map(|i| of[(i, j)].abs()).sum::<f64>());
        columns.fold(0.0, f64::max)
    };
    norm(r) * norm(inverse)
}

impl Residuals {
    /// Root mean square of the deviations.
    pub(super) fn rms_px(&self) -> f64 {
        libm::sqrt(self.squared_px / self.fitting.max(1) as f64)
    }

    /// The noise that this frame shows, drawn towards the usual one as long as few lines contribute.
    pub(super) fn noise(&self) -> Noise {
        let (count, usual) = (self.fitting as f64, SIGMA_PX * SIGMA_PX);
        let squared = (self.squared_px + USUAL_COUNTS * usual) / (count + USUAL_COUNTS);
        let variance = self.squared_px / count.max(1.0);
        let products = self.products_px / self.pairs.max(1) as f64;
        // Errors fade along the line like an autoregressive process: of n, n (1 - rho) / (1 + rho) are independent.
        let rho = (products / variance.max(1e-12)).clamp(0.0, CORRELATION_LIMIT);
        let weight = self.pairs as f64 / (self.pairs as f64 + USUAL_PAIRS);
        let whole = self.line_sums_px / self.squared_px.max(1e-12);
        let correlated = weight * (WHOLE_LINE_FACTOR * whole).max(SHARED_FACTOR * (1.0 + rho) / (1.0 - rho))
            + (1.0 - weight) * USUAL_CORRELATED;
        Noise { sigma_px: libm::sqrt(squared).max(MIN_SIGMA_PX), correlated }
    }
}

impl Noise {
    /// The noise that is assumed before the frame has shown its own.
    pub(super) const USUAL: Self = Self { sigma_px: SIGMA_PX, correlated: USUAL_CORRELATED };
}

/// The problem linearised about one pose, with the lens as believed.
struct Linearised {
    triangle: Triangular<6, 8>,
    cost: f64,
    residuals: Residuals,
}

/// Number of unknowns with the camera's unmeasured way from the first row's time to the last's, along its own axes, metres.
const WITH_WAY: usize = UNKNOWNS + 3;
/// Number of unknowns with its unmeasured rotation as well, radians.
const WITH_MOTION: usize = WITH_WAY + 3;

impl Linearised {
    /// Linearises about `y`, the error in standard deviations of the prior.
    fn at(
        prior: &Prior,
        spread: &Matrix6<f64>,
        measurements: &[LineMeasurement],
        y: &Vector6<f64>,
        scale: f64,
        noise: Noise,
    ) -> Self {
        let pose = moved_pose(&prior.map_from_optical, &(spread * y));
        let turn = DMat3::from_quat(pose.rotation);
        let mut rows = Rows::identity(&-y);
        let mut cost = 0.5 * y.norm_squared();
        let mut residuals = Residuals::default();
        let mut last_px = None;
        let (mut line, mut line_sum_px) = (usize::MAX, 0.0);
        for measurement in measurements {
            let Some(off) = measurement.residual(&turn, pose.translation) else { continue };
            let weighing = WeightedResidual::of(measurement, off.radians, scale, noise);
            let deviation = weighing.deviation;
            cost += weighing.cost;
            if deviation.abs() < FITTING_SIGMAS {
                let off_px = deviation * noise.sigma_px;
                if measurement.line != line {
                    residuals.line_sums_px += line_sum_px * line_sum_px;
                    (line, line_sum_px) = (measurement.line, 0.0);
                }
                line_sum_px += off_px;
                residuals.fitting += 1;
                residuals.visible += measurement.visibility;
                residuals.squared_px += off_px * off_px;
                if let Some(last_px) = last_px.filter(|_| measurement.follows) {
                    residuals.pairs += 1;
                    residuals.products_px += off_px * last_px;
                }
                last_px = Some(off_px);
            } else {
                last_px = None;
            }
            rows.push(&weighing.row(&off.by_pose, spread), -weighing.weight * off.radians);
        }
        residuals.line_sums_px += line_sum_px * line_sum_px;
        Self { triangle: rows.finish(), cost, residuals }
    }
}

/// Covariance of the first M unknowns, marginalised over the others, from the inverse of R.
fn covariance<const N: usize, const M: usize>(
    inverse: &SMatrix<f64, N, N>,
    spread: &SMatrix<f64, M, M>,
) -> SMatrix<f64, M, M> {
    let inverse = spread * inverse.fixed_rows::<M>(0);
    let covariance = inverse * inverse.transpose();
    (covariance + covariance.transpose()) * 0.5
}

/// Residual and weight of one measurement.
struct WeightedResidual {
    /// Deviation in standard deviations of the measurement.
    deviation: f64,
    /// Robust cost.
    cost: f64,
    /// Weight of its row, per radian.
    weight: f64,
}

impl WeightedResidual {
    fn of(measurement: &LineMeasurement, off_rad: f64, scale: f64, noise: Noise) -> Self {
        let sigma_rad = noise.sigma_px * measurement.sigmas / measurement.pixels_per_rad;
        let deviation = off_rad / sigma_rad;
        let u = deviation / scale;
        let robust = 1.0 / (1.0 + u * u);
        // Correlated neighbours share one vote.
        let vote = 1.0 / noise.correlated;
        let cost = vote * 0.5 * deviation * deviation * robust;
        Self { deviation, cost, weight: libm::sqrt(vote) * robust / sigma_rad }
    }

    /// The weighted row in units of the prior, whose `spread` is lower triangular.
    fn row<const N: usize>(&self, gradient: &[f64; N], spread: &SMatrix<f64, N, N>) -> [f64; N] {
        core::array::from_fn(|j| {
            let column = spread.column(j);
            self.weight * (j..N).map(|i| gradient[i] * column[i]).sum::<f64>()
        })
    }
}

/// Residual of a ray and its line.
struct PlaneResidual {
    /// Angle between ray and plane.
    radians: f64,
    /// Its derivatives by the errors of the pose.
    by_pose: [f64; 6],
    /// Unit normal of the plane, in `map`.
    normal: DVec3,
}

impl LineMeasurement {
    /// The residual at this pose, or `None` if the camera lies on the line.
    fn residual(&self, map_from_optical: &DMat3, camera: DVec3) -> Option<PlaneResidual> {
        let ray = *map_from_optical * self.ray;
        let across = (self.point - camera).cross(self.tangent);
        let length = across.length();
        if length < 1e-9 {
            return None;
        }
        let normal = across / length;
        let turn = ray.cross(normal);
        let radians = ray.dot(normal);
        // The plane rotates as the camera moves; its normal stays a unit vector.
        let shift = -self.tangent.cross(ray - normal * radians) / length;
        Some(PlaneResidual { radians, by_pose: [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z], normal })
    }
}
