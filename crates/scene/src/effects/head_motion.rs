//! Motion of the head while the robot walks: the camera pans about z of the torso and then tilts about its own y.

use core::f64::consts::TAU;

use serde::Deserialize;

use super::{EffectKind, Role, require};
use crate::SceneError;
use crate::check::check_range;
use crate::file::SceneFile;
use crate::per_frame::Changing;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Euler;
use realitysim_geometry::Field;

/// Motion of the head. Both joints swing as a sine and start in the middle. Amplitudes are half of peak to peak.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeadMotion {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Amplitude of the pan angle, degrees.
    pub pan_amplitude_deg: f64,
    /// Period of the pan angle, seconds.
    pub pan_period_s: f64,
    /// Amplitude of the tilt angle, degrees.
    pub tilt_amplitude_deg: f64,
    /// Period of the tilt angle, seconds.
    pub tilt_period_s: f64,
    /// Standard deviation of the white noise of the encoders, degrees. The head itself does not shake.
    #[serde(default)]
    pub encoder_noise_deg: f64,
}

/// Joint angles of the head, relative to the camera as it is mounted, radians.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Joints {
    /// Turn to the left.
    pub pan: f64,
    /// Tilt downwards.
    pub tilt: f64,
}

impl EffectKind for HeadMotion {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        let pan = self.pan_amplitude_deg;
        check_range(format_args!("{key}.pan_amplitude_deg"), pan, 0.0..=170.0, "an amplitude of 0 to 170 degrees")?;
        let tilt = self.tilt_amplitude_deg;
        check_range(format_args!("{key}.tilt_amplitude_deg"), tilt, 0.0..=90.0, "an amplitude of 0 to 90 degrees")?;
        for (name, period) in [("pan_period_s", self.pan_period_s), ("tilt_period_s", self.tilt_period_s)] {
            check_range(
                format_args!("{key}.{name}"),
                period,
                0.2..=3600.0,
                "0.2 to 3600 s from left to right and back",
            )?;
        }
        let noise = self.encoder_noise_deg;
        check_range(format_args!("{key}.encoder_noise_deg"), noise, 0.0..=30.0, "0 to 30 degrees")
    }

    fn lacks(&self) -> Option<&'static str> {
        (self.is_still() && self.encoder_noise_deg == 0.0).then_some("an amplitude or encoder_noise_deg above 0")
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        require(file.imu.is_some(), "joints are sent at the rate of the section [imu], which is absent")
    }

    fn moves_camera(&self) -> bool {
        !self.is_still()
    }

    fn set_in(&self, changing: &mut Changing, _: u64) {
        changing.head = Some(self.clone());
    }
}

impl HeadMotion {
    /// Whether neither joint moves.
    pub(super) fn is_still(&self) -> bool {
        self.pan_amplitude_deg == 0.0 && self.tilt_amplitude_deg == 0.0
    }

    /// True joint angles at `time`, seconds.
    pub(crate) fn at(&self, time: f64) -> Joints {
        let swing = |amplitude: f64, period: f64| amplitude.to_radians() * libm::sin(TAU * time / period);
        Joints {
            pan: swing(self.pan_amplitude_deg, self.pan_period_s),
            tilt: swing(self.tilt_amplitude_deg, self.tilt_period_s),
        }
    }

    /// Joint angles with encoder noise. `index` is the number of the message.
    pub(crate) fn measured(&self, time: f64, seed: u64, index: u64) -> Joints {
        let mut stream = Stream::new(seed, Purpose::HeadMotion, index);
        let noise = self.encoder_noise_deg.to_radians();
        let Joints { pan, tilt } = self.at(time);
        Joints { pan: pan + noise * stream.gaussian(), tilt: tilt + noise * stream.gaussian() }
    }
}

impl Joints {
    /// Rotation of the camera in the torso, Rz(pan) Ry(mount pitch + tilt).
    pub(crate) fn camera(&self, mount_pitch: f64) -> Euler {
        Euler { yaw: self.pan, pitch: mount_pitch + self.tilt, roll: 0.0 }
    }
}
