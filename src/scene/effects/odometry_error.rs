//! Odometry that measures steps too long or too short, drifts in yaw and scatters.

use serde::Deserialize;

use super::Role;
use crate::geometry::Pose2;
use crate::scene::SceneError;
use crate::scene::check::within;
use crate::scene::stream::{Purpose, Stream};

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OdometryError {
    pub role: Option<Role>,
    /// Above 0 the odometry claims more way than the robot has walked.
    pub scale_percent: f64,
    /// To the left, per metre walked.
    pub yaw_drift_deg_per_m: f64,
    /// Standard deviation of every sample's step in x and in y, per metre of the step's length.
    pub noise_m_per_m: f64,
}

impl OdometryError {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.scale_percent"), self.scale_percent, -90.0..=100.0, "-90 to 100 percent")?;
        let drift = self.yaw_drift_deg_per_m;
        within(format_args!("{key}.yaw_drift_deg_per_m"), drift, -90.0..=90.0, "-90 to 90 degrees per metre")?;
        within(format_args!("{key}.noise_m_per_m"), self.noise_m_per_m, 0.0..=2.0, "0 to 2 m per metre")
    }

    pub(crate) fn scale(&self) -> f64 {
        1.0 + self.scale_percent / 100.0
    }

    /// Radians per metre.
    pub(crate) fn yaw_drift(&self) -> f64 {
        self.yaw_drift_deg_per_m.to_radians()
    }

    /// What the odometry makes of the true step since its last sample, `walked` metres along the way.
    pub(crate) fn measured(&self, step: &Pose2, walked: f64, seed: u64, index: u64) -> Pose2 {
        let mut stream = Stream::new(seed, Purpose::OdometryError, index);
        let deviation = self.noise_m_per_m * walked;
        Pose2 {
            x: step.x * self.scale() + deviation * stream.gaussian(),
            y: step.y * self.scale() + deviation * stream.gaussian(),
            yaw: step.yaw + self.yaw_drift() * walked,
        }
    }
}
