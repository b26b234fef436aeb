//! Sway of the torso with the gait. Roll and lateral motion repeat every two steps, pitch and vertical motion every step.

use core::f64::consts::{PI, TAU};

use serde::Deserialize;

use super::{EffectKind, NEEDS_WALK, Role, ease, require};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use crate::file::Route;
use crate::file::SceneFile;
use crate::motion::Motion;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Field;

/// Sway of the torso. Amplitudes are half of peak to peak.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GaitSway {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Amplitude of the roll, degrees.
    pub roll_deg: f64,
    /// Amplitude of the pitch, degrees.
    pub pitch_deg: f64,
    /// Amplitude of the sideways motion, metres.
    pub lateral_m: f64,
    /// Amplitude of the vertical motion, metres.
    pub vertical_m: f64,
    /// Steps per second, left and right together.
    pub step_hz: f64,
}

/// Deviation of the torso from its upright pose, radians and metres.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sway {
    pub(crate) roll: f64,
    pub(crate) pitch: f64,
    pub(crate) lateral: f64,
    pub(crate) vertical: f64,
}

/// The sway as a function of time.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SwayModel {
    amplitude: Sway,
    step_hz: f64,
    /// Phase of the gait at the start, radians.
    phase: f64,
    /// End of the walk, seconds.
    end: f64,
    /// Begin and end of each time in which the robot stands, seconds.
    stands: Vec<(f64, f64)>,
}

/// Time over which the sway fades in at the start and out at the end, seconds.
const FADE_S: f64 = 0.5;
/// Lag of the pitch behind the vertical motion, radians. The torso nods after the foot lands.
const PITCH_LAG: f64 = 0.6;

impl EffectKind for GaitSway {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.roll_deg"), self.roll_deg, 0.0..=30.0, "an amplitude of 0 to 30 degrees")?;
        check_range(format_args!("{key}.pitch_deg"), self.pitch_deg, 0.0..=30.0, "an amplitude of 0 to 30 degrees")?;
        check_range(format_args!("{key}.lateral_m"), self.lateral_m, 0.0..=0.2, "an amplitude of 0 to 0.2 m")?;
        check_range(format_args!("{key}.vertical_m"), self.vertical_m, 0.0..=0.04, "an amplitude of 0 to 0.04 m")?;
        check_range(format_args!("{key}.step_hz"), self.step_hz, 0.1..=10.0, "0.1 to 10 steps per second")
    }

    fn lacks(&self) -> Option<&'static str> {
        self.is_still().then_some("an amplitude above 0")
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        require(matches!(file.route, Route::Walk(_)), NEEDS_WALK)
    }

    fn moves_camera(&self) -> bool {
        !self.is_still()
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.sway = Some(self.model(scene.file.scene.seed, &scene.motion));
        Ok(())
    }
}

impl GaitSway {
    /// Whether all amplitudes are 0.
    pub(super) fn is_still(&self) -> bool {
        [self.roll_deg, self.pitch_deg, self.lateral_m, self.vertical_m] == [0.0; 4]
    }

    /// The sway of a walk. The seed gives the phase.
    pub(crate) fn model(&self, seed: u64, motion: &Motion) -> SwayModel {
        SwayModel {
            amplitude: Sway {
                roll: self.roll_deg.to_radians(),
                pitch: self.pitch_deg.to_radians(),
                lateral: self.lateral_m,
                vertical: self.vertical_m,
            },
            step_hz: self.step_hz,
            phase: Stream::new(seed, Purpose::GaitSway, 0).between(0.0, TAU),
            end: motion.duration(),
            stands: motion.stands().map(|(from, until, _)| (from, until)).collect(),
        }
    }
}

impl SwayModel {
    /// Sway at `time`, seconds along the route.
    pub(crate) fn at(&self, time: f64) -> Sway {
        let faded =
            |strength: f64, (from, until): &(f64, f64)| strength * ease((from - time).max(time - until) / FADE_S);
        let ends = ease(time / FADE_S) * ease((self.end - time) / FADE_S);
        let strength = self.stands.iter().fold(ends, faded);
        let stride = PI * self.step_hz * time + self.phase;
        let a = &self.amplitude;
        Sway {
            roll: strength * a.roll * libm::sin(stride),
            // The hips move over the supporting foot while the torso leans the same way.
            lateral: -strength * a.lateral * libm::sin(stride),
            pitch: strength * a.pitch * libm::sin(2.0 * stride - PITCH_LAG),
            vertical: strength * a.vertical * libm::cos(2.0 * stride),
        }
    }
}
