//! A head that looks around while the robot walks: the camera pans about the torso's z and then tilts about its own y.

use core::f64::consts::TAU;

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Euler;

/// Amplitudes, half of peak to peak. Both joints swing as a sine and start in the middle.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadMotion {
    pub role: Option<Role>,
    pub pan_amplitude_deg: f64,
    pub pan_period_s: f64,
    pub tilt_amplitude_deg: f64,
    pub tilt_period_s: f64,
    /// Standard deviation of what the encoders say, white. The head itself does not shake.
    #[serde(default)]
    pub encoder_noise_deg: f64,
}

/// Radians: pan to the left, tilt down, against the camera as it is mounted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joints {
    pub pan: f64,
    pub tilt: f64,
}

impl HeadMotion {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        let pan = self.pan_amplitude_deg;
        within(format_args!("{key}.pan_amplitude_deg"), pan, 0.0..=170.0, "an amplitude of 0 to 170 degrees")?;
        let tilt = self.tilt_amplitude_deg;
        within(format_args!("{key}.tilt_amplitude_deg"), tilt, 0.0..=90.0, "an amplitude of 0 to 90 degrees")?;
        for (name, period) in [("pan_period_s", self.pan_period_s), ("tilt_period_s", self.tilt_period_s)] {
            within(format_args!("{key}.{name}"), period, 0.2..=3600.0, "0.2 to 3600 s from left to right and back")?;
        }
        let noise = self.encoder_noise_deg;
        within(format_args!("{key}.encoder_noise_deg"), noise, 0.0..=30.0, "0 to 30 degrees")
    }

    pub(super) fn is_still(&self) -> bool {
        self.pan_amplitude_deg == 0.0 && self.tilt_amplitude_deg == 0.0
    }

    pub(crate) fn at(&self, time: f64) -> Joints {
        let swing = |amplitude: f64, period: f64| amplitude.to_radians() * libm::sin(TAU * time / period);
        Joints {
            pan: swing(self.pan_amplitude_deg, self.pan_period_s),
            tilt: swing(self.tilt_amplitude_deg, self.tilt_period_s),
        }
    }

    pub(crate) fn measured(&self, time: f64, seed: u64, index: u64) -> Joints {
        let mut stream = Stream::new(seed, Purpose::HeadMotion, index);
        let noise = self.encoder_noise_deg.to_radians();
        let Joints { pan, tilt } = self.at(time);
        Joints { pan: pan + noise * stream.gaussian(), tilt: tilt + noise * stream.gaussian() }
    }
}

impl Joints {
    /// The camera's rotation in the torso, mounted with this pitch: Rz(pan) Ry(pitch + tilt).
    pub(crate) fn camera(&self, mount_pitch: f64) -> Euler {
        Euler { yaw: self.pan, pitch: mount_pitch + self.tilt, roll: 0.0 }
    }
}
