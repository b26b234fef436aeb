//! Where the robot was when it last knew, carried on since: of two mirror poses it tells which is meant.

use serde::{Deserialize, Serialize};

use realitysim_geometry::{Physical, Pose2, wrap_angle};

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LastKnownPose {
    pose: Pose2,
    /// For how long neither a gyro nor lines have followed its turns, seconds: whoever fell, or was carried, may have been turned
    /// round.
    unfollowed_s: f64,
    /// It has lain on the floor since then.
    has_fallen: bool,
    /// How well it was known, standard deviation.
    sigma_m: f64,
    /// For how long nobody has counted anything, and why it may be farther off.
    away_s: f64,
}

/// So far from where odometry and gyro have it a robot that keeps standing slips, ...
const STUMBLES_M: f64 = 0.25;
const STUMBLES_RAD: f64 = 0.2;
/// ... and one that fell gets up.
const SLIPS_M: f64 = 0.6;
const SLIPS_RAD: f64 = 0.35;
const TOLD_SIGMAS: f64 = 3.0;
/// It takes longer to lift a robot, turn it round and put it down elsewhere: 1.5 s at least.
const LONGEST_UNFOLLOWED_S: f64 = 1.0;
/// So fast it may have walked and turned in the meantime.
const WALKS_M_PER_S: f64 = 0.4;
const TURNS_RAD_PER_S: f64 = 0.25;

impl Physical for LastKnownPose {
    fn is_possible(&self) -> bool {
        let Self { pose, unfollowed_s, has_fallen: _, sigma_m, away_s } = self;
        // It may never have been followed: infinitely long.
        pose.is_possible() && *unfollowed_s >= 0.0 && sigma_m.is_possible() && *away_s >= 0.0
    }
}

impl LastKnownPose {
    /// By lines.
    pub fn at(pose: Pose2) -> Self {
        Self::told(pose, 0.0)
    }

    pub fn told(pose: Pose2, sigma_m: f64) -> Self {
        Self { pose, unfollowed_s: 0.0, has_fallen: false, sigma_m, away_s: 0.0 }
    }

    /// By the next step, of whose turn a gyro knows or not. Who has just been put down and told where is not carried before lines
    /// have said anything.
    pub fn carry_on(&mut self, step: &Pose2, seconds: f64, by_gyro: bool) {
        self.pose = self.pose.compose(step);
        let is_followed = by_gyro || self.sigma_m > 0.0;
        self.unfollowed_s += if is_followed { 0.0 } else { seconds };
    }

    /// Lines are where it leads.
    pub fn is_seen(&mut self) {
        self.unfollowed_s = 0.0;
    }

    /// It may have been carried to its mirror pose and nobody would know.
    pub fn may_be_mirrored(&self) -> bool {
        self.unfollowed_s > LONGEST_UNFOLLOWED_S
    }

    pub fn fell(&mut self) {
        self.has_fallen = true;
    }

    /// Nobody has counted its steps.
    pub fn was_away(&mut self, seconds: f64) {
        self.away_s += seconds;
    }

    /// Nobody has counted its steps for longer than that says anything.
    pub fn is_past(&mut self) {
        self.unfollowed_s = f64::INFINITY;
    }

    /// Whether a pose is farther from it than who told it can have meant.
    pub fn is_far_from(&self, pose: &Pose2) -> bool {
        pose.distance(&self.pose) > SLIPS_M.max(TOLD_SIGMAS * self.sigma_m)
    }

    /// The one of two mirror poses that is nearer.
    pub fn nearer_of(&self, pose: Pose2) -> Pose2 {
        let apart = |other: &Pose2| other.distance(&self.pose) + wrap_angle(other.yaw - self.pose.yaw).abs();
        let mirrored = pose.mirrored();
        if apart(&mirrored) < apart(&pose) { mirrored } else { pose }
    }

    /// Whether a robot that is there has not been carried: then it is in the half of the field that it was in.
    pub fn leads_to(&self, pose: &Pose2) -> bool {
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
    fn who_gets_up_where_it_fell_is_in_its_half_and_who_may_have_been_turned_or_carried_in_either() {
        let at = Pose2::new(0.1, -0.2, 1.0);
        let fell = |by_gyro: bool| {
            let mut known = LastKnownPose::at(at);
            known.carry_on(&Pose2::new(0.0, 0.0, 2.5), 1.5, by_gyro);
            known.fell();
            known
        };
        let turned = Pose2 { yaw: wrap_angle(3.7), ..at };
        assert!(fell(true).leads_to(&turned) && !fell(true).leads_to(&at), "a gyro has seen it turn");
        assert!(!fell(false).leads_to(&turned), "nothing has");
        assert!(!fell(true).leads_to(&Pose2 { x: 1.0, ..turned }), "carried");
        assert_eq!(fell(true).nearer_of(turned.mirrored()), turned.mirrored().mirrored());
    }

    #[test]
    fn who_is_elsewhere_at_once_without_a_fall_may_be_in_either_half() {
        let known = LastKnownPose::at(Pose2::default());
        assert!(known.leads_to(&Pose2::new(0.2, 0.1, 0.15)), "it stumbled");
        for put in [Pose2::new(0.3, 0.2, 0.0), Pose2::new(0.1, 0.0, 0.3)] {
            let mut fallen = known;
            fallen.fell();
            assert!(!known.leads_to(&put) && fallen.leads_to(&put));
        }
    }

    #[test]
    fn whose_turns_neither_gyro_nor_lines_have_followed_for_a_second_may_be_in_either_half() {
        let walks = |known: &mut LastKnownPose, by_gyro: bool| {
            (0..12).for_each(|_| known.carry_on(&Pose2::default(), 0.1, by_gyro));
        };
        let mut known = LastKnownPose::at(Pose2::default());
        walks(&mut known, true);
        assert!(!known.may_be_mirrored() && known.leads_to(&Pose2::default()));
        walks(&mut known, false);
        assert!(known.may_be_mirrored() && !known.leads_to(&Pose2::default()));
        known.is_seen();
        known.carry_on(&Pose2::default(), 0.9, false);
        assert!(!known.may_be_mirrored(), "lines have shown it in between");
    }

    #[test]
    fn a_place_that_was_told_holds_without_a_gyro_until_lines_say_more() {
        let mut known = LastKnownPose::told(Pose2::default(), 0.15);
        known.carry_on(&Pose2::new(0.1, 0.0, 0.1), 3.0, false);
        assert!(!known.may_be_mirrored());
        assert!(known.leads_to(&Pose2::new(0.3, 0.1, 0.3)));
        assert!(!known.is_far_from(&Pose2::new(0.6, 0.2, 0.0)) && known.is_far_from(&Pose2::new(0.8, 0.0, 0.0)));
        assert!(
            !LastKnownPose::told(Pose2::default(), 0.5).is_far_from(&Pose2::new(1.4, 0.0, 0.0)),
            "it was told less well"
        );
    }

    #[test]
    fn the_longer_nobody_counts_the_farther_it_may_be_and_never_the_other_way_round() {
        let mut known = LastKnownPose::at(Pose2::default());
        known.was_away(3.0);
        assert!(known.leads_to(&Pose2::new(1.2, 0.9, -0.7)));
        assert!(!known.leads_to(&Pose2::new(2.0, 0.0, 0.0)));
        known.was_away(1.0);
        assert!(!known.leads_to(&Pose2::new(0.0, 0.0, 1.7)), "beyond a right angle the mirror pose is as near");
        known.is_past();
        assert!(!known.leads_to(&Pose2::default()));
    }
}
