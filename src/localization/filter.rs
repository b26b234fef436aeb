//! The filter's loop, as the paper has it.

use serde::{Deserialize, Serialize};

use super::estimate::{Estimate, estimate};
use super::kernel::Points;
use super::motion::{self, MotionModel};
use super::observation::Observation;
use super::particles::{Particles, Spread};
use super::random::{Purpose, Stream};
use super::{resampling, weights};
use crate::geometry::Pose2;
use crate::vision::GroundTable;

#[derive(Clone, Debug, PartialEq)]
pub struct FilterSettings {
    /// N of the paper.
    pub particles: usize,
    /// T of the paper.
    pub iterations: usize,
    pub motion: MotionModel,
    /// Noise added after the first resampling of a frame; each further one adds `jitter_shrink` of the one before.
    pub jitter: Spread,
    pub jitter_shrink: f64,
    pub seed: u64,
}

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
    /// The line points that are looked at.
    scratch: Points,
}

impl Filter {
    pub fn new(settings: FilterSettings, observation: Observation, state: FilterState) -> Self {
        Self { settings, observation, state, scratch: Points::default() }
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

    /// Starts over around a pose.
    pub fn restart(&mut self, pose: Pose2, spread: Spread) {
        let FilterSettings { particles, seed, .. } = self.settings;
        self.state.particles = Particles::around(pose, spread, particles, seed, self.state.steps);
    }

    /// Widens the set where it stands.
    pub fn widen(&mut self, spread: Spread) {
        self.state.particles.scatter(spread, self.settings.seed, Purpose::Start, self.state.steps, 0);
    }

    /// One frame: what odometry says of the `seconds` since the last one, then what the camera sees.
    pub fn step(&mut self, step: Option<Pose2>, seconds: f64, table: &GroundTable) -> Estimate {
        let FilterSettings { jitter, jitter_shrink, seed, .. } = self.settings;
        let last = self.settings.iterations.saturating_sub(1) as u32;
        self.predict(step, seconds);
        let mut scale = 1.0;
        for iteration in 0..last {
            self.weigh(table);
            self.resample(iteration);
            let noise = Spread { xy_m: jitter.xy_m * scale, yaw_rad: jitter.yaw_rad * scale };
            self.state.particles.scatter(noise, seed, Purpose::Jitter, self.state.steps, iteration);
            scale *= jitter_shrink;
        }
        self.weigh(table);
        let result = self.estimate();
        self.resample(last);
        result
    }

    /// A frame that shows nothing: the particles only move.
    pub fn coast(&mut self, step: Option<Pose2>, seconds: f64) -> Estimate {
        self.predict(step, seconds);
        self.estimate()
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

    fn estimate(&self) -> Estimate {
        estimate(&self.state.particles, &weights::normalise(&self.state.particles.log_weights))
    }

    fn weigh(&mut self, table: &GroundTable) {
        let Particles { poses, log_weights } = &mut self.state.particles;
        self.observation.log_likelihoods(table, poses, &mut self.scratch, log_weights);
    }

    fn resample(&mut self, iteration: u32) {
        let FilterSettings { particles, seed, .. } = self.settings;
        let mut draw = Stream::new(seed, Purpose::Resampling, self.state.steps, iteration, 0);
        let counts = resampling::residual(&self.state.particles.log_weights, particles, &mut draw);
        self.state.particles.duplicate(&counts);
    }
}
