//! Somebody pushes the robot over: it falls, lies, stands up and goes on with its walk.

use glam::{DQuat, DVec3};
use serde::Deserialize;

use super::{Carrying, Role, ease};
use crate::SceneError;
use crate::check::within;
use crate::motion::Motion;
use realitysim_geometry::{Field, Isometry, Pose2};

/// Its feet stay where they are until it stands up again, moved and turned by what it rolled meanwhile. Odometry counts
/// steps and knows nothing of it; the IMU feels it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fall {
    pub role: Option<Role>,
    /// Of the push, since the scene's start.
    pub at_s: f64,
    pub direction: Direction,
    /// From upright to the ground, on the ground, and up again.
    #[serde(default = "fall_s")]
    pub fall_s: f64,
    #[serde(default = "lie_s")]
    pub lie_s: f64,
    #[serde(default = "rise_s")]
    pub rise_s: f64,
    /// Where it stands up, seen from where it fell: ahead and to the left.
    #[serde(default)]
    pub moved_m: [f64; 2],
    #[serde(default)]
    pub turned_deg: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    Forwards,
    Backwards,
    Left,
    Right,
}

/// How the torso tips over while the walk stands still.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tumble {
    axis: DVec3,
    fall: f64,
    lie: f64,
    rise: f64,
}

/// On the ground: elbows and knees keep the torso off flat.
const LYING_DEG: f64 = 85.0;
/// Half of how thick a torso is.
const THICK_M: f64 = 0.09;

fn fall_s() -> f64 {
    0.7
}

fn lie_s() -> f64 {
    1.5
}

fn rise_s() -> f64 {
    3.0
}

impl Fall {
    pub(super) fn check(&self, key: &str) -> Result<(), SceneError> {
        within(format_args!("{key}.at_s"), self.at_s, 0.0..=7200.0, "0 to 7200 s after the start")?;
        within(format_args!("{key}.fall_s"), self.fall_s, 0.2..=10.0, "0.2 to 10 s: nobody falls faster")?;
        within(format_args!("{key}.lie_s"), self.lie_s, 0.0..=60.0, "0 to 60 s")?;
        within(format_args!("{key}.rise_s"), self.rise_s, 0.5..=60.0, "0.5 to 60 s: nobody gets up faster")?;
        for (axis, value) in ["ahead", "to the left"].iter().zip(self.moved_m) {
            let key = format_args!("{key}.moved_m ({axis})").to_string();
            within(key, value, -2.0..=2.0, "-2 to 2 m")?;
        }
        within(format_args!("{key}.turned_deg"), self.turned_deg, -180.0..=180.0, "-180 to 180 degrees")
    }

    pub(crate) fn model(&self, key: &str, motion: &Motion, field: &Field) -> Result<Carrying, SceneError> {
        let [x, y] = self.moved_m;
        let moved = Pose2::new(x, y, self.turned_deg.to_radians());
        let duration = self.fall_s + self.lie_s + self.rise_s;
        let to = motion.at(self.at_s).map_from_base_footprint.compose(&moved);
        let axis = match self.direction {
            Direction::Forwards => DVec3::Y,
            Direction::Backwards => DVec3::NEG_Y,
            Direction::Left => DVec3::NEG_X,
            Direction::Right => DVec3::X,
        };
        let tumble = Tumble { axis, fall: self.fall_s, lie: self.lie_s, rise: self.rise_s };
        Carrying::tumbling(key, self.at_s, duration, to, tumble, motion, field)
    }
}

impl Tumble {
    /// Of the upright torso, about its feet; seconds since the push.
    pub(crate) fn at(&self, time: f64) -> Isometry {
        let share = if time < self.fall {
            // Slow at first, as everything that tips over.
            let x = (time / self.fall).max(0.0);
            x * x * x * (4.0 - 3.0 * x)
        } else {
            1.0 - ease((time - self.fall - self.lie) / self.rise)
        };
        let angle = share * LYING_DEG.to_radians();
        let lift = DVec3::new(0.0, 0.0, THICK_M * libm::sin(angle));
        // glam's own sine and cosine are libm's here.
        Isometry::new(DQuat::from_axis_angle(self.axis, angle), lift)
    }
}
