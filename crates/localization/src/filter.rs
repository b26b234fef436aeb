//! The filter's loop, as the paper has it.

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

#[derive(Clone, Debug, PartialEq)]
pub struct FilterSettings {
    pub sampling: Sampling,
    pub motion: MotionModel,
    /// Noise added after the first resampling of a frame; each further one adds `jitter_shrink` of the one before.
    pub jitter: Spread,
    pub jitter_shrink: f64,
    pub seed: u64,
}

/// What a frame has cost so far, in poses weighed: the same on every machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effort {
    /// That the estimate is made of: those of the last round.
    pub particles: u32,
    pub iterations: u32,
    /// In all rounds, and in searching the field.
    pub weighed: u32,
    /// Less was weighed than wanted, because time was up.
    pub capped: bool,
}

/// Says whether a frame that has weighed so many poses may go on. Asked before every [`BLOCK`] poses, so that a
/// clock can be behind it; a frame is the same again if it says the same again.
pub type MayGoOn<'a> = dyn FnMut(u32) -> bool + 'a;

/// No limit.
pub fn always(_weighed: u32) -> bool {
    true
}

/// Poses weighed between two looks at the clock: some ten microseconds.
pub const BLOCK: usize = 64;

/// All that the next frame depends on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FilterState {
    pub particles: Particles,
    /// Frames so far: part of the key of every random number.
    pub steps: u64,
}

#[derive(Clone, Debug)]
pub struct Filter {
    settings: FilterSettings,
    observation: Observation,
    state: FilterState,
    workspace: Workspace,
    /// Weights so far that were NaN or +inf.
    unusable_weights: u64,
}

/// What a frame is worked out in, kept from frame to frame: a steady state allocates nothing.
#[derive(Clone, Debug, Default)]
struct Workspace {
    /// The line points that are looked at.
    near: Points,
    weights: Weights,
    bins: Bins,
    copies: Copies,
    poses: Vec<Pose2>,
}

impl Filter {
    pub fn new(settings: FilterSettings, observation: Observation, state: FilterState) -> Self {
        Self { settings, observation, state, workspace: Workspace::default(), unusable_weights: 0 }
    }

    pub fn settings(&self) -> &FilterSettings {
        &self.settings
    }

    pub fn observation(&self) -> &Observation {
        &self.observation
    }

    pub fn state(&self) -> &FilterState {
        &self.state
    }

    /// Goes on from there, and hands over where it was.
    pub fn exchange(&mut self, state: &mut FilterState) {
        core::mem::swap(&mut self.state, state);
    }

    /// Weights since it was made that were NaN or +inf, which no likelihood is.
    pub fn unusable_weights(&self) -> u64 {
        self.unusable_weights
    }

    /// Starts over around a pose.
    pub fn restart(&mut self, pose: Pose2, spread: Spread) {
        let FilterSettings { sampling, seed, .. } = self.settings;
        self.state.particles = Particles::around(pose, spread, sampling.particles, seed, self.state.steps);
    }

    /// Widens the set where it stands.
    pub fn widen(&mut self, spread: Spread) {
        self.state.particles.scatter(spread, self.settings.seed, Purpose::Start, self.state.steps, 0);
    }

    /// One frame: what odometry says of the `seconds` since the last one, then what the camera sees.
    pub fn step(
        &mut self,
        step: Option<Pose2>,
        seconds: f64,
        table: &GroundTable,
        effort: &mut Effort,
        may_go_on: &mut MayGoOn,
    ) -> Estimate {
        let FilterSettings { sampling, jitter, jitter_shrink, seed, .. } = self.settings;
        self.predict(step, seconds);
        let mut scale = 1.0;
        let mut round = 0;
        loop {
            self.weigh(table, effort, may_go_on);
            let Workspace { weights, bins, .. } = &mut self.workspace;
            weights::normalise_into(&self.state.particles.log_weights, weights);
            self.unusable_weights += weights.unusable as u64;
            let draws = sampling.needed(&self.state.particles, weights, bins);
            let settled = sampling.is_settled(round as usize + 1, weights);
            effort.capped |= !settled && !may_go_on(effort.weighed);
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

    /// A frame that shows nothing: the particles only move.
    pub fn coast(&mut self, step: Option<Pose2>, seconds: f64) -> Estimate {
        self.predict(step, seconds);
        let weights = &mut self.workspace.weights;
        weights::normalise_into(&self.state.particles.log_weights, weights);
        estimate(&self.state.particles, weights)
    }

    /// `step` as odometry has it; without odometry each particle goes its own way.
    fn predict(&mut self, step: Option<Pose2>, seconds: f64) {
        let FilterSettings { motion, seed, .. } = self.settings;
        let FilterState { particles, steps } = &mut self.state;
        *steps += 1;
        match step {
            Some(step) => motion::predict(&motion, particles, step, seconds, seed, *steps),
            None => motion::wander(&motion, particles, seconds, seed, *steps),
        }
    }

    /// Particles for which there is no time are dropped: every so many, so that what remains stands for the whole.
    fn weigh(&mut self, table: &GroundTable, effort: &mut Effort, may_go_on: &mut MayGoOn) {
        let Particles { poses, log_weights } = &mut self.state.particles;
        let near = &mut self.workspace.near;
        self.observation.look_near(table, poses, near);
        let blocks = poses.len().div_ceil(BLOCK).max(1);
        let mut weighed = 0;
        for block in 0..blocks {
            // The first block is what a frame costs at least.
            if block > 0 && !may_go_on(effort.weighed) {
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

/// Keeps the first `kept` of every `step` values.
fn keep_each<T>(values: &mut Vec<T>, step: usize, kept: usize) {
    let mut index = 0;
    values.retain(|_| {
        index += 1;
        (index - 1) % step < kept
    });
}
