//! The particle filter of the paper: predict by odometry, then weigh and resample in rounds.

use serde::{Deserialize, Serialize};

use super::estimate::{Estimate, estimate};
use super::kernel::Points;
use super::motion::{self, MotionModel};
use super::observation::Observation;
use super::particles::{Particles, Spread};
use super::random::{Purpose, Stream};
use super::resampling::{self, Copies};
use super::sampling::{Bins, Sampling};
use super::weights::{self, Weights};
use realitysim_geometry::Pose2;
use realitysim_vision::GroundTable;

/// Settings of the particle filter.
#[derive(Clone, Debug, PartialEq)]
pub struct FilterSettings {
    /// Numbers of particles and of rounds.
    pub sampling: Sampling,
    /// Error of the prediction by odometry.
    pub motion: MotionModel,
    /// Noise added to the particles after the first round of a frame.
    pub jitter: Spread,
    /// Factor by which the noise shrinks from round to round.
    pub jitter_shrink: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// What a frame has cost so far, in poses weighed, which is the same on every machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effort {
    /// Particles of the last round, which the estimate is made of.
    pub particles: u32,
    /// Rounds of weighing and resampling.
    pub iterations: u32,
    /// Poses weighed in all rounds and in searching the field.
    pub weighed: u32,
    /// Whether fewer poses were weighed than wanted because time was up.
    pub capped: bool,
}

/// Decides whether a frame may go on; the argument is the number of poses weighed so far.
///
/// It is called before every [`BLOCK`] poses, so that it may ask a clock. Equal answers give equal results.
pub type TimeCheck<'a> = dyn FnMut(u32) -> bool + 'a;

/// A [`TimeCheck`] without a limit.
pub fn always(_weighed: u32) -> bool {
    true
}

/// Poses weighed between two calls of [`TimeCheck`]: some ten microseconds of work.
pub const BLOCK: usize = 64;

/// Everything that the next frame depends on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FilterState {
    /// The particles after the last frame.
    pub particles: Particles,
    /// Number of frames so far, a part of the key of every random number.
    pub steps: u64,
}

/// The particle filter of the robot's pose.
#[derive(Clone, Debug)]
pub struct Filter {
    settings: FilterSettings,
    observation: Observation,
    state: FilterState,
    workspace: Workspace,
    /// Number of weights so far that were NaN or +inf.
    unusable_weights: u64,
}

/// Buffers that are kept from frame to frame, so that a steady state allocates nothing.
#[derive(Clone, Debug, Default)]
struct Workspace {
    /// Line points that some particle may see.
    near: Points,
    weights: Weights,
    bins: Bins,
    copies: Copies,
    poses: Vec<Pose2>,
}

impl Filter {
    /// Makes a filter that goes on from `state`.
    pub fn new(settings: FilterSettings, observation: Observation, state: FilterState) -> Self {
        Self { settings, observation, state, workspace: Workspace::default(), unusable_weights: 0 }
    }

    /// The settings that the filter was made with.
    pub fn settings(&self) -> &FilterSettings {
        &self.settings
    }

    /// The observation model that weighs particles.
    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    /// The state after the last frame.
    pub fn state(&self) -> &FilterState {
        &self.state
    }

    /// Swaps the filter's state with `state`.
    pub fn exchange(&mut self, state: &mut FilterState) {
        core::mem::swap(&mut self.state, state);
    }

    /// Number of weights, since the filter was made, that were NaN or +inf, which no likelihood can be.
    pub fn unusable_weights(&self) -> u64 {
        self.unusable_weights
    }

    /// Replaces all particles by new ones around `pose`.
    pub fn restart(&mut self, pose: Pose2, spread: Spread) {
        let FilterSettings { sampling, seed, .. } = self.settings;
        self.state.particles = Particles::around(pose, spread, sampling.particles, seed, self.state.steps);
    }

    /// Adds noise to every particle.
    pub fn widen(&mut self, spread: Spread) {
        self.state.particles.scatter(spread, self.settings.seed, Purpose::Start, self.state.steps, 0);
    }

