//! `[filter]`: how the pose of a frame is estimated, and when its tag is valid.

use serde::{Deserialize, Serialize};

use super::check_range;
use realitysim_localization::{Formula, Model, SimdPath};

/// Smallest time budget of a frame, milliseconds; no frame can be located in less.
pub const MIN_BUDGET_MS: f64 = 0.1;

/// The source of the robot's motion between two frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionSource {
    /// Odometry reports each step.
    #[default]
    Odometry,
    /// Only the greatest speed of the robot is known.
    RandomWalk,
}

/// Settings of the particle filter, of refinement, and of the checks that make a tag valid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilterConfig {
    /// Observation model: Eq. 2 (`gauss`) or Eq. 1 (`distance`) of the paper.
    pub model: Model,
    /// Formula of the weights: corrected, or as the paper prints it.
    pub formula: Formula,
    /// Number of particles (N of the paper); while adaptive, the largest number.
    pub particles: usize,
    /// Rounds of weighting and resampling per frame (T of the paper); while adaptive, the largest number.
    pub iterations: usize,
    /// Whether a frame gets fewer particles (KLD-sampling) and iterations (effective sample size) where these suffice.
    pub adaptive: bool,
    /// Smallest number of particles while adaptive.
    pub particles_min: usize,
    /// Time from the decoded image to the tag, milliseconds, kept by weighing fewer particles; 0: no limit.
    pub budget_ms: f64,
    /// Approximate number of points that stand for all lines of the field.
    pub line_points: usize,
    /// Scale of the exponent of Eq. 1 and 2; each formula has its own default.
    pub alpha: Option<f64>,
    /// Seed of all random numbers; the same seed gives the same tags.
    pub seed: u64,
    /// Source of the motion between two frames.
    pub motion: MotionSource,
    /// Instruction set of the kernels; the tags do not depend on it.
    pub simd: SimdPath,
    /// Standard deviation of the particles around an initial pose, in x and in y, metres.
    pub initial_xy_m: f64,
    /// Standard deviation of the particles around an initial pose, yaw in degrees.
    pub initial_yaw_deg: f64,
    /// Noise after the first resampling of a frame, in x and in y, metres.
    pub jitter_xy_m: f64,
    /// Noise after the first resampling of a frame, yaw in degrees.
    pub jitter_yaw_deg: f64,
    /// Noise after each further resampling of a frame, as a share of the noise before it.
    pub jitter_shrink: f64,
    /// Expected error of roll and pitch, degrees; a place that it moves far counts less.
    pub tilt_sigma_deg: f64,
    /// Factor by which the image is reduced before it is searched for lines; 0: chosen for the lens.
    pub image_reduction: usize,
    /// Unrefined poses: smallest share of the expected line contrast that makes a tag valid, 0 to 1.
    pub valid_share: f64,
    /// Unrefined poses: shortest line in view that makes a tag valid, counted by its certainty, units of 10 cm.
    pub valid_points: f64,
    /// Unrefined poses: greatest standard deviation of the particles at which a tag is valid, metres.
    pub valid_spread_m: f64,
    /// Whether the pose is refined by least squares; without it the best particle is the tag.
    pub refinement: bool,
    /// Refined poses: greatest standard deviation along the longer axis at which a tag is valid, metres.
    pub valid_refined_m: f64,
}

impl FilterConfig {
    pub(super) fn check(&self) -> Result<(), String> {
        check_range("filter.particles", self.particles as f64, 1.0, (1 << 20) as f64)?;
        check_range("filter.iterations", self.iterations as f64, 1.0, 1000.0)?;
        check_range("filter.particles_min", self.particles_min as f64, 1.0, (1 << 20) as f64)?;
        if self.budget_ms != 0.0 {
            check_range("filter.budget_ms", self.budget_ms, MIN_BUDGET_MS, 10_000.0)?;
        }
        check_range("filter.line_points", self.line_points as f64, 10.0, 100_000.0)?;
        if let Some(alpha) = self.alpha {
            check_range("filter.alpha (its size)", alpha.abs(), 1e-9, 1e12)?;
        }
        check_range("filter.initial_xy_m", self.initial_xy_m, 0.0, 100.0)?;
        check_range("filter.initial_yaw_deg", self.initial_yaw_deg, 0.0, 360.0)?;
        check_range("filter.jitter_xy_m", self.jitter_xy_m, 0.0, 10.0)?;
        check_range("filter.jitter_yaw_deg", self.jitter_yaw_deg, 0.0, 180.0)?;
        check_range("filter.jitter_shrink", self.jitter_shrink, 0.0, 1.0)?;
        check_range("filter.tilt_sigma_deg", self.tilt_sigma_deg, 0.0, 45.0)?;
        check_range("filter.image_reduction", self.image_reduction as f64, 0.0, 8.0)?;
        check_range("filter.valid_share", self.valid_share, 0.0, 1.0)?;
        check_range("filter.valid_points", self.valid_points, 0.0, 1e6)?;
        check_range("filter.valid_spread_m", self.valid_spread_m, 0.0, 100.0)?;
        check_range("filter.valid_refined_m", self.valid_refined_m, 0.0, 100.0)?;
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
            tilt_sigma_deg: 0.7,
            image_reduction: 0,
            valid_share: 0.35,
            valid_points: 8.0,
            valid_spread_m: 0.25,
            refinement: true,
            valid_refined_m: 0.07,
        }
    }
}
