//! The pose that fits prediction and measured lines best.
//!
//! A measured line place is a ray of the camera that has to lie in the plane through camera and field line; its
//! residual is the angle between the two. The unknowns are errors in units of the prior's standard deviations, so the
//! prior is the identity and no view, however poor, leaves the system singular.

use glam::{DMat3, DVec3};
use nalgebra::{Cholesky, Matrix3, Matrix6, SMatrix, SVector, Vector6};

use super::line_measurement::LineMeasurement;
use super::qr_accumulator::{Rows, Triangular};
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
    pub(super) by_paint: Matrix6<f64>,
    pub(super) condition: f64,
}

/// How wrong a measured line place is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of the place of a line of the best width.
    pub(super) sigma_px: f64,
    /// So many neighbours along a line share one error, of lens, paint or texture.
    pub(super) correlated: f64,
}

/// Of the measurements that fit, as if all lines were of the best width.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Residuals {
    pub(super) fitting: usize,
    /// The same, each counted by its visibility.
    pub(super) visible: f64,
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
/// Standard deviation of such a place before the frame itself has told: pixels, JPEG, lens.
const SIGMA_PX: f64 = 0.25;
const USUAL_CORRELATED: f64 = 3.0;
/// What is usual weighs as much as this many measurements, and as this many pairs of neighbours.
const USUAL_COUNTS: f64 = 3.0;
const USUAL_PAIRS: f64 = 10.0;
const LEAST_SIGMA_PX: f64 = 0.05;
/// What different lines share (lens, light) does not show between neighbours.
pub(super) const SHARED: f64 = 2.0;
/// A line that is off as a whole counts as one measurement, and for what lines share: of the square of its sum.
const WHOLE_LINES: f64 = 2.0;
const MOST_CORRELATION: f64 = 0.85;
/// How far a line is painted from where the field's description has it, as a whole: one standard deviation. Like the consider parameters of
/// Schmidt's filter it is not solved for, as no frame can tell it from an error of the pose, and counts in the covariance.
pub(super) const PAINT_M: f64 = 0.001;
/// The displacements of so many lines are told apart; of more, the last share one.
const LINES_APART: usize = 32;
/// What a line that should be seen and is not costs, as much as one far off.
pub(super) const MISS_COST: f64 = 0.5;

/// `start` is an error vector relative to the prior's pose, `scale` that of the robust loss (Geman-McClure), in standard
/// deviations of one measurement. `None` if the prior is no covariance.
pub(super) fn solve(
    prior: &Prior,
    sights: &[LineMeasurement],
    start: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> Option<Solution> {
    let spread = Cholesky::new(prior.pose_covariance())?.unpack();
    let mut y = spread.solve_lower_triangular(start)?;
    let mut damping = 0.0;
    let mut here = Linearised::at(prior, &spread, sights, &y, scale, noise);
    for _ in 0..ITERATIONS {
        let step = here.triangle.damped(libm::sqrt(damping)).solve();
        let next = Linearised::at(prior, &spread, sights, &(y + step), scale, noise);
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
        covariance: covariance(&here.triangle.inverse(), &spread),
        cost: here.cost,
        residuals: here.residuals,
    })
}

