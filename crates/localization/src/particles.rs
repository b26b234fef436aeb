//! Particles: samples of the robot's pose, x, y and yaw of `base_footprint` in `map`.

use serde::{Deserialize, Serialize};

use super::random::{Purpose, TOGETHER, normals};
use realitysim_geometry::{Physical, Pose2, wrap_angle};

/// A set of weighted particles.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Particles {
    /// Pose of each particle.
    pub poses: Vec<Pose2>,
    /// Natural logarithm of each particle's weight, not normalised: if all are 0, all particles weigh the same.
    pub log_weights: Vec<f64>,
}

/// Standard deviations of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Standard deviation of x and of y, metres.
    pub xy_m: f64,
    /// Standard deviation of yaw, radians.
    pub yaw_rad: f64,
}

impl Physical for Particles {
    fn is_possible(&self) -> bool {
        let is_weight = |log_weight: &f64| *log_weight < f64::INFINITY;
        self.poses.len() == self.log_weights.len() && self.poses.is_possible() && self.log_weights.iter().all(is_weight)
    }
}

impl Particles {
    /// Number of particles.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there are no particles.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Draws `count` particles around `pose`, all of the same weight. `seed` and `step` key the random numbers.
    pub fn around(pose: Pose2, spread: Spread, count: usize, seed: u64, step: u64) -> Self {
        let mut particles = Self { poses: vec![pose; count], log_weights: vec![0.0; count] };
        particles.scatter(spread, seed, Purpose::Start, step, 0);
        particles
    }

    /// Adds normal noise to every pose. `seed`, `purpose`, `step` and `iteration` key the random numbers.
    pub fn scatter(&mut self, spread: Spread, seed: u64, purpose: Purpose, step: u64, iteration: u32) {
        for (block, poses) in self.poses.chunks_mut(TOGETHER).enumerate() {
            let [dx, dy, turn] = normals(seed, purpose, step, iteration, (block * TOGETHER) as u32);
            for (i, pose) in poses.iter_mut().enumerate() {
                pose.x += dx[i] * spread.xy_m;
                pose.y += dy[i] * spread.xy_m;
                pose.yaw = wrap_angle(pose.yaw + turn[i] * spread.yaw_rad);
            }
        }
    }

    /// Replaces the set by `counts[i]` copies of particle i, all of the same weight. The old poses are left in `spare`.
    pub fn duplicate(&mut self, counts: &[u32], spare: &mut Vec<Pose2>) {
        spare.clear();
        for (pose, count) in self.poses.iter().zip(counts) {
            spare.extend(core::iter::repeat_n(*pose, *count as usize));
        }
        core::mem::swap(&mut self.poses, spare);
        self.log_weights.clear();
        self.log_weights.resize(self.poses.len(), 0.0);
    }
}
