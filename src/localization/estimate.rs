//! What a weighted set of particles says about the pose.

use nalgebra::{Matrix2, Matrix3, SymmetricEigen, Vector3};

use super::particles::Particles;
use super::weights::Weights;
use crate::geometry::{Pose2, wrap_angle};

/// The filter's answer for one frame: `base_footprint` in `map`.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// The particle of the highest weight: the paper's answer.
    pub best: Pose2,
    /// Of x, y, yaw, about the best particle, over the particles near it.
    pub covariance: Matrix3<f64>,
    /// Standard deviation along the longer axis.
    pub spread_m: f64,
    pub spread_yaw_rad: f64,
    pub effective_sample_size: f64,
    /// Log of the mean weight.
    pub evidence: f64,
    pub degenerate: bool,
}

/// Particles farther than this from the best one belong to another hypothesis.
const NEAR_M: f64 = 0.5;
const NEAR_RAD: f64 = 0.5;

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