/// The first step from `start`, in standard deviations of the prior, as [`solve`] takes it.
#[cfg(test)]
pub(super) fn step(
    prior: &Prior,
    sights: &[LineMeasurement],
    start: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> Option<Vector6<f64>> {
    let spread = Cholesky::new(prior.pose_covariance())?.unpack();
    let y = spread.solve_lower_triangular(start)?;
    Some(Linearised::at(prior, &spread, sights, &y, scale, noise).triangle.solve())
}

/// One step of the lens, which the pose follows, from a pose that has been solved for with the lens as it was believed to be and this
/// `noise`; the covariance of both is that with the `measured` one. The camera may have gone a way that nothing tells of while its
/// sensor was read, and have turned if no gyro tells: that is solved for with them, and forgotten.
pub(super) fn joint(
    prior: &Prior,
    sights: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    noises: [Noise; 2],
) -> Option<Joint> {
    let way = Cholesky::new(prior.unseen_way_m2())?.unpack();
    if prior.turn_is_felt {
        return joint_with::<3, WITH_WAY, 16>(prior, &way, sights, moved, scale, noises);
    }
    unfelt(prior, &way, sights, moved, scale, noises)
}

/// Apart, so that the usual path stays as tight as if there were no other.
#[cold]
#[inline(never)]
fn unfelt(
    prior: &Prior,
    way: &Matrix3<f64>,
    sights: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    noises: [Noise; 2],
) -> Option<Joint> {
    let mut motion = Matrix6::identity() * libm::sqrt(prior.unfelt_turn_rad2());
    motion.fixed_view_mut::<3, 3>(0, 0).copy_from(way);
    joint_with::<6, WITH_MOTION, 24>(prior, &motion, sights, moved, scale, noises)
}

/// `unseen` is the lower triangular factor of the covariance of the N - UNKNOWNS = M unknowns that are forgotten.
fn joint_with<const M: usize, const N: usize, const W: usize>(
    prior: &Prior,
    unseen: &SMatrix<f64, M, M>,
    sights: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    [noise, measured]: [Noise; 2],
) -> Option<Joint> {
    let spread = Cholesky::new(prior.covariance)?.unpack();
    let mut from = Errors::zeros();
    from.fixed_rows_mut::<6>(0).copy_from(moved);
    let y = spread.solve_lower_triangular(&from)?;
    let (lines, pulls) = with_lens::<M, N, W>(prior, (&spread, unseen), sights, moved, scale, noise);
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
        by_paint: by_paint(&pulls, weight * weight, &inverse, &spread),
        condition: condition(&shown.r(), &inverse),
    })
}

/// Covariance of the pose's error because lines are painted beside where the field's description has them: the solution moves as each pulls at
/// it, and each is off by its own.
fn by_paint<const N: usize>(
    pulls: &Pulls<N>,
    weight: f64,
    inverse: &SMatrix<f64, N, N>,
    spread: &ErrorCovariance,
) -> Matrix6<f64> {
    let mut covariance = Matrix6::zeros();
    for pull in pulls.iter().filter(|pull| pull.norm_squared() > 0.0) {
        let moved = inverse * (inverse.tr_mul(pull) * (weight * PAINT_M));
        let moved = (spread * moved.fixed_rows::<UNKNOWNS>(0)).fixed_rows::<6>(0).into_owned();
        covariance += moved * moved.transpose();
    }
    covariance
}

/// Of each line, the gradient of the cost by the unknowns for each metre that it is painted aside.
type Pulls<const N: usize> = [SVector<f64, N>; LINES_APART];

/// What the lines alone say of pose, lens and unseen motion, and how each of them would pull if it were painted elsewhere.
fn with_lens<const M: usize, const N: usize, const W: usize>(
    prior: &Prior,
    (spread, unseen): (&ErrorCovariance, &SMatrix<f64, M, M>),
    sights: &[LineMeasurement],
    moved: &Vector6<f64>,
    scale: f64,
    noise: Noise,
) -> (Triangular<N, W>, Pulls<N>) {
    let pose = moved_pose(&prior.map_from_optical, moved);
    let mut pulls: Pulls<N> = [SVector::zeros(); LINES_APART];
    let turn = DMat3::from_quat(pose.rotation);
    let into_camera = turn.transpose();
    let mut rows = Rows::none();
    for sight in sights {
        let Some(off) = sight.off(&turn, pose.translation) else { continue };
        let normal = into_camera * off.normal;
        let by_motion = [normal / sight.distance, sight.ray.cross(normal)].map(|by| (by * sight.row).to_array());
        let by_lens = sight.bends.map(|bend| normal.dot(bend));
        let by_pose_and_lens =
            core::array::from_fn(|i| if i < OF_LENS { off.by_pose[i] } else { by_lens[i - OF_LENS] });
        let weighing = Weighing::of(sight, off.radians, scale, noise);
        let mut row = [0.0; N];
        row[..UNKNOWNS].copy_from_slice(&weighing.row(&by_pose_and_lens, spread));
        row[UNKNOWNS..].copy_from_slice(&weighing.row(&core::array::from_fn(|i| by_motion[i / 3][i % 3]), unseen));
        rows.push(&row, -weighing.weight * off.radians);
        // A line that moves aside is drawn as if the camera had moved the other way.
        let aside = sight.tangent.cross(DVec3::Z);
        let by_aside = -aside.dot(DVec3::from_slice(&off.by_pose));
        pulls[sight.line.min(LINES_APART - 1)] += SVector::from(row) * (weighing.weight * by_aside);
    }
    (rows.finish(), pulls)
}

