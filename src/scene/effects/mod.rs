//! What makes a scene imperfect, one effect a file. An effect that the file does not list does not exist.
//!
//! Every effect draws from its own stream, so that adding one never changes what another does.

mod gait_sway;
mod imu_error;
mod odometry_error;
mod sensor_noise;

pub use gait_sway::GaitSway;
pub use imu_error::ImuError;
pub use odometry_error::OdometryError;
pub use sensor_noise::SensorNoise;

pub(super) use gait_sway::{Sway, SwayModel};
pub(super) use sensor_noise::NoiseModel;

use serde::Deserialize;

use super::SceneError;
use super::check::refuse;

/// One `[[effect]]` of the scene file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Effect {
    GaitSway(GaitSway),
    SensorNoise(SensorNoise),
    OdometryError(OdometryError),
    ImuError(ImuError),
}

/// Why an effect is in the scene: its task needs it, or it is there to keep the scene from being too clean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    Base,
    Filler,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Motion,
    Sensor,
}

impl Effect {
    pub fn name(&self) -> &'static str {
        match self {
            Effect::GaitSway(_) => "gait_sway",
            Effect::SensorNoise(_) => "sensor_noise",
            Effect::OdometryError(_) => "odometry_error",
            Effect::ImuError(_) => "imu_error",
        }
    }

    pub fn role(&self) -> Option<Role> {
        match self {
            Effect::GaitSway(effect) => effect.role,
            Effect::SensorNoise(effect) => effect.role,
            Effect::OdometryError(effect) => effect.role,
            Effect::ImuError(effect) => effect.role,
        }
    }

    fn stage(&self) -> Stage {
        match self {
            Effect::GaitSway(_) => Stage::Motion,
            Effect::SensorNoise(_) | Effect::OdometryError(_) | Effect::ImuError(_) => Stage::Sensor,
        }
    }

    fn check(&self, key: &str) -> Result<(), SceneError> {
        match self {
            Effect::GaitSway(effect) => effect.check(key),
            Effect::SensorNoise(effect) => effect.check(key),
            Effect::OdometryError(effect) => effect.check(key),
            Effect::ImuError(effect) => effect.check(key),
        }
    }
}

pub(super) fn check(effects: &[Effect]) -> Result<(), SceneError> {
    for (index, effect) in effects.iter().enumerate() {
        let key = format!("effect[{index}]");
        effect.check(&key)?;
        let before = &effects[..index];
        if before.iter().any(|other| other.name() == effect.name()) {
            let expected = "an effect of this kind is listed already; each kind acts once";
            return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
        }
        if before.iter().any(|other| other.stage() > effect.stage()) {
            let expected = "list effects in physical order: what moves the robot (gait_sway) before what a sensor adds";
            return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
        }
    }
    Ok(())
}
