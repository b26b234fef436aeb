//! The last pose that was known, moved on by odometry and gyro since then.
//!
//! The lines of a field do not tell its halves apart. This pose decides which of two mirror poses is meant.

use serde::{Deserialize, Serialize};

use realitysim_geometry::{Physical, Pose2, wrap_angle};

/// The last known pose of `base_footprint` in `map`, carried on to the present.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LastKnownPose {
    pose: Pose2,
    /// Time for which neither a gyro nor lines have followed the robot's turns, seconds. A robot that fell, or was carried, may have
    /// been turned round in that time. Infinite when the pose has expired.
    unfollowed_s: f64,
    /// Whether the robot has lain on the floor since then.
    has_fallen: bool,
    /// Standard deviation of an announced pose, metres; 0 for a pose that lines have confirmed.
    sigma_m: f64,
    /// Time for which no odometry was heard, seconds.
    away_s: f64,
}

/// Distance from where odometry and gyro have it that a robot may slip without falling, metres.
const STUMBLES_M: f64 = 0.25;
/// Turn from where odometry and gyro have it that a robot may slip without falling, radians.
const STUMBLES_RAD: f64 = 0.2;
/// Distance by which a robot that fell may be off when it has got up, metres.
const SLIPS_M: f64 = 0.6;
/// Turn by which a robot that fell may be off when it has got up, radians.
const SLIPS_RAD: f64 = 0.35;
/// Standard deviations of an announced pose within which the robot must be.
const ANNOUNCED_SIGMAS: f64 = 3.0;
/// Time without gyro or lines after which the robot may face the other way, seconds. To lift a robot, turn it round and put it down
/// elsewhere takes 1.5 s at least.
const UNFOLLOWED_LIMIT_S: f64 = 1.0;
/// Speed at which the robot may have walked while no odometry was heard, metres per second.
const WALKS_M_PER_S: f64 = 0.4;
/// Rate at which the robot may have turned while no odometry was heard, radians per second.
const TURNS_RAD_PER_S: f64 = 0.25;

impl Physical for LastKnownPose {
    fn is_possible(&self) -> bool {
        let Self { pose, unfollowed_s, has_fallen: _, sigma_m, away_s } = self;
        // An infinite `unfollowed_s` is allowed: the pose has expired.
        pose.is_possible() && *unfollowed_s >= 0.0 && sigma_m.is_possible() && *away_s >= 0.0
    }
}

impl LastKnownPose {
    /// A pose that lines have confirmed.
    pub fn at(pose: Pose2) -> Self {
        Self::announced(pose, 0.0)
    }

    /// A pose that somebody has announced, with its standard deviation in metres.
    pub fn announced(pose: Pose2, sigma_m: f64) -> Self {
        Self { pose, unfollowed_s: 0.0, has_fallen: false, sigma_m, away_s: 0.0 }
    }

    /// Moves the pose by the robot's next step, which took `seconds`. `by_gyro`: a gyro has measured its turn.
    ///
    /// An announced pose needs no gyro: a robot that was just put down is not carried before lines have confirmed it.
    pub fn move_by(&mut self, step: &Pose2, seconds: f64, by_gyro: bool) {
        self.pose = self.pose.compose(step);
        let is_followed = by_gyro || self.sigma_m > 0.0;
        self.unfollowed_s += if is_followed { 0.0 } else { seconds };
    }

    /// Notes that lines have confirmed the pose: the robot has not been turned round.
    pub fn confirm_by_lines(&mut self) {
        self.unfollowed_s = 0.0;
    }

    /// Whether the robot may have been carried to its mirror pose unnoticed.
    pub fn may_be_mirrored(&self) -> bool {
        self.unfollowed_s > UNFOLLOWED_LIMIT_S
    }

    /// Notes that the robot has fallen.
    pub fn note_fall(&mut self) {
        self.has_fallen = true;
    }

    /// Notes that no odometry was heard for so many seconds.
    pub fn note_absence(&mut self, seconds: f64) {
        self.away_s += seconds;
    }

    /// Marks the pose as expired: no odometry was heard for too long.
    pub fn expire(&mut self) {
        self.unfollowed_s = f64::INFINITY;
    }

    /// Whether `pose` is farther away than slipping and the error of an announced pose explain.
    pub fn is_far_from(&self, pose: &Pose2) -> bool {
        pose.distance(&self.pose) > SLIPS_M.max(ANNOUNCED_SIGMAS * self.sigma_m)
    }

