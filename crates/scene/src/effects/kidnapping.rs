//! Somebody picks the robot up and puts it down elsewhere: its odometry knows nothing of it.

use serde::Deserialize;

use super::{Role, Tumble, ease};
use crate::SceneError;
use crate::check::{inside, refuse, within};
use crate::motion::{Motion, Travel};
use realitysim_geometry::{Field, Isometry, Pose2, wrap_angle};

/// The walk stops meanwhile and goes on from the new pose: what was straight ahead is straight ahead again.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Kidnapping {
    pub role: Option<Role>,
    /// Since the scene's start.
    pub at_s: f64,
    /// From pick-up to put-down; 0: at once.
    #[serde(default)]
    pub duration_s: f64,
    /// Where to: [x, y] in `map`.
    pub to_m: [f64; 2],
    pub to_yaw_deg: f64,
    /// How high the robot is lifted half-way.
    #[serde(default)]
    pub lift_m: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Carrying {
    at: f64,
    duration: f64,
    from: Pose2,
    to: Pose2,
    lift: f64,
    /// Of a robot that falls, in place of being carried.
    tumble: Option<Tumble>,
}

/// How often the rest of the route is asked whether it is on the field.
const CHECK_EVERY_S: f64 = 0.25;

impl Kidnapping {
    pub(super) fn check(&self, key: &str, field: &Field) -> Result<(), SceneError> {
        within(format_args!("{key}.at_s"), self.at_s, 0.0..=7200.0, "0 to 7200 s after the start")?;
        within(format_args!("{key}.duration_s"), self.duration_s, 0.0..=60.0, "0 to 60 s")?;
        inside(format_args!("{key}.to_m"), self.to_m, field)?;
        within(format_args!("{key}.to_yaw_deg"), self.to_yaw_deg, -360.0..=360.0, "-360 to 360 degrees")?;
        within(format_args!("{key}.lift_m"), self.lift_m, 0.0..=2.0, "0 to 2 m")?;
        if self.lift_m > 0.0 && self.duration_s == 0.0 {
            return Err(refuse(format_args!("{key}.lift_m"), self.lift_m, "lifting needs a duration_s above 0"));
        }
        Ok(())
    }

    pub(crate) fn model(&self, key: &str, motion: &Motion, field: &Field) -> Result<Carrying, SceneError> {
        let end = motion.duration();
        within(format_args!("{key}.at_s"), self.at_s, 0.0..=end, &format!("the route takes {end:.2} s"))?;
        let [x, y] = self.to_m;
        let carrying = Carrying {
            at: self.at_s,
            duration: self.duration_s,
            from: motion.at(self.at_s).map_from_base_footprint,
            to: Pose2::new(x, y, self.to_yaw_deg.to_radians()),
            lift: self.lift_m,
            tumble: None,
        };
        carrying.stays_inside(key, motion, field)?;
        Ok(carrying)
    }
}

impl Carrying {
    /// It falls where it is, and stands up at `to`.
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
        within(format_args!("{key}.at_s"), at, 0.0..=end, &format!("the route takes {end:.2} s"))?;
        let from = motion.at(at).map_from_base_footprint;
        let carrying = Self { at, duration, from, to, lift: 0.0, tumble: Some(tumble) };
        carrying.stays_inside(key, motion, field)?;
        Ok(carrying)
    }

    fn stays_inside(&self, key: &str, motion: &Motion, field: &Field) -> Result<(), SceneError> {
        let end = motion.duration();
        for step in 0..=((end - self.at) / CHECK_EVERY_S) as usize {
            let time = self.at + step as f64 * CHECK_EVERY_S;
            let pose = self.put_down(&motion.at(time).map_from_base_footprint);
            let place =
                format!("{key}: the route, which goes on from to_m, {:.2} s after the start", time + self.duration);
            inside(place, [pose.x, pose.y], field)?;
        }
        Ok(())
    }

    pub(crate) fn duration(&self) -> f64 {
        self.duration
    }

    /// How far along its route the robot is.
    pub(crate) fn route_time(&self, time: f64) -> f64 {
        if time < self.at { time } else { (time - self.duration).max(self.at) }
    }

    pub(crate) fn is_under_way(&self, time: f64) -> bool {
        time >= self.at && time < self.at + self.duration
    }

    /// `travel` is the route's, at [`Carrying::route_time`].
    pub(crate) fn travel(&self, time: f64, travel: Travel) -> Travel {
        if time < self.at {
            return travel;
        }
        if !self.is_under_way(time) {
            let map_from_base_footprint = self.put_down(&travel.map_from_base_footprint);
            return Travel { map_from_base_footprint, ..travel };
        }
        let share = self.share(time);
        let turn = wrap_angle(self.to.yaw - self.from.yaw);
        let map_from_base_footprint = Pose2 {
            x: self.from.x + share * (self.to.x - self.from.x),
            y: self.from.y + share * (self.to.y - self.from.y),
            yaw: wrap_angle(self.from.yaw + share * turn),
        };
        Travel { map_from_base_footprint, speed: 0.0, turn: 0.0, ..travel }
    }

    /// Metres above the ground.
    pub(crate) fn lift_at(&self, time: f64) -> f64 {
        if !self.is_under_way(time) {
            return 0.0;
        }
        let share = self.share(time);
        // At most 1, and as smooth as the way itself.
        self.lift * 4.0 * share * (1.0 - share)
    }

    /// How the torso lies about its feet, if it falls.
    pub(crate) fn tumble_at(&self, time: f64) -> Option<Isometry> {
        let tumble = self.tumble.as_ref().filter(|_| self.is_under_way(time))?;
        Some(tumble.at(time - self.at))
    }

    fn share(&self, time: f64) -> f64 {
        ease((time - self.at) / self.duration)
    }

    fn put_down(&self, on_route: &Pose2) -> Pose2 {
        self.to.compose(&self.from.inverse().compose(on_route))
    }
}