    /// Processes one frame: predicts the particles, then weighs and resamples them by the ground table of the camera.
    ///
    /// `step` is the robot's motion since the last frame, `seconds` ago, as odometry has it (`None` without odometry).
    pub fn step(
        &mut self,
        step: Option<Pose2>,
        seconds: f64,
        table: &GroundTable,
        effort: &mut Effort,
        has_time: &mut TimeCheck,
    ) -> Estimate {
        let FilterSettings { sampling, jitter, jitter_shrink, seed, .. } = self.settings;
        self.predict(step, seconds);
        let mut scale = 1.0;
        let mut round = 0;
        loop {
            self.weigh(table, effort, has_time);
            let Workspace { weights, bins, .. } = &mut self.workspace;
            weights::normalise_into(&self.state.particles.log_weights, weights);
            self.unusable_weights += weights.unusable as u64;
            let draws = sampling.needed(&self.state.particles, weights, bins);
            let settled = sampling.is_settled(round as usize + 1, weights);
            effort.capped |= !settled && !has_time(effort.weighed);
            let last = effort.capped || settled;
            let result = last.then(|| estimate(&self.state.particles, weights));
            self.resample(draws, round);
            if let Some(result) = result {
                return result;
            }
            let noise = Spread { xy_m: jitter.xy_m * scale, yaw_rad: jitter.yaw_rad * scale };
            self.state.particles.scatter(noise, seed, Purpose::Jitter, self.state.steps, round);
            scale *= jitter_shrink;
            round += 1;
        }
    }

    /// Processes a frame that shows nothing: particles are predicted and keep their weights.
    pub fn coast(&mut self, step: Option<Pose2>, seconds: f64) -> Estimate {
        self.predict(step, seconds);
        let weights = &mut self.workspace.weights;
        weights::normalise_into(&self.state.particles.log_weights, weights);
        estimate(&self.state.particles, weights)
    }

    /// Moves the particles by `step`, or by a random walk if there is no odometry.
    fn predict(&mut self, step: Option<Pose2>, seconds: f64) {
        let FilterSettings { motion, seed, .. } = self.settings;
        let FilterState { particles, steps } = &mut self.state;
        *steps += 1;
        match step {
            Some(step) => motion::predict(&motion, particles, step, seconds, seed, *steps),
            None => motion::wander(&motion, particles, seconds, seed, *steps),
        }
    }

    /// Weighs the particles. Those for which there is no time are dropped at regular intervals, so that the rest represents the whole set.
    fn weigh(&mut self, table: &GroundTable, effort: &mut Effort, has_time: &mut TimeCheck) {
        let Particles { poses, log_weights } = &mut self.state.particles;
        let near = &mut self.workspace.near;
        self.observation.look_near(table, poses, near);
        let blocks = poses.len().div_ceil(BLOCK).max(1);
        let mut weighed = 0;
        for block in 0..blocks {
            // The first block is weighed in any case.
            if block > 0 && !has_time(effort.weighed) {
                effort.capped = true;
                break;
            }
            for index in (block..poses.len()).step_by(blocks) {
                log_weights[index] = self.observation.log_likelihood_near(table, &poses[index], near);
            }
            effort.weighed += (poses.len() - block).div_ceil(blocks) as u32;
            weighed = block + 1;
        }
        if weighed < blocks {
            keep_each(poses, blocks, weighed);
            keep_each(log_weights, blocks, weighed);
        }
        effort.particles = poses.len() as u32;
        effort.iterations += 1;
    }

    fn resample(&mut self, draws: usize, round: u32) {
        let mut draw = Stream::new(self.settings.seed, Purpose::Resampling, self.state.steps, round, 0);
        let Workspace { weights, copies, poses, .. } = &mut self.workspace;
        resampling::residual(weights, draws, &mut draw, copies);
        self.state.particles.duplicate(&copies.counts, poses);
    }
}

/// Keeps the first `kept` values of every `step` values.
fn keep_each<T>(values: &mut Vec<T>, step: usize, kept: usize) {
    let mut index = 0;
    values.retain(|_| {
        index += 1;
        (index - 1) % step < kept
    });
}
