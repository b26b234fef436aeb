//! The torso rocks from foot to foot: roll and sideways once in two steps, pitch and up-down once a step.

use core::f64::consts::{PI, TAU};

use serde::Deserialize;

use super::{Role, ease};
use crate::SceneError;
use crate::check::within;
use crate::stream::{Purpose, Stream};

/// Amplitudes, half of peak to peak.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaitSway {
    pub role: Option<Role>,
    pub roll_deg: f64,
    pub pitch_deg: f64,
    pub lateral_m: f64,
    pub vertical_m: f64,
    /// Steps per second, left and right counted.
    pub step_hz: f64,
}

/// How far the torso is off upright: metres and radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sway {
    pub(crate) roll: f64,
    pub(crate) pitch: f64,
    pub(crate) lateral: f64,
    pub(crate) vertical: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SwayModel {
    amplitude: Sway,
    step_hz: f64,
    /// The step that the walk begins in.
    phase: f64,
    /// The walk's end, seconds.
    end: f64,
}

/// The first and last steps grow into and out of the gait.
const FADE_S: f64 = 0.5;
/// Pitch lags the up-down motion: the torso nods after the foot lands.
const PITCH_LAG: f64 = 0.6;

impl GaitSway {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.roll_deg"), self.roll_deg, 0.0..=30.0, "an amplitude of 0 to 30 degrees")?;
        within(format_args!("{key}.pitch_deg"), self.pitch_deg, 0.0..=30.0, "an amplitude of 0 to 30 degrees")?;
        within(format_args!("{key}.lateral_m"), self.lateral_m, 0.0..=0.2, "an amplitude of 0 to 0.2 m")?;
        within(format_args!("{key}.vertical_m"), self.vertical_m, 0.0..=0.04, "an amplitude of 0 to 0.04 m")?;
        within(format_args!("{key}.step_hz"), self.step_hz, 0.1..=10.0, "0.1 to 10 steps per second")
    }

    pub(super) fn is_still(&self) -> bool {
        [self.roll_deg, self.pitch_deg, self.lateral_m, self.vertical_m] == [0.0; 4]
    }

    pub(crate) fn model(&self, seed: u64, end: f64) -> SwayModel {
        SwayModel {
            amplitude: Sway {
                roll: self.roll_deg.to_radians(),
                pitch: self.pitch_deg.to_radians(),
                lateral: self.lateral_m,
                vertical: self.vertical_m,
            },
            step_hz: self.step_hz,
            phase: Stream::new(seed, Purpose::GaitSway, 0).between(0.0, TAU),
            end,
        }
    }
}

impl SwayModel {
    pub(crate) fn at(&self, time: f64) -> Sway {
        let strength = ease(time / FADE_S) * ease((self.end - time) / FADE_S);
        let stride = PI * self.step_hz * time + self.phase;
        let a = &self.amplitude;
        Sway {
            roll: strength * a.roll * libm::sin(stride),
            // The hips move over the standing foot while the torso leans the same way.
            lateral: -strength * a.lateral * libm::sin(stride),
            pitch: strength * a.pitch * libm::sin(2.0 * stride - PITCH_LAG),
            vertical: strength * a.vertical * libm::cos(2.0 * stride),
        }
    }
}