    /// `pose` or its mirror pose, whichever is nearer.
    pub fn nearer_mirror(&self, pose: Pose2) -> Pose2 {
        let apart = |other: &Pose2| other.distance(&self.pose) + wrap_angle(other.yaw - self.pose.yaw).abs();
        let mirrored = pose.mirrored();
        if apart(&mirrored) < apart(&pose) { mirrored } else { pose }
    }

    /// Whether the robot can have come to `pose` by itself, so that it is still in the half of the field that it was in.
    pub fn is_consistent_with(&self, pose: &Pose2) -> bool {
        let turned = wrap_angle(pose.yaw - self.pose.yaw).abs();
        let is_vague = self.has_fallen || self.away_s > 0.0 || self.sigma_m > 0.0;
        let (slips_m, slips_rad) = if is_vague { (SLIPS_M, SLIPS_RAD) } else { (STUMBLES_M, STUMBLES_RAD) };
        !self.may_be_mirrored()
            && pose.distance(&self.pose) <= slips_m + WALKS_M_PER_S * self.away_s
            && turned <= slips_rad + TURNS_RAD_PER_S * self.away_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_rises_where_it_fell_is_in_its_half_unless_turned() {
        let at = Pose2::new(0.1, -0.2, 1.0);
        let fell = |by_gyro: bool| {
            let mut known = LastKnownPose::at(at);
            known.move_by(&Pose2::new(0.0, 0.0, 2.5), 1.5, by_gyro);
            known.note_fall();
            known
        };
        let turned = Pose2 { yaw: wrap_angle(3.7), ..at };
        assert!(
            fell(true).is_consistent_with(&turned) && !fell(true).is_consistent_with(&at),
            "a gyro has seen it turn"
        );
        assert!(!fell(false).is_consistent_with(&turned), "nothing has");
        assert!(!fell(true).is_consistent_with(&Pose2 { x: 1.0, ..turned }), "carried");
        assert_eq!(fell(true).nearer_mirror(turned.mirrored()), turned.mirrored().mirrored());
    }

    #[test]
    fn a_robot_that_is_suddenly_elsewhere_may_be_in_either_half() {
        let known = LastKnownPose::at(Pose2::default());
        assert!(known.is_consistent_with(&Pose2::new(0.2, 0.1, 0.15)), "it stumbled");
        for put in [Pose2::new(0.3, 0.2, 0.0), Pose2::new(0.1, 0.0, 0.3)] {
            let mut fallen = known;
            fallen.note_fall();
            assert!(!known.is_consistent_with(&put) && fallen.is_consistent_with(&put));
        }
    }

    #[test]
    fn a_second_of_unmeasured_turns_leaves_either_half_possible() {
        let walks = |known: &mut LastKnownPose, by_gyro: bool| {
            (0..12).for_each(|_| known.move_by(&Pose2::default(), 0.1, by_gyro));
        };
        let mut known = LastKnownPose::at(Pose2::default());
        walks(&mut known, true);
        assert!(!known.may_be_mirrored() && known.is_consistent_with(&Pose2::default()));
        walks(&mut known, false);
        assert!(known.may_be_mirrored() && !known.is_consistent_with(&Pose2::default()));
        known.confirm_by_lines();
        known.move_by(&Pose2::default(), 0.9, false);
        assert!(!known.may_be_mirrored(), "lines have shown it in between");
    }

    #[test]
    fn an_announced_pose_holds_without_a_gyro() {
        let mut known = LastKnownPose::announced(Pose2::default(), 0.15);
        known.move_by(&Pose2::new(0.1, 0.0, 0.1), 3.0, false);
        assert!(!known.may_be_mirrored());
        assert!(known.is_consistent_with(&Pose2::new(0.3, 0.1, 0.3)));
        assert!(!known.is_far_from(&Pose2::new(0.6, 0.2, 0.0)) && known.is_far_from(&Pose2::new(0.8, 0.0, 0.0)));
        assert!(
            !LastKnownPose::announced(Pose2::default(), 0.5).is_far_from(&Pose2::new(1.4, 0.0, 0.0)),
            "it was announced less exactly"
        );
    }

    #[test]
    fn time_without_odometry_widens_what_is_possible_but_never_to_the_mirror() {
        let mut known = LastKnownPose::at(Pose2::default());
        known.note_absence(3.0);
        assert!(known.is_consistent_with(&Pose2::new(1.2, 0.9, -0.7)));
        assert!(!known.is_consistent_with(&Pose2::new(2.0, 0.0, 0.0)));
        known.note_absence(1.0);
        assert!(
            !known.is_consistent_with(&Pose2::new(0.0, 0.0, 1.7)),
            "beyond a right angle the mirror pose is as near"
        );
        known.expire();
        assert!(!known.is_consistent_with(&Pose2::default()));
    }
}
