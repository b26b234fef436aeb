//! Errors of the IMU: bias and noise of its angles, noise of its rates, and a mount that differs from the announced one.

use glam::{DQuat, DVec3};
use serde::Deserialize;

use super::{EffectKind, Role, require};
use crate::SceneError;
use crate::check::check_range;
use crate::events::Imu;
use crate::file::SceneFile;
use crate::per_frame::Changing;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Euler;
use realitysim_geometry::Field;

/// Errors of the IMU.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuError {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Constant error of the roll, degrees.
    pub roll_bias_deg: f64,
    /// Constant error of the pitch, degrees.
    pub pitch_bias_deg: f64,
    /// Standard deviation of the white noise of roll and pitch, degrees.
    pub noise_deg: f64,
    /// Standard deviation of the white noise of each angular rate, degrees per second.
    pub gyro_noise_deg_s: f64,
    /// Roll of the housing in the torso that is not announced, degrees. 180 is upside down.
    pub mount_roll_deg: Option<f64>,
}

impl EffectKind for ImuError {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.roll_bias_deg"), self.roll_bias_deg, -30.0..=30.0, "-30 to 30 degrees")?;
        check_range(format_args!("{key}.pitch_bias_deg"), self.pitch_bias_deg, -30.0..=30.0, "-30 to 30 degrees")?;
        check_range(format_args!("{key}.noise_deg"), self.noise_deg, 0.0..=30.0, "0 to 30 degrees")?;
        let gyro = self.gyro_noise_deg_s;
        check_range(format_args!("{key}.gyro_noise_deg_s"), gyro, 0.0..=100.0, "0 to 100 degrees per second")?;
        let roll = self.mount_roll_deg.unwrap_or(0.0);
        check_range(format_args!("{key}.mount_roll_deg"), roll, -180.0..=180.0, "-180 to 180 degrees")
    }

    fn lacks(&self) -> Option<&'static str> {
        self.has_no_effect().then_some("at least one of its keys other than 0")
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        require(file.imu.is_some(), "it needs the section [imu], which is absent")
    }

    fn set_in(&self, changing: &mut Changing, _: u64) {
        changing.imu_error = Some(self.clone());
    }
}

impl ImuError {
    /// Whether the values change nothing.
    pub(super) fn has_no_effect(&self) -> bool {
        let Self { role: _, roll_bias_deg, pitch_bias_deg, noise_deg, gyro_noise_deg_s, mount_roll_deg } = self;
        let mount_roll_deg = mount_roll_deg.unwrap_or(0.0);
        [*roll_bias_deg, *pitch_bias_deg, *noise_deg, *gyro_noise_deg_s, mount_roll_deg] == [0.0; 5]
    }

    /// Converts a measurement from axes of the torso to axes of the housing.
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

    /// Angles and rates (rad/s) with bias and noise. `index` is the number of the message.
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
