//! Whether a pose is to be believed, and when the robot is to be looked for elsewhere.

mod thresholds;
mod tracking_state;

use glam::DVec3;
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};

use super::localizer::{Fix, FrameSensors};
use super::refinement::Agreement;
use super::rejection::Rejection;
use super::relocalization_trigger::RelocalizationTrigger;
use realitysim_geometry::{Field, Isometry, Physical, Pose2, longest_axis, wrap_angle};

pub use thresholds::{THRESHOLDS, ValidationThresholds};
use tracking_state::FrameVerdict;
pub use tracking_state::TrackingState;

/// What a pose needs to be believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validity {
    /// Share of the expected line contrast (particles) or of the expected line places (refinement) that is there.
    pub share: f64,
    /// Painted line in view in units of 10 cm, counted by its certainty.
    pub points: f64,
    /// Standard deviation of the position along its longer axis: of the particles, and of the refined pose.
    pub spread_m: f64,
    pub refined_m: f64,
    /// Share of the line seen that the field has where the pose puts it.
    pub explained: f64,
}

/// What the frames so far say of the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseValidator {
    pub tracking: TrackingState,
    /// When lines last agreed with the pose.
    agreed_ns: Option<i64>,
    /// Lines have agreed with the pose both ways, with hardly one too many.
    has_explained: bool,
    /// What frames have counted towards the next whole one that the pose needs.
    counted: f64,
    /// Somebody said where the robot is.
    was_announced: bool,
    /// It was known before the restart.
    was_restored: bool,
    /// Frames in a row whose lines speak for a pose that needs confirming, but not clearly enough.
    unconvincing: u32,
    /// Where the whole field was last tried for a better pose, and how often, each time from elsewhere, there was none.
    last_searched_at: Option<Pose2>,
    found_again: u32,
    /// Looks in a row, from wherever, that had no better pose to offer.
    in_a_row: u32,
    trigger: RelocalizationTrigger,
    /// Poses of late that were found or told, and that the next frames contradicted: see [`THRESHOLDS.confirmations`].
    refuted: f64,
    /// For how long the pose has been confirmed, seconds.
    confirmed_s: f64,
    /// For how long poses have been confirmed that were not contradicted soon: field, lens and mount are what they are said to be.
    proven_s: f64,
    /// Of confirmed frames so far, the share of the expected lines that stand out most where the pose has them: with this paint, lens and
    /// turf it is what to expect of a right pose.
    usual_foremost: Option<f64>,
}

/// What does not change from frame to frame.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    pub valid: &'a Validity,
    pub field: &'a Field,
    /// Poses are refined.
    pub refinement: bool,
    /// There is no odometry, on purpose.
    pub random_walk: bool,
}

impl Physical for PoseValidator {
    fn is_possible(&self) -> bool {
        self.last_searched_at.is_possible()
            && self.trigger.is_possible()
            && self.usual_foremost.is_possible()
            && self.counted.is_finite()
            && self.refuted.is_finite()
            && self.confirmed_s.is_finite()
            && self.proven_s.is_finite()
    }
}

impl PoseValidator {
    /// A pose that was kept over a restart.
    pub fn restored(&mut self) {
        let was_restored = self.is_known();
        // Field, lens and mount may be others now.
        self.proven_s = 0.0;
        self.found_by_search();
        self.was_restored = was_restored;
    }

    /// By somebody, who has not been proven wrong.
    pub fn was_announced(&self) -> bool {
        self.was_announced
    }

    /// And since then the robot may have walked where it liked.
    pub fn odometry_lost(&mut self) {
        self.was_restored = false;
    }

    /// A pose that was found by search.
    pub fn found_by_search(&mut self) {
        let tracking = TrackingState::Candidate { missing: self.confirmations() };
        *self = Self { tracking, trigger: RelocalizationTrigger::found(), ..self.remembered() };
    }

    /// A pose that somebody announced.
    pub fn announced(&mut self) {
        let tracking = TrackingState::Candidate { missing: self.confirmations() / THRESHOLDS.confirmations };
        *self = Self { tracking, was_announced: true, ..self.remembered() };
    }

    /// What does not depend on where the robot is.
    fn remembered(&self) -> Self {
        let Self { agreed_ns, usual_foremost, refuted, proven_s, .. } = *self;
        Self { agreed_ns, usual_foremost, refuted, proven_s, ..Self::default() }
    }

