//! An IMU mounted slightly askew, with noise on its angles and rates; or one that hangs in the torso otherwise than
//! it says.

use glam::{DQuat, DVec3};
use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;
use crate::events::Imu;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Euler;

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
    /// Its housing is rolled by this, and nobody tells: 180 is upside down.
    pub mount_roll_deg: Option<f64>,
}

impl ImuError {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.roll_bias_deg"), self.roll_bias_deg, -30.0..=30.0, "-30 to 30 degrees")?;
        within(format_args!("{key}.pitch_bias_deg"), self.pitch_bias_deg, -30.0..=30.0, "-30 to 30 degrees")?;
        within(format_args!("{key}.noise_deg"), self.noise_deg, 0.0..=30.0, "0 to 30 degrees")?;
        let gyro = self.gyro_noise_deg_s;
        within(format_args!("{key}.gyro_noise_deg_s"), gyro, 0.0..=100.0, "0 to 100 degrees per second")?;
        let roll = self.mount_roll_deg.unwrap_or(0.0);
        within(format_args!("{key}.mount_roll_deg"), roll, -180.0..=180.0, "-180 to 180 degrees")
    }

    pub(super) fn is_none(&self) -> bool {
        let Self { role: _, roll_bias_deg, pitch_bias_deg, noise_deg, gyro_noise_deg_s, mount_roll_deg } = self;
        let mount_roll_deg = mount_roll_deg.unwrap_or(0.0);
        [*roll_bias_deg, *pitch_bias_deg, *noise_deg, *gyro_noise_deg_s, mount_roll_deg] == [0.0; 5]
    }

    /// What is right in the torso's axes, in those of the housing.
    pub(crate) fn in_housing(&self, measured: Imu) -> Imu {
        let Some(roll) = self.mount_roll_deg else { return measured };
        let torso_from_housing = DQuat::from_axis_angle(DVec3::X, roll.to_radians());
        let housing_from_torso = torso_from_housing.conjugate();
        Imu {
            orientation: measured.orientation * torso_from_housing,
            angular_velocity: housing_from_torso * measured.angular_velocity,
            linear_acceleration: housing_from_torso * measured.linear_acceleration,
        }
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
