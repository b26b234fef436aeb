//! Kidnapping: somebody picks the robot up and puts it down elsewhere, which its odometry does not notice.

use serde::Deserialize;

use super::{EffectKind, NEEDS_WALK, Role, Tumble, ease, require};
use crate::Scene;
use crate::SceneError;
use crate::check::{check_on_field, check_range, refuse};
use crate::file::Route;
use crate::file::SceneFile;
use crate::motion::{Motion, Travel};
use realitysim_geometry::{Field, Isometry, Pose2, wrap_angle};

/// A kidnapping. The walk stops meanwhile and goes on from the new pose, along the route shifted and turned accordingly.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kidnapping {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Time of the pick-up, seconds since the start.
    pub at_s: f64,
    /// Time from pick-up to put-down, seconds. 0 means at once.
    #[serde(default)]
    pub duration_s: f64,
    /// Position [x, y] of the put-down in `map`, metres.
    pub to_m: [f64; 2],
    /// Yaw of the put-down in `map`, degrees.
    pub to_yaw_deg: f64,
    /// Height to which the robot is lifted half-way, metres.
    #[serde(default)]
    pub lift_m: f64,
}

/// An interruption of the walk, by a kidnapping or a fall. Times are seconds.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Interruption {
    at: f64,
    duration: f64,
    /// Pose of the footprint at which the walk stops.
    from: Pose2,
    /// Pose of the footprint from which the walk goes on.
    to: Pose2,
    /// Metres.
    lift: f64,
    /// Motion of the torso, if the robot falls instead of being carried.
    tumble: Option<Tumble>,
}

/// Interval at which the rest of the route is checked to be on the field, seconds.
const CHECK_EVERY_S: f64 = 0.25;

impl EffectKind for Kidnapping {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, field: &Field) -> Result<(), SceneError> {
        check_range(format_args!("{key}.at_s"), self.at_s, 0.0..=7200.0, "0 to 7200 s after the start")?;
        check_range(format_args!("{key}.duration_s"), self.duration_s, 0.0..=60.0, "0 to 60 s")?;
        check_on_field(format_args!("{key}.to_m"), self.to_m, field)?;
        check_range(format_args!("{key}.to_yaw_deg"), self.to_yaw_deg, -360.0..=360.0, "-360 to 360 degrees")?;
        check_range(format_args!("{key}.lift_m"), self.lift_m, 0.0..=2.0, "0 to 2 m")?;
        if self.lift_m > 0.0 && self.duration_s == 0.0 {
            return Err(refuse(format_args!("{key}.lift_m"), self.lift_m, "lifting needs a duration_s above 0"));
        }
        Ok(())
    }

    fn needs(&self, file: &SceneFile) -> Result<(), &'static str> {
        require(matches!(file.route, Route::Walk(_)), NEEDS_WALK)
    }

    fn add_to(&self, scene: &mut Scene, key: &str) -> Result<(), SceneError> {
        scene.interruption = Some(self.model(key, &scene.motion, &scene.field)?);
        Ok(())
    }
}

impl Kidnapping {
    /// The interruption of `motion`. Returns an error if the rest of the route leaves the field.
    pub(crate) fn model(&self, key: &str, motion: &Motion, field: &Field) -> Result<Interruption, SceneError> {
        let end = motion.duration();
        check_range(format_args!("{key}.at_s"), self.at_s, 0.0..=end, &format!("the route takes {end:.2} s"))?;
        let [x, y] = self.to_m;
        let interruption = Interruption {
            at: self.at_s,
            duration: self.duration_s,
            from: motion.at(self.at_s).map_from_base_footprint,
            to: Pose2::new(x, y, self.to_yaw_deg.to_radians()),
            lift: self.lift_m,
            tumble: None,
        };
        interruption.check_rest_on_field(key, motion, field)?;
        Ok(interruption)
    }
}

impl Interruption {
    /// The interruption by a fall. The robot falls where it is and stands up at `to`.
    pub(crate) fn tumbling(
        key: &str,
        at: f64,
        duration: f64,
        to: Pose2,
        tumble: Tumble,
        motion: &Motion,
        field: &Field,
    ) -> Result<Self, SceneError> {
        let end = motion.duration();
        check_range(format_args!("{key}.at_s"), at, 0.0..=end, &format!("the route takes {end:.2} s"))?;
        let from = motion.at(at).map_from_base_footprint;
        let interruption = Self { at, duration, from, to, lift: 0.0, tumble: Some(tumble) };
        interruption.check_rest_on_field(key, motion, field)?;
        Ok(interruption)
    }

    /// Checks that the rest of the route stays on the field.
    fn check_rest_on_field(&self, key: &str, motion: &Motion, field: &Field) -> Result<(), SceneError> {
        let end = motion.duration();
        for step in 0..=((end - self.at) / CHECK_EVERY_S) as usize {
            let time = self.at + step as f64 * CHECK_EVERY_S;
            let pose = self.shifted(&motion.at(time).map_from_base_footprint);
            let key =
                format!("{key}: the route, which goes on from to_m, {:.2} s after the start", time + self.duration);
            check_on_field(key, [pose.x, pose.y], field)?;
        }
        Ok(())
    }

    /// Duration of the interruption, seconds.
    pub(crate) fn duration(&self) -> f64 {
        self.duration
    }

    /// Time along the route, without the interruption, at `time` of the scene, seconds.
    pub(crate) fn route_time(&self, time: f64) -> f64 {
        if time < self.at { time } else { (time - self.duration).max(self.at) }
    }

    /// Whether the robot is carried, or falls and stands up, at `time`.
    pub(crate) fn is_under_way(&self, time: f64) -> bool {
        time >= self.at && time < self.at + self.duration
    }

    /// Motion of the footprint at `time`. `travel` is the motion along the route at [`Interruption::route_time`].
    pub(crate) fn travel(&self, time: f64, travel: Travel) -> Travel {
        if time < self.at {
            return travel;
        }
        if !self.is_under_way(time) {
            let map_from_base_footprint = self.shifted(&travel.map_from_base_footprint);
            return Travel { map_from_base_footprint, ..travel };
        }
        let progress = self.progress(time);
        let turn = wrap_angle(self.to.yaw - self.from.yaw);
        let map_from_base_footprint = Pose2 {
            x: self.from.x + progress * (self.to.x - self.from.x),
            y: self.from.y + progress * (self.to.y - self.from.y),
            yaw: wrap_angle(self.from.yaw + progress * turn),
        };
        Travel { map_from_base_footprint, speed: 0.0, turn: 0.0, ..travel }
    }

    /// Height of the lift at `time`, metres.
    pub(crate) fn lift_at(&self, time: f64) -> f64 {
        if !self.is_under_way(time) {
            return 0.0;
        }
        let progress = self.progress(time);
        // The factor behind `lift` is at most 1, and as smooth as the motion itself.
        self.lift * 4.0 * progress * (1.0 - progress)
    }

    /// Displacement of the torso about its feet at `time`, if the robot falls.
    pub(crate) fn tumble_at(&self, time: f64) -> Option<Isometry> {
        let tumble = self.tumble.as_ref().filter(|_| self.is_under_way(time))?;
        Some(tumble.at(time - self.at))
    }

    /// Progress of the motion from `from` to `to`, 0 to 1.
    fn progress(&self, time: f64) -> f64 {
        ease((time - self.at) / self.duration)
    }

    /// The pose after the interruption that corresponds to a pose on the original route.
    fn shifted(&self, on_route: &Pose2) -> Pose2 {
        self.to.compose(&self.from.inverse().compose(on_route))
    }
}