    /// Frames with good lines that a pose needs now.
    fn confirmations(&self) -> u32 {
        let doubts = 1.0 + self.refuted / (1.0 + self.proven_s / THRESHOLDS.proof_s);
        (f64::from(THRESHOLDS.confirmations) * doubts * libm::sqrt(doubts)).min(THRESHOLDS.max_confirmations) as u32
    }

    /// Lines speak for the pose, and not clearly: is there a better one?
    pub fn is_unconvincing(&self) -> bool {
        let is_first = !self.was_announced && self.last_searched_at.is_none();
        self.unconvincing >= if is_first { THRESHOLDS.unconvincing_first } else { THRESHOLDS.unconvincing_later }
    }

    /// The pose is believed; is there a better one all the same?
    pub fn relocalization_is_due(&self) -> bool {
        self.trigger.is_due()
    }

    /// Something has just changed: the sooner it is tried the better.
    pub fn is_urgent(&self) -> bool {
        self.trigger.is_urgent()
    }

    /// Lines are missing that were there a moment ago: have some been taken for their neighbours?
    pub fn falls_short(&self, lines: &Agreement) -> bool {
        lines.expected >= THRESHOLDS.min_expected && self.trigger.falls_to(lines.share_of_places())
    }

    /// There was none.
    pub fn found_nothing_better(&mut self) {
        self.trigger.looked();
    }

    /// The whole field was tried while the robot was believed to be at `pose`.
    pub fn field_was_searched(&mut self, pose: Pose2, found_again: bool) {
        self.unconvincing = 0;
        let is_new = self.last_searched_at.is_none_or(|last| {
            pose.distance(&last) > THRESHOLDS.elsewhere_m
                || wrap_angle(pose.yaw - last.yaw).abs() > THRESHOLDS.elsewhere_rad
        });
        self.in_a_row = if found_again { self.in_a_row + 1 } else { 0 };
        if is_new {
            self.last_searched_at = Some(pose);
            self.found_again = if found_again { self.found_again + 1 } else { 0 };
        }
    }

    /// Lines have confirmed the pose, and have not taken that back; or, as long as there were none, somebody else has.
    pub fn is_known(&self) -> bool {
        match self.tracking {
            TrackingState::Lost => false,
            TrackingState::Candidate { .. } => self.was_announced || self.was_restored,
            TrackingState::Tracking { .. } => !self.is_lost(),
        }
    }

    /// The pose has been contradicted too often.
    pub fn is_lost(&self) -> bool {
        matches!(self.tracking, TrackingState::Tracking { contradictions } if contradictions >= THRESHOLDS.lost_after)
    }

    pub fn agreed(&mut self, stamp_ns: i64) {
        self.agreed_ns = Some(stamp_ns);
    }

    /// Why the pose is not to be used, and what that means for the next frames; `seconds` since the last one.
    pub fn judge(&mut self, rules: &Rules, moment: &FrameSensors, fix: &Fix, seconds: f64) -> Option<Rejection> {
        if fix.agreement.fitting >= THRESHOLDS.many_places && fix.explained.share >= THRESHOLDS.well_explained {
            self.has_explained = true;
        }
        let rejection = self.rejection(rules, moment, fix);
        let shares = (fix.agreement.expected >= THRESHOLDS.min_expected)
            .then(|| [fix.agreement.share_of_places(), share_if_clear(&fix.agreement)]);
        self.trigger.note(
            seconds,
            shares,
            matches!(rejection, Some(Rejection::Spread | Rejection::FewLines)),
            fix.surprised,
        );
        let contradicted = match rejection {
            Some(Rejection::LinesDisagree | Rejection::NotStanding | Rejection::OffField) => true,
            // Something white stands before a place that is right all the same.
            Some(Rejection::LinesUnexplained) => !self.holds_fast(fix),
            _ => false,
        };
        self.note_proof(contradicted, seconds);
        let verdict = self.verdict(rules, fix, rejection, contradicted);
        if matches!(self.tracking, TrackingState::Candidate { .. }) {
            let is_inconclusive = verdict == FrameVerdict::Silent
                && matches!(rejection, Some(Rejection::Spread | Rejection::FewLines))
                && !self.was_announced;
            if is_inconclusive || matches!(verdict, FrameVerdict::Unconvincing { .. }) {
                self.unconvincing = self.unconvincing.saturating_add(1);
            }
        }
        self.tracking = self.tracking.after(verdict);
        let confirmed =
            matches!(self.tracking, TrackingState::Tracking { contradictions: 0 }) && !self.trigger.may_be_elsewhere();
        let rejection = rejection.or((!confirmed).then_some(Rejection::Unconfirmed));
        if rejection.is_none() && fix.agreement.expected >= THRESHOLDS.min_expected {
            let foremost = fix.agreement.foremost;
            self.usual_foremost =
                Some(self.usual_foremost.map_or(foremost, |usual| usual + THRESHOLDS.usual_rate * (foremost - usual)));
        }
        rejection
    }

