//! `[filter]`: how a frame is located, and when its tag is valid.

use serde::{Deserialize, Serialize};

use super::within;
use realitysim_localization::{Formula, Model, SimdPath};

/// No frame can be located in less.
pub const LEAST_BUDGET_MS: f64 = 0.1;

/// Where the step between two frames comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionSource {
    #[default]
    Odometry,
    /// Nothing is known but how fast the robot can be.
    RandomWalk,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilterConfig {
    pub model: Model,
    pub formula: Formula,
    /// N of the paper.
    pub particles: usize,
    /// T of the paper.
    pub iterations: usize,
    /// Fewer particles and iterations where fewer do: [`Self::particles`] and [`Self::iterations`] are the most.
    pub adaptive: bool,
    /// The least, while adaptive.
    pub particles_min: usize,
    /// From the decoded image to the tag; what is over is saved by fewer particles. 0: no limit.
    pub budget_ms: f64,
    /// About how many points stand for all lines of the field.
    pub line_points: usize,
    /// Scale of the exponent of Eq. 1 and 2; each formula has its own default.
    pub alpha: Option<f64>,
    pub seed: u64,
    pub motion: MotionSource,
    pub simd: SimdPath,
    /// Particles at the start, around the initial pose.
    pub initial_xy_m: f64,
    pub initial_yaw_deg: f64,
    /// Noise between the iterations of a frame; each adds `jitter_shrink` of the one before.
    pub jitter_xy_m: f64,
    pub jitter_yaw_deg: f64,
    pub jitter_shrink: f64,
    /// Half the side of the robot-centred ground table; 0: seven times the camera's height, 3 to 8 m.
    pub range_m: f64,
    /// Expected error of roll and pitch; what it moves far counts less.
    pub tilt_sigma_deg: f64,
    /// How far the distance model looks for white.
    pub nearest_reach_m: f64,
    /// Images are looked at in a copy that is this many times smaller; 0: as the lens demands.
    pub image_reduction: usize,
    /// A tag is valid when at least this share of the expected line contrast is found ...
    pub valid_share: f64,
    /// ... on at least this much certain line, in units of 10 cm ...
    pub valid_points: f64,
    /// ... and the particles are this close together.
    pub valid_spread_m: f64,
    /// Whether the pose is refined by least squares; without it the best particle is the tag.
    pub refinement: bool,
    /// A refined pose is valid up to this standard deviation along its longer axis.
    pub valid_refined_m: f64,
    /// ... and with at least this share of the line seen where the field has one.
    pub valid_explained: f64,
}

impl FilterConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        within("filter.particles", self.particles as f64, 1.0, (1 << 20) as f64)?;
        within("filter.iterations", self.iterations as f64, 1.0, 1000.0)?;
        within("filter.particles_min", self.particles_min as f64, 1.0, (1 << 20) as f64)?;
        if self.budget_ms != 0.0 {
            within("filter.budget_ms", self.budget_ms, LEAST_BUDGET_MS, 10_000.0)?;
        }
        within("filter.line_points", self.line_points as f64, 10.0, 100_000.0)?;
        if let Some(alpha) = self.alpha {
            within("filter.alpha (its size)", alpha.abs(), 1e-9, 1e12)?;
        }
        within("filter.initial_xy_m", self.initial_xy_m, 0.0, 100.0)?;
        within("filter.initial_yaw_deg", self.initial_yaw_deg, 0.0, 360.0)?;
        within("filter.jitter_xy_m", self.jitter_xy_m, 0.0, 10.0)?;
        within("filter.jitter_yaw_deg", self.jitter_yaw_deg, 0.0, 180.0)?;
        within("filter.jitter_shrink", self.jitter_shrink, 0.0, 1.0)?;
        if self.range_m != 0.0 {
            within("filter.range_m", self.range_m, 0.5, 50.0)?;
        }
        within("filter.tilt_sigma_deg", self.tilt_sigma_deg, 0.0, 45.0)?;
        within("filter.nearest_reach_m", self.nearest_reach_m, 0.02, 5.0)?;
        within("filter.image_reduction", self.image_reduction as f64, 0.0, 8.0)?;
        within("filter.valid_share", self.valid_share, 0.0, 1.0)?;
        within("filter.valid_points", self.valid_points, 0.0, 1e6)?;
        within("filter.valid_spread_m", self.valid_spread_m, 0.0, 100.0)?;
        within("filter.valid_refined_m", self.valid_refined_m, 0.0, 100.0)?;
        within("filter.valid_explained", self.valid_explained, 0.0, 1.0)?;
        Ok(())
    }
}

impl Default for FilterConfig {
    fn default() -> Self {
        Self {
            model: Model::Gauss,
            formula: Formula::Corrected,
            particles: 800,
            iterations: 5,
            adaptive: true,
            particles_min: 100,
            budget_ms: 0.0,
            line_points: 350,
            alpha: None,
            seed: 1,
            motion: MotionSource::Odometry,
            simd: SimdPath::Auto,
            initial_xy_m: 0.15,
            initial_yaw_deg: 5.0,
            jitter_xy_m: 0.04,
            jitter_yaw_deg: 1.5,
            jitter_shrink: 0.6,
            range_m: 0.0,
            tilt_sigma_deg: 0.7,
            nearest_reach_m: 0.25,
            image_reduction: 0,
            valid_share: 0.35,
            valid_points: 8.0,
            valid_spread_m: 0.25,
            refinement: true,
            valid_refined_m: 0.07,
            valid_explained: 0.7,
        }
    }
}
