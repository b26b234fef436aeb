//! Odometry that measures steps too long or too short, drifts in yaw and scatters; and that stands still, jumps or
//! falls silent.

use serde::Deserialize;

use super::Role;
use crate::SceneError;
use crate::check::within;
use crate::stream::{Purpose, Stream};
use realitysim_geometry::Pose2;

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
    /// Meanwhile it repeats its last pose; what was walked meanwhile is lost.
    pub freeze: Option<Span>,
    /// Meanwhile no message comes; what was walked meanwhile is in the next one.
    pub missing: Option<Span>,
    pub jump: Option<Jump>,
}

/// Seconds since the scene's start.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Span {
    pub from_s: f64,
    pub for_s: f64,
}

/// Once the pose moves by this, as the robot sees it: x ahead, y to the left.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Jump {
    pub at_s: f64,
    pub x_m: f64,
    pub y_m: f64,
    pub yaw_deg: f64,
}

impl OdometryError {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.scale_percent"), self.scale_percent, -90.0..=100.0, "-90 to 100 percent")?;
        let drift = self.yaw_drift_deg_per_m;
        within(format_args!("{key}.yaw_drift_deg_per_m"), drift, -90.0..=90.0, "-90 to 90 degrees per metre")?;
        within(format_args!("{key}.noise_m_per_m"), self.noise_m_per_m, 0.0..=2.0, "0 to 2 m per metre")?;
        for (name, span) in [("freeze", self.freeze), ("missing", self.missing)] {
            if let Some(span) = span {
                within(format_args!("{key}.{name}.from_s"), span.from_s, 0.0..=7200.0, "0 to 7200 s after the start")?;
                within(format_args!("{key}.{name}.for_s"), span.for_s, 0.001..=7200.0, "0.001 to 7200 s")?;
            }
        }
        let Some(jump) = self.jump else { return Ok(()) };
        // At the very start there is nothing that it could jump from.
        within(format_args!("{key}.jump.at_s"), jump.at_s, 0.001..=7200.0, "0.001 to 7200 s after the start")?;
        within(format_args!("{key}.jump.x_m"), jump.x_m, -100.0..=100.0, "-100 to 100 m")?;
        within(format_args!("{key}.jump.y_m"), jump.y_m, -100.0..=100.0, "-100 to 100 m")?;
        within(format_args!("{key}.jump.yaw_deg"), jump.yaw_deg, -360.0..=360.0, "-360 to 360 degrees")
    }

    pub(super) fn is_none(&self) -> bool {
        let Self { role: _, scale_percent, yaw_drift_deg_per_m, noise_m_per_m, freeze, missing, jump } = self;
        let is_no_jump = |jump: &Jump| [jump.x_m, jump.y_m, jump.yaw_deg] == [0.0; 3];
        [*scale_percent, *yaw_drift_deg_per_m, *noise_m_per_m] == [0.0; 3]
            && freeze.is_none()
            && missing.is_none()
            && jump.as_ref().is_none_or(is_no_jump)
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

    pub(crate) fn is_frozen(&self, time: f64) -> bool {
        self.freeze.is_some_and(|span| span.holds(time))
    }

    pub(crate) fn is_silent(&self, time: f64) -> bool {
        self.missing.is_some_and(|span| span.holds(time))
    }

    /// Between one sample and the next.
    pub(crate) fn jumped(&self, before: f64, now: f64) -> Option<Pose2> {
        let jump = self.jump.filter(|jump| before < jump.at_s && jump.at_s <= now)?;
        Some(Pose2::new(jump.x_m, jump.y_m, jump.yaw_deg.to_radians()))
    }
}

impl Span {
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.from_s < other.from_s + other.for_s && other.from_s < self.from_s + self.for_s
    }

    pub(super) fn holds(&self, time: f64) -> bool {
        (self.from_s..self.from_s + self.for_s).contains(&time)
    }
}
