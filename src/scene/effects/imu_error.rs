//! An IMU mounted slightly askew, with noise on its angles and rates.

use glam::DVec3;
use serde::Deserialize;

use super::Role;
use crate::geometry::Euler;
use crate::scene::SceneError;
use crate::scene::check::within;
use crate::scene::stream::{Purpose, Stream};

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuError {
    pub role: Option<Role>,
    pub roll_bias_deg: f64,
    pub pitch_bias_deg: f64,
    /// Standard deviation of roll and pitch, white.
    pub noise_deg: f64,
    /// Standard deviation of every rate, white.
    pub gyro_noise_deg_s: f64,
}

impl ImuError {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.roll_bias_deg"), self.roll_bias_deg, -30.0..=30.0, "-30 to 30 degrees")?;
        within(format_args!("{key}.pitch_bias_deg"), self.pitch_bias_deg, -30.0..=30.0, "-30 to 30 degrees")?;
        within(format_args!("{key}.noise_deg"), self.noise_deg, 0.0..=30.0, "0 to 30 degrees")?;
        let gyro = self.gyro_noise_deg_s;
        within(format_args!("{key}.gyro_noise_deg_s"), gyro, 0.0..=100.0, "0 to 100 degrees per second")
    }

    pub(crate) fn measured(&self, euler: Euler, rates: DVec3, seed: u64, index: u64) -> (Euler, DVec3) {
        let mut stream = Stream::new(seed, Purpose::ImuError, index);
        let noise = self.noise_deg.to_radians();
        let euler = Euler {
            yaw: euler.yaw,
            roll: euler.roll + self.roll_bias_deg.to_radians() + noise * stream.gaussian(),
            pitch: euler.pitch + self.pitch_bias_deg.to_radians() + noise * stream.gaussian(),
        };
        let gyro = self.gyro_noise_deg_s.to_radians();
        let scatter = DVec3::new(stream.gaussian(), stream.gaussian(), stream.gaussian());
        (euler, rates + scatter * gyro)
    }
}
