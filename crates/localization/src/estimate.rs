//! What a weighted set of particles says about the pose.

use nalgebra::{Matrix2, Matrix3, Matrix6, SymmetricEigen, Vector3};

use super::particles::Particles;
use super::weights::Weights;
use realitysim_geometry::{Pose2, wrap_angle};

/// The filter's answer for one frame: `base_footprint` in `map`.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The particle of the highest weight: the paper's answer.
    pub best: Pose2,
    /// Covariance of x, y (m) and yaw (rad) about the best particle, over the particles near it.
    pub covariance: Matrix3<f64>,
    /// Standard deviation of the position along its longer axis, metres.
    pub spread_m: f64,
    /// Standard deviation of yaw, radians.
    pub spread_yaw_rad: f64,
    /// Effective sample size: the reciprocal of the sum of squared normalised weights, between 1 and the number of particles.
    pub effective_sample_size: f64,
    /// Natural logarithm of the mean weight.
    pub evidence: f64,
    /// Whether no particle had a usable weight.
    pub degenerate: bool,
}

/// Particles farther than this from the best one belong to another hypothesis, metres.
const NEAR_M: f64 = 0.5;
/// Particles turned by more than this from the best one belong to another hypothesis, radians.
const NEAR_RAD: f64 = 0.5;

/// Estimates the pose from particles and their normalised weights: the best particle, and the covariance of those near it.
pub fn estimate(particles: &Particles, weights: &Weights) -> Estimate {
    let best = particles.poses.get(weights.best).copied().unwrap_or_default();
    let mut covariance = Matrix3::zeros();
    let mut mass = 0.0;
    for (pose, share) in particles.poses.iter().zip(&weights.shares) {
        let off = Vector3::new(pose.x - best.x, pose.y - best.y, wrap_angle(pose.yaw - best.yaw));
        if off.xy().norm() < NEAR_M && off.z.abs() < NEAR_RAD {
            covariance += *share * off * off.transpose();
            mass += share;
        }
    }
    if mass > 0.0 {
        covariance /= mass;
    }
    // Products of three factors are not rounded alike on both sides of the diagonal.
    covariance.fill_upper_triangle_with_lower_triangle();
    let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
    let longest = SymmetricEigen::new(plane).eigenvalues.max().max(0.0);
    Estimate {
        best,
        covariance,
        spread_m: libm::sqrt(longest),
        spread_yaw_rad: libm::sqrt(covariance[(2, 2)].max(0.0)),
        effective_sample_size: weights.effective_sample_size,
        evidence: weights.evidence,
        degenerate: weights.degenerate,
    }
}

/// Standard deviation of the height, which particles do not hold, metres.
const HEIGHT_SIGMA_M: f64 = 0.01;
/// Standard deviation of roll and pitch, which particles do not hold, radians.
const TILT_SIGMA_RAD: f64 = 0.012;
/// Standard deviation of x and y that the unknown tilt adds, metres.
const POSITION_FLOOR_M: f64 = 0.025;
/// Standard deviation of yaw that the unknown tilt adds, radians.
const YAW_FLOOR_RAD: f64 = 0.008;

impl Estimate {
    /// The estimate of a filter that has no particles.
    pub fn unknown() -> Self {
        Self {
            best: Pose2::default(),
            covariance: Matrix3::zeros(),
            spread_m: 0.0,
            spread_yaw_rad: 0.0,
            effective_sample_size: 0.0,
            evidence: 0.0,
            degenerate: false,
        }
    }

    /// The 6 x 6 covariance of x, y, z (m) and of the rotation about x, y, z (rad).
    ///
    /// Particles give x, y and yaw, to which a floor is added; height, roll and pitch have fixed variances.
    pub fn pose_covariance(&self) -> Matrix6<f64> {
        let mut result = Matrix6::zeros();
        let from = [0, 1, 5];
        for (i, row) in from.into_iter().enumerate() {
            for (j, column) in from.into_iter().enumerate() {
                result[(row, column)] = self.covariance[(i, j)];
            }
        }
        for (index, sigma) in [
            (0, POSITION_FLOOR_M),
            (1, POSITION_FLOOR_M),
            (2, HEIGHT_SIGMA_M),
            (3, TILT_SIGMA_RAD),
            (4, TILT_SIGMA_RAD),
            (5, YAW_FLOOR_RAD),
        ] {
            result[(index, index)] += sigma * sigma;
        }
        result
    }
}
