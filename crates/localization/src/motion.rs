//! Prediction from the previous frame: every particle makes the step that odometry reports, plus a random error of its own.

use serde::{Deserialize, Serialize};

use super::particles::{Particles, Spread};
use super::random::{Purpose, TOGETHER, normals};
use realitysim_geometry::{Pose2, wrap_angle};

/// Standard deviations of a step of odometry. Walking robots slip: 10 to 30 % is normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionModel {
    /// Error of the distance walked, as a share of it.
    pub distance_share: f64,
    /// Error of the turn, as a share of it.
    pub turn_share: f64,
    /// Error of the heading, radians for each metre walked.
    pub turn_rad_per_m: f64,
    /// Error of the position that grows with time, even when standing, metres per root of a second.
    pub drift_m_per_sqrt_s: f64,
    /// Error of the heading that grows with time, even when standing, radians per root of a second.
    pub drift_rad_per_sqrt_s: f64,
    /// Speed of the robot where there is no odometry (`motion = "random_walk"`), metres per second.
    pub walk_m_per_s: f64,
    /// Turning rate of the robot where there is no odometry, radians per second.
    pub turn_rad_per_s: f64,
}

impl Default for MotionModel {
    fn default() -> Self {
        Self {
            distance_share: 0.25,
            turn_share: 0.2,
            turn_rad_per_m: 0.2,
            drift_m_per_sqrt_s: 0.04,
            drift_rad_per_sqrt_s: 0.035,
            walk_m_per_s: 0.4,
            turn_rad_per_s: 1.0,
        }
    }
}

/// Moves each particle by a step of odometry and a random error.
///
/// `step` is `footprint_then_from_footprint_now` as odometry has it, `seconds` the time it took. `seed` and `frame` key the random numbers.
pub fn predict(model: &MotionModel, particles: &mut Particles, step: Pose2, seconds: f64, seed: u64, frame: u64) {
    let distance = libm::hypot(step.x, step.y);
    let root = libm::sqrt(seconds.max(0.0));
    let xy = libm::hypot(model.distance_share * distance, model.drift_m_per_sqrt_s * root);
    let turn = model.turn_share * step.yaw.abs() + model.turn_rad_per_m * distance;
    let turn = libm::hypot(turn, model.drift_rad_per_sqrt_s * root);
    diffuse(particles, step, Spread { xy_m: xy, yaw_rad: turn }, seed, frame);
}

/// Moves each particle by a random walk, as far as the robot can get in `seconds` without odometry.
pub fn wander(model: &MotionModel, particles: &mut Particles, seconds: f64, seed: u64, frame: u64) {
    let seconds = seconds.max(0.0);
    let spread = Spread { xy_m: model.walk_m_per_s * seconds, yaw_rad: model.turn_rad_per_s * seconds };
    diffuse(particles, Pose2::default(), spread, seed, frame);
}

/// Moves each particle by `step` and normal noise of standard deviation `spread`, both along the particle's own axes.
fn diffuse(particles: &mut Particles, step: Pose2, spread: Spread, seed: u64, frame: u64) {
    for (block, poses) in particles.poses.chunks_mut(TOGETHER).enumerate() {
        let [dx, dy, turn] = normals(seed, Purpose::Motion, frame, 0, (block * TOGETHER) as u32);
        for (i, pose) in poses.iter_mut().enumerate() {
            let turned = wrap_angle(step.yaw + turn[i] * spread.yaw_rad);
            *pose = pose.compose(&Pose2::new(step.x + dx[i] * spread.xy_m, step.y + dy[i] * spread.xy_m, turned));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_noise_every_particle_makes_the_step() {
        let quiet = MotionModel {
            distance_share: 0.0,
            turn_share: 0.0,
            turn_rad_per_m: 0.0,
            drift_m_per_sqrt_s: 0.0,
            drift_rad_per_sqrt_s: 0.0,
            ..MotionModel::default()
        };
        let mut particles =
            Particles { poses: vec![Pose2::new(1.0, 2.0, core::f64::consts::FRAC_PI_2); 3], log_weights: vec![0.0; 3] };
        predict(&quiet, &mut particles, Pose2::new(0.5, 0.1, 0.2), 0.1, 1, 1);
        for pose in &particles.poses {
            assert!((pose.x - 0.9).abs() < 1e-12 && (pose.y - 2.5).abs() < 1e-12);
        }
    }

    #[test]
    fn standing_still_spreads_with_the_root_of_time() {
        let spread = |seconds| {
            let mut particles = Particles { poses: vec![Pose2::default(); 4000], log_weights: vec![0.0; 4000] };
            predict(&MotionModel::default(), &mut particles, Pose2::default(), seconds, 1, 1);
            libm::sqrt(particles.poses.iter().map(|p| p.x * p.x).sum::<f64>() / 4000.0)
        };
        assert!((spread(1.0) - 0.04).abs() < 0.003);
        assert!((spread(4.0) - 0.08).abs() < 0.006);
        assert_eq!(spread(0.0), 0.0);
    }
}