    /// What the frame says of the pose, once it is known whether it is rejected, and whether that contradicts the pose.
    fn verdict(&mut self, rules: &Rules, fix: &Fix, rejection: Option<Rejection>, contradicted: bool) -> FrameVerdict {
        if rules.refinement && is_lost(&fix.covariance) {
            return FrameVerdict::Uncertain;
        }
        if rejection.is_some() {
            return if contradicted { FrameVerdict::Contradicts } else { FrameVerdict::Silent };
        }
        let TrackingState::Candidate { missing } = self.tracking else { return FrameVerdict::Agrees { frames: 1 } };
        if !self.confirms(rules, fix) {
            // A pose whose lines speak against it now and then is not confirmed by a lucky frame.
            let has_lines = fix.agreement.expected >= THRESHOLDS.min_expected;
            return FrameVerdict::Unconvincing {
                against: has_lines && missing < THRESHOLDS.max_missing_by_unconvincing,
            };
        }
        // Carried, or found in a wrong place: lines and odometry do not tell of one walk.
        if fix.surprised && !self.was_announced {
            return FrameVerdict::Surprises { needed: self.confirmations() };
        }
        let is_whole_frame = self.was_announced || !rules.refinement;
        self.counted += if is_whole_frame { 1.0 } else { (fix.agreement.digits / THRESHOLDS.frame_digits).min(1.0) };
        let frames = libm::floor(self.counted + 1e-9);
        self.counted = (self.counted - frames).max(0.0);
        FrameVerdict::Agrees { frames: frames as u32 }
    }

    /// Before this frame's verdict: what it says of field, lens and mount.
    fn note_proof(&mut self, contradicted: bool, seconds: f64) {
        self.refuted *= libm::exp(-seconds / THRESHOLDS.refuted_forgotten_s);
        match self.tracking {
            TrackingState::Tracking { contradictions }
                if contradicted
                    && contradictions + 1 == THRESHOLDS.lost_after
                    && self.confirmed_s < THRESHOLDS.proven_s =>
            {
                self.refuted += 1.0;
                self.proven_s = 0.0;
            }
            TrackingState::Tracking { .. } => {
                self.confirmed_s += seconds;
                self.proven_s += seconds;
            }
            TrackingState::Candidate { .. } if contradicted => {
                self.refuted += if self.was_announced { THRESHOLDS.refuted_if_announced } else { 1.0 };
            }
            _ => {}
        }
    }

