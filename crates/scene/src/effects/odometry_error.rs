//! Errors of the odometry: scale, yaw drift and noise, and faults in which it freezes, jumps or sends nothing.

use serde::Deserialize;

use super::{EffectKind, NEEDS_ODOMETRY_OR_IMU, Role, require};
use crate::SceneError;
use crate::check::{check_range, refuse};
use crate::file::SceneFile;
use crate::per_frame::Changing;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Field;
use realitysim_geometry::Pose2;

/// Errors of the odometry.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OdometryError {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Error of the measured distance, percent. Above 0 the odometry reports more than the robot has walked.
    pub scale_percent: f64,
    /// Drift of the yaw to the left, degrees per metre walked.
    pub yaw_drift_deg_per_m: f64,
    /// Standard deviation of each step in x and in y, metres per metre of its length.
    pub noise_m_per_m: f64,
    /// Span in which the odometry repeats its last pose. The distance walked meanwhile is lost.
    pub freeze: Option<Span>,
    /// Span without messages. The distance walked meanwhile is in the next message.
    pub missing: Option<Span>,
    /// A single jump of the pose.
    pub jump: Option<Jump>,
}

/// A span of time.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    /// Begin, seconds since the start of the scene.
    pub from_s: f64,
    /// Duration, seconds.
    pub for_s: f64,
}

/// A single jump of the measured pose, in coordinates of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Jump {
    /// Time of the jump, seconds since the start of the scene.
    pub at_s: f64,
    /// Jump forwards, metres.
    pub x_m: f64,
    /// Jump to the left, metres.
    pub y_m: f64,
    /// Turn to the left, degrees.
    pub yaw_deg: f64,
}

impl EffectKind for OdometryError {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.scale_percent"), self.scale_percent, -90.0..=100.0, "-90 to 100 percent")?;
        let drift = self.yaw_drift_deg_per_m;
        check_range(format_args!("{key}.yaw_drift_deg_per_m"), drift, -90.0..=90.0, "-90 to 90 degrees per metre")?;
        check_range(format_args!("{key}.noise_m_per_m"), self.noise_m_per_m, 0.0..=2.0, "0 to 2 m per metre")?;
        for (name, span) in [("freeze", self.freeze), ("missing", self.missing)] {
            if let Some(span) = span {
                check_range(
                    format_args!("{key}.{name}.from_s"),
                    span.from_s,
                    0.0..=7200.0,
                    "0 to 7200 s after the start",
                )?;
                check_range(format_args!("{key}.{name}.for_s"), span.for_s, 0.001..=7200.0, "0.001 to 7200 s")?;
            }
        }
        let Some(jump) = self.jump else { return Ok(()) };
        // At the very start there is no earlier sample to jump from.
        check_range(format_args!("{key}.jump.at_s"), jump.at_s, 0.001..=7200.0, "0.001 to 7200 s after the start")?;
        check_range(format_args!("{key}.jump.x_m"), jump.x_m, -100.0..=100.0, "-100 to 100 m")?;
        check_range(format_args!("{key}.jump.y_m"), jump.y_m, -100.0..=100.0, "-100 to 100 m")?;
        check_range(format_args!("{key}.jump.yaw_deg"), jump.yaw_deg, -360.0..=360.0, "-360 to 360 degrees")
    }

    fn lacks(&self) -> Option<&'static str> {
        self.has_no_effect().then_some("at least one of its keys other than 0, or freeze, missing or jump")
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        // The yaw of the IMU comes from the odometry, so the error shows there, too.
        require(file.odometry.is_some() || file.imu.is_some(), NEEDS_ODOMETRY_OR_IMU)
    }

    fn set_in(&self, changing: &mut Changing, _: u64) {
        changing.odometry_error = Some(self.clone());
    }

    fn check_in(&self, key: &str, _: &SceneFile) -> Result<(), SceneError> {
        let Some((freeze, missing)) = self.freeze.zip(self.missing) else { return Ok(()) };
        if !freeze.overlaps(&missing) {
            return Ok(());
        }
        let expected = format!(
            "odometry cannot be frozen and missing at the same time, and it is frozen from {} to {} s",
            freeze.from_s,
            freeze.from_s + freeze.for_s
        );
        Err(refuse(format_args!("{key}.missing.from_s"), format!("{} s", missing.from_s), expected))
    }

    fn begins(&self) -> Vec<(&'static str, f64)> {
        let freeze = self.freeze.map(|span| ("freeze.from_s", span.from_s));
        let missing = self.missing.map(|span| ("missing.from_s", span.from_s));
        let jump = self.jump.map(|jump| ("jump.at_s", jump.at_s));
        [freeze, missing, jump].into_iter().flatten().collect()
    }
}

impl OdometryError {
    /// Whether the values change nothing.
    pub(super) fn has_no_effect(&self) -> bool {
        let Self { role: _, scale_percent, yaw_drift_deg_per_m, noise_m_per_m, freeze, missing, jump } = self;
        let is_zero = |jump: &Jump| [jump.x_m, jump.y_m, jump.yaw_deg] == [0.0; 3];
        [*scale_percent, *yaw_drift_deg_per_m, *noise_m_per_m] == [0.0; 3]
            && freeze.is_none()
            && missing.is_none()
            && jump.as_ref().is_none_or(is_zero)
    }

    /// Factor of the measured distance.
    pub(crate) fn scale(&self) -> f64 {
        1.0 + self.scale_percent / 100.0
    }

    /// Drift of the yaw, radians per metre walked.
    pub(crate) fn yaw_drift(&self) -> f64 {
        self.yaw_drift_deg_per_m.to_radians()
    }

    /// The measured step for the true `step` since the last sample. `walked` is its length along the path, metres.
    pub(crate) fn measured(&self, step: &Pose2, walked: f64, seed: u64, index: u64) -> Pose2 {
        let mut stream = Stream::new(seed, Purpose::OdometryError, index);
        let deviation = self.noise_m_per_m * walked;
        Pose2 {
            x: step.x * self.scale() + deviation * stream.gaussian(),
            y: step.y * self.scale() + deviation * stream.gaussian(),
            yaw: step.yaw + self.yaw_drift() * walked,
        }
    }

    /// Whether the odometry repeats its last pose at `time`.
    pub(crate) fn is_frozen(&self, time: f64) -> bool {
        self.freeze.is_some_and(|span| span.contains(time))
    }

    /// Whether no message is sent at `time`.
    pub(crate) fn is_silent(&self, time: f64) -> bool {
        self.missing.is_some_and(|span| span.contains(time))
    }

    /// The jump, if it happens after the sample at `before` and not after the one at `now`.
    pub(crate) fn jump_between(&self, before: f64, now: f64) -> Option<Pose2> {
        let jump = self.jump.filter(|jump| before < jump.at_s && jump.at_s <= now)?;
        Some(Pose2::new(jump.x_m, jump.y_m, jump.yaw_deg.to_radians()))
    }
}

impl Span {
    /// Whether two spans have a time in common.
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.from_s < other.from_s + other.for_s && other.from_s < self.from_s + self.for_s
    }

    /// Whether `time` is within the span.
    pub(super) fn contains(&self, time: f64) -> bool {
        (self.from_s..self.from_s + self.for_s).contains(&time)
    }
}