/// In the 1-norm, as LAPACK's `trcon` has it, of pose and lens: how many digits the solution can lose. At least 1.
fn condition<const N: usize>(r: &SMatrix<f64, N, N>, inverse: &SMatrix<f64, N, N>) -> f64 {
    let norm = |of: &SMatrix<f64, N, N>| {
        let columns = (0..UNKNOWNS).map(|j| (0..=j).map(|i| of[(i, j)].abs()).sum::<f64>());
        columns.fold(0.0, f64::max)
    };
    norm(r) * norm(inverse)
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
        let weight = self.pairs as f64 / (self.pairs as f64 + USUAL_PAIRS);
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

/// The problem about one pose, the lens being as it is believed to be.
struct Linearised {
    triangle: Triangular<6, 8>,
    cost: f64,
    residuals: Residuals,
}

/// Three more unknowns: the camera's unseen way between the first row's time and the last's, along its own axes, metres.
const WITH_WAY: usize = UNKNOWNS + 3;
/// And three of its turn about them, radians.
const WITH_MOTION: usize = WITH_WAY + 3;

impl Linearised {
    fn at(
        prior: &Prior,
        spread: &Matrix6<f64>,
        sights: &[LineMeasurement],
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
        for sight in sights {
            let Some(off) = sight.off(&turn, pose.translation) else { continue };
            let weighing = Weighing::of(sight, off.radians, scale, noise);
            let deviation = weighing.deviation;
            cost += weighing.cost;
            if deviation.abs() < FITTING {
                let off_px = deviation * noise.sigma_px;
                if sight.line != line {
                    residuals.line_sums_px += line_sum_px * line_sum_px;
                    (line, line_sum_px) = (sight.line, 0.0);
                }
                line_sum_px += off_px;
                residuals.fitting += 1;
                residuals.visible += sight.visibility;
                residuals.squared_px += off_px * off_px;
                if let Some(last_px) = last_px.filter(|_| sight.follows) {
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

/// Of the first M unknowns, whatever the others are, from the inverse of R.
fn covariance<const N: usize, const M: usize>(
    inverse: &SMatrix<f64, N, N>,
    spread: &SMatrix<f64, M, M>,
) -> SMatrix<f64, M, M> {
    let inverse = spread * inverse.fixed_rows::<M>(0);
    let covariance = inverse * inverse.transpose();
    (covariance + covariance.transpose()) * 0.5
}

/// How much a measurement counts.
struct Weighing {
    /// In its standard deviations.
    deviation: f64,
    cost: f64,
    /// Of its row, per radian.
    weight: f64,
}

impl Weighing {
    fn of(sight: &LineMeasurement, off_rad: f64, scale: f64, noise: Noise) -> Self {
        let sigma_rad = noise.sigma_px * sight.sigmas / sight.pixels_per_rad;
        let deviation = off_rad / sigma_rad;
        let u = deviation / scale;
        let robust = 1.0 / (1.0 + u * u);
        // Correlated neighbours share one vote.
        let vote = 1.0 / noise.correlated;
        let cost = vote * 0.5 * deviation * deviation * robust;
        Self { deviation, cost, weight: libm::sqrt(vote) * robust / sigma_rad }
    }

    /// In units of the prior, whose `spread` is lower triangular.
    fn row<const N: usize>(&self, gradient: &[f64; N], spread: &SMatrix<f64, N, N>) -> [f64; N] {
        core::array::from_fn(|j| {
            let column = spread.column(j);
            self.weight * (j..N).map(|i| gradient[i] * column[i]).sum::<f64>()
        })
    }
}

/// How far a ray is off its line.
struct Off {
    /// Angle between ray and plane.
    radians: f64,
    /// How that changes with the errors of the pose.
    by_pose: [f64; 6],
    /// Of the plane, in `map`.
    normal: DVec3,
}

impl LineMeasurement {
    fn off(&self, map_from_optical: &DMat3, camera: DVec3) -> Option<Off> {
        let ray = *map_from_optical * self.ray;
        let across = (self.point - camera).cross(self.tangent);
        let length = across.length();
        if length < 1e-9 {
            return None;
        }
        let normal = across / length;
        let turn = ray.cross(normal);
        let radians = ray.dot(normal);
        // The plane turns with the camera's place: its normal keeps its length.
        let shift = -self.tangent.cross(ray - normal * radians) / length;
        Some(Off { radians, by_pose: [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z], normal })
    }
}
