//! Prediction from the previous frame: every particle makes the step that odometry reports, plus its own error.

use serde::{Deserialize, Serialize};

use super::particles::Particles;
use super::random::{Purpose, Stream};
use crate::geometry::{Pose2, wrap_angle};

/// How wrong a step of odometry can be. Walking robots slip: 10 to 30 % is normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionModel {
    /// Error of the distance walked, as a share of it.
    pub distance_share: f64,
    /// Error of the turn, as a share of it.
    pub turn_share: f64,
    /// Error of the direction, radians for each metre walked.
    pub turn_rad_per_m: f64,
    /// What is added each second even when standing.
    pub drift_m_per_sqrt_s: f64,
    pub drift_rad_per_sqrt_s: f64,
}

impl Default for MotionModel {
    fn default() -> Self {
        Self {
            distance_share: 0.25,
            turn_share: 0.2,
            turn_rad_per_m: 0.2,
            drift_m_per_sqrt_s: 0.04,
            drift_rad_per_sqrt_s: 0.035,
        }
    }
}

impl MotionModel {
    /// `step` is `footprint_then_from_footprint_now` as odometry has it, `seconds` the time it took.
    pub fn predict(&self, particles: &mut Particles, step: Pose2, seconds: f64, seed: u64, frame: u64) {
        let distance = libm::hypot(step.x, step.y);
        let root = libm::sqrt(seconds.max(0.0));
        let along = self.distance_share * distance;
        let rest = self.drift_m_per_sqrt_s * root;
        let xy = libm::hypot(along, rest);
        let turn = self.turn_share * step.yaw.abs() + self.turn_rad_per_m * distance;
        let turn = libm::hypot(turn, self.drift_rad_per_sqrt_s * root);
        for (index, pose) in particles.poses.iter_mut().enumerate() {
            let mut draw = Stream::new(seed, Purpose::Motion, frame, 0, index as u32);
            let [dx, dy] = draw.normal_pair();
            let [dyaw, _] = draw.normal_pair();
            let moved = Pose2::new(step.x + dx * xy, step.y + dy * xy, wrap_angle(step.yaw + dyaw * turn));
            *pose = pose.compose(&moved);
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
        };
        let mut particles =
            Particles { poses: vec![Pose2::new(1.0, 2.0, core::f64::consts::FRAC_PI_2); 3], log_weights: vec![0.0; 3] };
        quiet.predict(&mut particles, Pose2::new(0.5, 0.1, 0.2), 0.1, 1, 1);
        for pose in &particles.poses {
            assert!((pose.x - 0.9).abs() < 1e-12 && (pose.y - 2.5).abs() < 1e-12);
        }
    }

    #[test]
    fn standing_still_spreads_with_the_root_of_time() {
        let spread = |seconds| {
            let mut particles = Particles { poses: vec![Pose2::default(); 4000], log_weights: vec![0.0; 4000] };
            MotionModel::default().predict(&mut particles, Pose2::default(), seconds, 1, 1);
            libm::sqrt(particles.poses.iter().map(|p| p.x * p.x).sum::<f64>() / 4000.0)
        };
        assert!((spread(1.0) - 0.04).abs() < 0.003);
        assert!((spread(4.0) - 0.08).abs() < 0.006);
        assert_eq!(spread(0.0), 0.0);
    }
}
