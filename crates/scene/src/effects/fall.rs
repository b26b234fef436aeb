//! A fall: the robot is pushed over, lies on the ground, stands up and goes on with its walk.

use glam::{DQuat, DVec3};
use serde::Deserialize;

use super::{EffectKind, Interruption, Role, ease, require};
use crate::Scene;
use crate::SceneError;
use crate::check::check_range;
use crate::file::SceneFile;
use crate::motion::Motion;
use realitysim_geometry::{Field, Isometry, Pose2};

/// A fall. The robot tips about its feet and stands up moved and turned by what it rolled meanwhile.
///
/// Odometry counts steps and does not notice the fall. The IMU measures it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fall {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Time of the push, seconds since the start of the scene.
    pub at_s: f64,
    /// Direction of the fall.
    pub direction: Direction,
    /// Time from upright to the ground, seconds.
    #[serde(default = "fall_s")]
    pub fall_s: f64,
    /// Time on the ground, seconds.
    #[serde(default = "lie_s")]
    pub lie_s: f64,
    /// Time from the ground to upright, seconds.
    #[serde(default = "rise_s")]
    pub rise_s: f64,
    /// Position where the robot stands up, ahead and to the left of where it fell, metres.
    #[serde(default)]
    pub moved_m: [f64; 2],
    /// Turn to the left between falling and standing up, degrees.
    #[serde(default)]
    pub turned_deg: f64,
}

/// The direction of a fall, as the robot sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// Onto its front.
    Forwards,
    /// Onto its back.
    Backwards,
    /// Onto its left side.
    Left,
    /// Onto its right side.
    Right,
}

/// Motion of the torso during a fall. Durations are seconds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tumble {
    /// Axis of rotation in the coordinates of the robot.
    axis: DVec3,
    fall: f64,
    lie: f64,
    rise: f64,
}

/// Tilt of the torso on the ground, degrees. Elbows and knees keep it from lying flat.
const LYING_DEG: f64 = 85.0;
/// Half of the thickness of the torso, metres.
const TORSO_HALF_THICKNESS_M: f64 = 0.09;

fn fall_s() -> f64 {
    0.7
}

fn lie_s() -> f64 {
    1.5
}

fn rise_s() -> f64 {
    3.0
}

impl EffectKind for Fall {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, _: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.at_s"), self.at_s, 0.0..=7200.0, "0 to 7200 s after the start")?;
        check_range(format_args!("{key}.fall_s"), self.fall_s, 0.2..=10.0, "0.2 to 10 s: nobody falls faster")?;
        check_range(format_args!("{key}.lie_s"), self.lie_s, 0.0..=60.0, "0 to 60 s")?;
        check_range(format_args!("{key}.rise_s"), self.rise_s, 0.5..=60.0, "0.5 to 60 s: nobody gets up faster")?;
        for (axis, value) in ["ahead", "to the left"].iter().zip(self.moved_m) {
            let key = format_args!("{key}.moved_m ({axis})").to_string();
            check_range(key, value, -2.0..=2.0, "-2 to 2 m")?;
        }
        check_range(format_args!("{key}.turned_deg"), self.turned_deg, -180.0..=180.0, "-180 to 180 degrees")
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        require(!file.lists("kidnapping"), "a walk is interrupted once, and kidnapping does so already")?;
        require(file.lists("gait_sway"), "it needs gait_sway: a robot that stands still is not pushed over")
    }

    fn add_to(&self, scene: &mut Scene, key: &str) -> Result<(), SceneError> {
        scene.interruption = Some(self.model(key, &scene.motion, &scene.field)?);
        Ok(())
    }
}

impl Fall {
    /// The interruption of `motion`. Returns an error if the rest of the route leaves the field.
    pub(crate) fn model(&self, key: &str, motion: &Motion, field: &Field) -> Result<Interruption, SceneError> {
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
        Interruption::tumbling(key, self.at_s, duration, to, tumble, motion, field)
    }
}

impl Tumble {
    /// Displacement of the upright torso about its feet, `time` seconds since the push.
    pub(crate) fn at(&self, time: f64) -> Isometry {
        let share = if time < self.fall {
            // The fall is slow at first, like that of any body that tips over.
            let x = (time / self.fall).max(0.0);
            x * x * x * (4.0 - 3.0 * x)
        } else {
            1.0 - ease((time - self.fall - self.lie) / self.rise)
        };
        let angle = share * LYING_DEG.to_radians();
        let lift = DVec3::new(0.0, 0.0, TORSO_HALF_THICKNESS_M * libm::sin(angle));
        // glam is built with libm here, so its sine and cosine are the same on every machine.
        Isometry::new(DQuat::from_axis_angle(self.axis, angle), lift)
    }
}