    fn rejection(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> Option<Rejection> {
        reject_unless(self.tracking != TrackingState::Lost, Rejection::PoseUnknown)
            .or_else(|| reject_unless(!moment.stale || rules.random_walk, Rejection::SensorsStale))
            .or_else(|| reject_unless(moment.odometry.is_some() || rules.random_walk, Rejection::NoOdometry))
            .or_else(|| self.rejection_by_lines(rules, moment, fix))
    }

    fn rejection_by_lines(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> Option<Rejection> {
        let Validity { share, points, spread_m, refined_m, explained } = *rules.valid;
        let half = rules.field.carpet_half_extent();
        let at = fix.map_from_optical.translation;
        let off_field = at.x.abs() > half.x + THRESHOLDS.off_field_m || at.y.abs() > half.y + THRESHOLDS.off_field_m;
        reject_unless(!fix.estimate.degenerate, Rejection::DegenerateWeights)
            .or_else(|| reject_unless(!off_field, Rejection::OffField))
            .or_else(|| {
                if !rules.refinement {
                    return reject_unless(fix.support.weight >= points, Rejection::FewLines)
                        .or_else(|| reject_unless(fix.support.share >= share, Rejection::LinesDisagree))
                        .or_else(|| reject_unless(fix.estimate.spread_m <= spread_m, Rejection::Spread));
                }
                let least_explained =
                    if self.holds_fast(fix) { explained - THRESHOLDS.held_fast_relief } else { explained };
                reject_unless(!fix.refined || stands(moment, &fix.map_from_optical), Rejection::NotStanding)
                    .or_else(|| reject_unless(!is_contradicted(&fix.agreement), Rejection::LinesDisagree))
                    .or_else(|| reject_unless(fix.explained.share >= least_explained, Rejection::LinesUnexplained))
                    .or_else(|| {
                        reject_unless(
                            !self.is_tracking()
                                || (self.is_usual(fix) && (self.holds_fast(fix) || agrees_both_ways(fix))),
                            Rejection::LinesDisagree,
                        )
                    })
                    .or_else(|| {
                        reject_unless(
                            !self.is_tracking() || fix.agreement.rms_px <= THRESHOLDS.believed_rms_px,
                            Rejection::LinesDisagree,
                        )
                    })
                    .or_else(|| reject_unless(fix.refined || self.agreed_lately(moment), Rejection::FewLines))
                    .or_else(|| reject_unless(longest_axis_of(&fix.covariance) <= refined_m, Rejection::Spread))
            })
    }

    /// All says that the lines in view are those of the confirmed pose, even where nothing else is known.
    pub fn is_in_view(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> bool {
        let holds_fast = (self.holds_fast(fix) && !fix.surprised) || !rules.refinement;
        self.is_tracking() && holds_fast && self.rejection_by_lines(rules, moment, fix).is_none()
    }

    /// A confirmed pose of which all but a few lines are seen where they should be, and that has explained all it saw.
    fn holds_fast(&self, fix: &Fix) -> bool {
        let lines = &fix.agreement;
        self.is_tracking() && self.has_explained && is_whole(lines)
    }

    /// Lines stand out where the pose has them about as they have in frames before.
    fn is_usual(&self, fix: &Fix) -> bool {
        let is_new = !self.was_announced && self.proven_s < THRESHOLDS.proven_s;
        let less = match (fix.adrift, is_new) {
            (true, _) => THRESHOLDS.usual_margin_adrift,
            (false, true) => THRESHOLDS.usual_margin_new,
            (false, false) => THRESHOLDS.usual_margin,
        };
        let lines = &fix.agreement;
        lines.expected < THRESHOLDS.min_expected
            || self.usual_foremost.is_none_or(|usual| lines.foremost >= usual - less)
    }

    /// The pose has been confirmed.
    pub fn is_tracking(&self) -> bool {
        matches!(self.tracking, TrackingState::Tracking { .. })
    }

    fn confirms(&self, rules: &Rules, fix: &Fix) -> bool {
        let lines = &fix.agreement;
        // Lines that lead elsewhere than somebody said need to be as many as if nobody had.
        let is_told = self.was_announced && !fix.strays;
        let needed = if is_told { Needed::IF_TOLD } else { self.needed_if_found(lines) };
        !rules.refinement
            || (lines.digits >= needed.digits.max(THRESHOLDS.digits_per_place * lines.expected as f64)
                && lines.rms_px <= THRESHOLDS.confirmed_rms_px
                && !fix.misfits
                && fix.explained_in_view >= THRESHOLDS.explained_in_view
                && lines.foremost >= needed.foremost
                && lines.share >= needed.share
                && fix.explained.share >= share_of(needed.unexplained.min(1.0), rules.valid.explained))
    }

    /// Of a pose that was found by search, in a frame with such lines.
    fn needed_if_found(&self, lines: &Agreement) -> Needed {
        // Of a robot that stands still nothing new is seen; that no rival comes up twice in a row makes up for few lines, not for
        // missing ones.
        let is_alone = self.found_again > 0 || self.in_a_row >= THRESHOLDS.rivals_missing_in_a_row;
        let again = f64::from(self.found_again);
        let foremost = (THRESHOLDS.found_foremost - THRESHOLDS.found_foremost_per_px * lines.half_seen_px)
            .max(THRESHOLDS.min_found_foremost);
        let foremost = foremost - THRESHOLDS.found_again_foremost_relief * again;
        let usual = self
            .usual_foremost
            .map_or(0.0, |usual| usual - THRESHOLDS.usual_margin_found - THRESHOLDS.found_again_share_relief * again);
        let share = THRESHOLDS.found_share - THRESHOLDS.found_share_per_px * lines.half_seen_px;
        Needed {
            digits: if is_alone { THRESHOLDS.found_again_digits } else { THRESHOLDS.found_digits },
            foremost: if self.was_announced { foremost } else { foremost.max(usual) },
            share: (share - THRESHOLDS.found_again_share_relief * again).max(THRESHOLDS.contradicted_share),
            unexplained: THRESHOLDS.found_unexplained
                + THRESHOLDS.unexplained_per_px * lines.fainter_px()
                + THRESHOLDS.found_again_unexplained_relief * again,
        }
    }

    fn agreed_lately(&self, moment: &FrameSensors) -> bool {
        self.agreed_ns.is_some_and(|then| moment.stamp_ns.saturating_sub(then) <= THRESHOLDS.max_coast_ns)
    }
}

/// The share of the expected lines that would fit if all were as clear as on well painted carpet.
fn share_if_clear(lines: &Agreement) -> f64 {
    (lines.share + THRESHOLDS.faint_share_per_px * lines.fainter_px()).min(1.0)
}

/// What a frame has to show to confirm a pose.
struct Needed {
    digits: f64,
    foremost: f64,
    share: f64,
    /// As a part of what a valid frame may leave unexplained near the robot.
    unexplained: f64,
}

impl Needed {
    const IF_TOLD: Self = Self {
        digits: THRESHOLDS.announced_digits,
        foremost: THRESHOLDS.announced_foremost,
        share: THRESHOLDS.announced_share,
        unexplained: THRESHOLDS.announced_unexplained,
    };
}

/// The rejection, unless its condition holds.
fn reject_unless(is_held: bool, rejection: Rejection) -> Option<Rejection> {
    (!is_held).then_some(rejection)
}

/// The share that has to be explained where only `part` of what a single frame may leave over is allowed.
fn share_of(part: f64, least: f64) -> f64 {
    1.0 - part * (1.0 - least)
}

/// The camera is where IMU, joints and mount put that of a robot that stands: by its height and tilt.
pub fn stands(moment: &FrameSensors, map_from_optical: &Isometry) -> bool {
    let Some(place) = moment.footprint_from_optical else { return true };
    let down = |pose: &Isometry| pose.rotation.conjugate() * DVec3::NEG_Z;
    let (nominal, found) = (down(&place), down(map_from_optical));
    let most_rad = if moment.tilt_is_measured { THRESHOLDS.max_tilt_rad } else { THRESHOLDS.max_unmeasured_tilt_rad };
    let rise = map_from_optical.translation.z - place.translation.z;
    rise.abs() <= THRESHOLDS.max_rise_m && nominal.cross(found).length() <= libm::sin(most_rad)
}

/// Enough lines are where the pose has them.
pub fn agrees(lines: &Agreement) -> bool {
    lines.fitting >= THRESHOLDS.min_fitting
        && lines.share > THRESHOLDS.contradicted_share
        && lines.digits >= THRESHOLDS.agrees_digits
}

/// Hardly one is missing.
pub fn is_whole(lines: &Agreement) -> bool {
    lines.fitting >= THRESHOLDS.many_places && lines.share >= THRESHOLDS.nearly_all_share
}

/// Enough to leave a pose for it that was believed.
pub fn convinces(lines: &Agreement, explained: f64, least_explained: f64) -> bool {
    lines.fitting >= THRESHOLDS.many_places
        && lines.share >= THRESHOLDS.better_share
        && explained >= share_of(THRESHOLDS.better_unexplained, least_explained)
}

/// Lines that should be seen and are not, and lines that are seen and should not be, say the same together: a pose that passes each
/// test alone may fail this one. docs/design.md says how often right poses do, and on which walks.
fn agrees_both_ways(fix: &Fix) -> bool {
    let lines = &fix.agreement;
    let faint = THRESHOLDS.both_ways_per_px * lines.fainter_px();
    let least = if fix.adrift { THRESHOLDS.both_ways_adrift } else { THRESHOLDS.both_ways - faint };
    lines.expected < THRESHOLDS.min_expected || lines.share.min(lines.foremost) * fix.explained.share >= least
}

/// Too many lines are not.
pub fn is_contradicted(lines: &Agreement) -> bool {
    lines.expected >= THRESHOLDS.min_expected && lines.share < THRESHOLDS.contradicted_share
}

/// Too uncertain to be a place.
pub fn is_lost(covariance: &Matrix6<f64>) -> bool {
    longest_axis_of(covariance) > THRESHOLDS.lost_sigma_m
}

/// Standard deviation of x, y along the longer axis.
fn longest_axis_of(covariance: &Matrix6<f64>) -> f64 {
    longest_axis(covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)])
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;

    use super::*;
    use crate::estimate::Estimate;
    use crate::filter::Effort;
    use crate::line_distance_map::ExplainedLines;
    use crate::observation::Support;
    use realitysim_config::load_field;

    fn needed(validator: &PoseValidator) -> u32 {
        let mut found = *validator;
        found.found_by_search();
        match found.tracking {
            TrackingState::Candidate { missing } => missing,
            other => panic!("{other:?}"),
        }
    }

    /// So many poses in a row that the next frame contradicts.
    fn refuted(mut validator: PoseValidator, poses: usize) -> PoseValidator {
        for _ in 0..poses {
            validator.found_by_search();
            validator.note_proof(true, 0.1);
        }
        validator
    }

    #[test]
    fn each_refuted_pose_asks_for_more_frames_and_time_for_fewer() {
        let fresh = PoseValidator::default();
        assert_eq!(needed(&fresh), THRESHOLDS.confirmations);
        let needs: Vec<u32> = (0..12).map(|poses| needed(&refuted(fresh, poses))).collect();
        assert!(needs.windows(2).all(|pair| pair[0] < pair[1]), "{needs:?}");
        assert!((7..=9).contains(&needs[1]) && needs[10] > 90, "{needs:?}");
        let mut later = refuted(fresh, 10);
        later.tracking = TrackingState::Lost;
        (0..1000).for_each(|_| later.note_proof(false, 0.1));
        assert_eq!(needed(&later), THRESHOLDS.confirmations, "100 s later");
    }

    #[test]
    fn a_pose_that_was_announced_and_is_wrong_counts_as_three() {
        let mut told = PoseValidator::default();
        told.announced();
        told.note_proof(true, 0.1);
        assert!(needed(&told).abs_diff(needed(&refuted(PoseValidator::default(), 3))) <= 1);
    }

    /// On the field for some seconds, then carried: refuted poses count less, unless the seconds were few and ended in contradiction.
    #[test]
    fn a_robot_that_has_been_on_its_field_is_believed_sooner() {
        let tracked = |frames: u32| {
            let mut validator =
                PoseValidator { tracking: TrackingState::Tracking { contradictions: 0 }, ..PoseValidator::default() };
            (0..frames).for_each(|_| validator.note_proof(false, 0.1));
            for bad in 0..THRESHOLDS.lost_after {
                validator.tracking = TrackingState::Tracking { contradictions: bad };
                validator.note_proof(true, 0.1);
            }
            needed(&refuted(validator, 4))
        };
        let strange = needed(&refuted(PoseValidator::default(), 4));
        assert!(tracked(100) <= 2 * THRESHOLDS.confirmations, "{} after ten seconds", tracked(100));
        assert!(tracked(10) > strange, "{} after one second, {strange} without it", tracked(10));
    }

    /// A frame with many good lines, in the middle of the field.
    fn good() -> Fix {
        Fix {
            estimate: Estimate {
                best: Pose2::new(0.0, 0.0, 0.0),
                covariance: Matrix3::identity() * 1e-4,
                spread_m: 0.01,
                spread_yaw_rad: 0.01,
                effective_sample_size: 100.0,
                evidence: 0.0,
                degenerate: false,
            },
            support: Support { share: 1.0, weight: 100.0, points: 100 },
            map_from_optical: Isometry::IDENTITY,
            covariance: Matrix6::identity() * 1e-4,
            refined: true,
            surprised: false,
            strays: false,
            adrift: false,
            misfits: false,
            agreement: Agreement {
                expected: 100,
                fitting: 100,
                rms_px: 0.1,
                share: 1.0,
                visible: 100.0,
                digits: THRESHOLDS.frame_digits,
                foremost: 1.0,
                half_seen_px: 1.0,
            },
            explained: ExplainedLines { shown_m2: 1.0, share: 1.0 },
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: false,
            rejection: None,
        }
    }

    fn changed(change: impl FnOnce(&mut Fix)) -> Fix {
        let mut fix = good();
        change(&mut fix);
        fix
    }

    /// What is said of these frames, a tenth of a second apart.
    fn judged(validator: &mut PoseValidator, frames: &[Fix]) -> Vec<Option<Rejection>> {
        let field = Field::new(load_field("kid-2009").expect("shipped")).expect("checked");
        let valid = Validity { share: 0.35, points: 6.0, spread_m: 0.2, refined_m: 0.15, explained: 0.5 };
        let rules = Rules { valid: &valid, field: &field, refinement: true, random_walk: false };
        let moment = FrameSensors {
            stamp_ns: 0,
            odometry: Some(Pose2::new(0.0, 0.0, 0.0)),
            turned_rad: None,
            swayed_rad: None,
            camera_twist: None,
            turn_is_felt: false,
            footprint_from_optical: None,
            tilt_is_measured: true,
            lean_rad: None,
            stale: false,
        };
        frames.iter().map(|fix| validator.judge(&rules, &moment, fix, 0.1)).collect()
    }

    #[test]
    fn a_found_pose_needs_three_frames_of_forty_digits_or_more_with_fewer() {
        for (digits, frames) in [(80.0, 3), (THRESHOLDS.frame_digits, 3), (THRESHOLDS.frame_digits / 2.0, 6)] {
            let mut validator = PoseValidator::default();
            validator.found_by_search();
            let said = judged(&mut validator, &vec![changed(|fix| fix.agreement.digits = digits); frames]);
            assert!(
                said[..frames - 1].iter().all(|rejection| *rejection == Some(Rejection::Unconfirmed)),
                "{digits} digits: {said:?}"
            );
            assert_eq!(said[frames - 1], None, "{digits} digits: {said:?}");
        }
    }

    #[test]
    fn lines_of_elsewhere_never_confirm() {
        let poor = [
            changed(|fix| fix.agreement.rms_px = THRESHOLDS.confirmed_rms_px + 0.01),
            changed(|fix| fix.agreement.digits = THRESHOLDS.digits_per_place * 100.0 - 0.1),
            changed(|fix| fix.agreement.foremost = THRESHOLDS.announced_foremost - 0.01),
            changed(|fix| fix.misfits = true),
            changed(|fix| fix.explained_in_view = THRESHOLDS.explained_in_view - 0.01),
        ];
        for told in [false, true] {
            for fix in &poor {
                let mut validator = PoseValidator::default();
                if told {
                    validator.announced()
                } else {
                    validator.found_by_search()
                }
                let said = judged(&mut validator, &vec![fix.clone(); 200]);
                assert!(
                    said.iter().all(|rejection| *rejection == Some(Rejection::Unconfirmed)),
                    "told: {told}, {fix:?}"
                );
            }
        }
    }

    #[test]
    fn a_lucky_frame_among_poor_ones_confirms_nothing() {
        let frames: Vec<Fix> = (0..200).map(|index| changed(|fix| fix.misfits = index % 2 == 0)).collect();
        let mut validator = PoseValidator::default();
        validator.found_by_search();
        assert!(judged(&mut validator, &frames).iter().all(|rejection| *rejection == Some(Rejection::Unconfirmed)));
    }

    #[test]
    fn a_contradicted_pose_is_used_again_after_as_many_good_frames() {
        let bad = changed(|fix| fix.agreement.rms_px = THRESHOLDS.believed_rms_px + 0.01);
        let mut validator =
            PoseValidator { tracking: TrackingState::Tracking { contradictions: 0 }, ..PoseValidator::default() };
        let said = judged(&mut validator, &[bad.clone(), bad, good(), good(), good()]);
        let disagree = Some(Rejection::LinesDisagree);
        assert_eq!(said, [disagree, disagree, Some(Rejection::Unconfirmed), None, None]);
    }

    #[test]
    fn lines_that_are_missing_call_for_a_trigger_unless_they_are_too_faint_to_be_seen() {
        for (half_seen_px, share, is_due) in
            [(1.0, 0.95, false), (1.0, 0.75, true), (2.7, 0.75, false), (2.7, 0.5, true)]
        {
            let mut validator =
                PoseValidator { tracking: TrackingState::Tracking { contradictions: 0 }, ..PoseValidator::default() };
            let frame = changed(|fix| {
                fix.agreement.share = share;
                fix.agreement.half_seen_px = half_seen_px;
            });
            judged(&mut validator, &vec![frame; 20]);
            assert_eq!(
                validator.relocalization_is_due(),
                is_due,
                "{share} of lines seen half the time at {half_seen_px} px"
            );
        }
    }
}
