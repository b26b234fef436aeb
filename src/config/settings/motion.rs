//! `[motion]`: what odometry is worth.

use serde::{Deserialize, Serialize};

use super::within;

/// How wrong a step of odometry can be. Walking robots slip: 10 to 30 % is normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
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
    /// With `motion = "random_walk"`: how fast the robot is.
    pub walk_m_per_s: f64,
    pub turn_rad_per_s: f64,
}

impl MotionModel {
    pub(super) fn check(&self) -> Result<(), String> {
        for (key, value) in [
            ("motion.distance_share", self.distance_share),
            ("motion.turn_share", self.turn_share),
            ("motion.turn_rad_per_m", self.turn_rad_per_m),
            ("motion.drift_m_per_sqrt_s", self.drift_m_per_sqrt_s),
            ("motion.drift_rad_per_sqrt_s", self.drift_rad_per_sqrt_s),
            ("motion.walk_m_per_s", self.walk_m_per_s),
            ("motion.turn_rad_per_s", self.turn_rad_per_s),
        ] {
            within(key, value, 0.0, 100.0)?;
        }
        Ok(())
    }
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
