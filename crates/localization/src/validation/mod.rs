//! Decides whether a pose is believed, and when the robot is searched for elsewhere.

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

/// Limits, set by the user, that a pose must keep to be believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validity {
    /// Smallest share of the expected line contrast that is found, without refinement.
    pub share: f64,
    /// Least painted line in view, in units of 10 cm, counted by its certainty, without refinement.
    pub points: f64,
    /// Largest standard deviation of the particles' position along its longer axis, without refinement, metres.
    pub spread_m: f64,
    /// Largest standard deviation of a refined pose's position along its longer axis, metres.
    pub refined_m: f64,
}

/// What the frames so far say about the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseValidator {
    /// How far lines have confirmed the pose.
    pub tracking: TrackingState,
    /// Time at which lines last agreed with the pose.
    agreed_ns: Option<i64>,
    /// Whether some frame had many lines that fit, and hardly one that the pose does not explain.
    has_explained: bool,
    /// Fraction of a frame that frames have counted towards the next whole one that the pose needs.
    counted: f64,
    /// Whether somebody announced the pose.
    was_announced: bool,
    /// Whether the pose was known before a restart.
    was_restored: bool,
    /// Number of frames whose lines do not clearly confirm a candidate.
    unconvincing: u32,
    /// Pose believed when the field was last searched for a better one.
    last_searched_at: Option<Pose2>,
    /// Number of searches in a row, each from another pose, that found no better one.
    found_again: u32,
    /// Number of searches in a row, from any pose, that found no better one.
    in_a_row: u32,
    trigger: RelocalizationTrigger,
    /// Number of recent poses, found or announced, that the next frames contradicted; older ones count less. See
    /// [`ValidationThresholds::confirmations`].
    refuted: f64,
    /// Time for which the pose has been confirmed, seconds.
    confirmed_s: f64,
    /// Time for which poses were confirmed that were not contradicted soon, seconds: field, lens and mount are as they are said to be.
    proven_s: f64,
    /// Mean share of the expected lines, over confirmed frames, that stand out most where the pose has them: what to expect of a right
    /// pose with this paint, lens and turf.
    usual_foremost: Option<f64>,
}

/// Rules of validation, which do not change from frame to frame.
#[derive(Clone, Copy, Debug)]
pub struct Rules<'a> {
    /// Limits set by the user.
    pub valid: &'a Validity,
    /// The field.
    pub field: &'a Field,
    /// Whether poses are refined.
    pub refinement: bool,
    /// Whether there is no odometry, on purpose.
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
    /// Starts over with a pose that was kept over a restart.
    pub fn start_restored(&mut self) {
        let was_restored = self.is_known();
        // Field, lens and mount may be others after a restart.
        self.proven_s = 0.0;
        self.start_found();
        self.was_restored = was_restored;
    }

    /// Whether somebody announced the pose, and no search has replaced it.
    pub fn was_announced(&self) -> bool {
        self.was_announced
    }

    /// Forgets that the pose was known before a restart: without odometry since then, the robot may be anywhere.
    pub fn drop_restored(&mut self) {
        self.was_restored = false;
    }

    /// Starts over with a pose that was found by search.
    pub fn start_found(&mut self) {
        let tracking = TrackingState::Candidate { missing: self.confirmations() };
        *self = Self { tracking, trigger: RelocalizationTrigger::after_search(), ..self.remembered() };
    }

    /// Starts over with a pose that somebody announced.
    pub fn start_announced(&mut self) {
        let tracking = TrackingState::Candidate { missing: self.confirmations() / THRESHOLDS.confirmations };
        *self = Self { tracking, was_announced: true, ..self.remembered() };
    }

    /// The part of the state that does not depend on where the robot is.
    fn remembered(&self) -> Self {
        let Self { agreed_ns, usual_foremost, refuted, proven_s, .. } = *self;
        Self { agreed_ns, usual_foremost, refuted, proven_s, ..Self::default() }
    }

    /// Number of frames with good lines that a new pose needs.
    fn confirmations(&self) -> u32 {
        let doubts = 1.0 + self.refuted / (1.0 + self.proven_s / THRESHOLDS.proof_s);
        (f64::from(THRESHOLDS.confirmations) * doubts * libm::sqrt(doubts)).min(THRESHOLDS.max_confirmations) as u32
    }

    /// Whether so many frames did not confirm a candidate clearly that a better pose is to be searched for.
    pub fn is_unconvincing(&self) -> bool {
        let is_first = !self.was_announced && self.last_searched_at.is_none();
        self.unconvincing >= if is_first { THRESHOLDS.unconvincing_first } else { THRESHOLDS.unconvincing_later }
    }

    /// Whether the field is to be searched for a better pose although this one is believed.
    pub fn relocalization_is_due(&self) -> bool {
        self.trigger.is_due()
    }

    /// Whether such a search is urgent, since something has just changed.
    pub fn is_urgent(&self) -> bool {
        self.trigger.is_urgent()
    }

    /// Whether lines are missing that were there in the last frames, so that some may have been taken for their neighbours.
    pub fn has_lost_lines(&self, lines: &Agreement) -> bool {
        lines.expected >= THRESHOLDS.min_expected && self.trigger.is_drop(lines.share_of_places())
    }

    /// Notes a search for a pose better than a believed one that found none.
    pub fn note_fruitless_search(&mut self) {
        self.trigger.note_fruitless_search();
    }

    /// Notes a search of the whole field for a pose better than the candidate `pose`. `found_again`: it found `pose` itself.
    pub fn note_search(&mut self, pose: Pose2, found_again: bool) {
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

    /// Whether the pose is known: lines have confirmed it and not taken that back, or it was announced or restored and lines have
    /// not decided yet.
    pub fn is_known(&self) -> bool {
        match self.tracking {
            TrackingState::Lost => false,
            TrackingState::Candidate { .. } => self.was_announced || self.was_restored,
            TrackingState::Tracking { .. } => !self.is_lost(),
        }
    }

    /// Whether the pose has been contradicted too often.
    pub fn is_lost(&self) -> bool {
        matches!(self.tracking, TrackingState::Tracking { contradictions } if contradictions >= THRESHOLDS.lost_after)
    }

    /// Notes that lines agreed with the pose at `stamp_ns`.
    pub fn note_agreement(&mut self, stamp_ns: i64) {
        self.agreed_ns = Some(stamp_ns);
    }

    /// Judges a frame, `seconds` after the last one, and updates the state. Returns why its pose is not to be used, if so.
    pub fn judge(&mut self, rules: &Rules, moment: &FrameSensors, fix: &Fix, seconds: f64) -> Option<Rejection> {
        if fix.agreement.fitting >= THRESHOLDS.many_places && fix.explained.share >= THRESHOLDS.well_explained {
            self.has_explained = true;
        }
        let rejection = self.rejection(rules, moment, fix);
        let shares = (fix.agreement.expected >= THRESHOLDS.min_expected)
            .then(|| [fix.agreement.share_of_places(), share_if_clear(&fix.agreement)]);
        self.trigger.note_frame(
            seconds,
            shares,
            matches!(rejection, Some(Rejection::Spread | Rejection::FewLines)),
            fix.contradicts_prediction,
        );
        let contradicted = match rejection {
            Some(Rejection::LinesDisagree | Rejection::NotStanding | Rejection::OffField) => true,
            // Something white may stand in view of a pose that is right all the same.
            Some(Rejection::LinesUnexplained) => !self.is_well_established(fix),
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
        let tells_the_usual = match rejection {
            None => fix.agreement.expected >= THRESHOLDS.min_expected,
            // Where the lines contradict the mount and nothing else, they still tell how such lines look in this picture.
            Some(Rejection::NotStanding) => {
                fix.agreement.digits >= THRESHOLDS.frame_digits && fix.explained.share >= THRESHOLDS.well_explained
            }
            Some(_) => false,
        };
        if tells_the_usual {
            let foremost = fix.agreement.foremost;
            self.usual_foremost =
                Some(self.usual_foremost.map_or(foremost, |usual| usual + THRESHOLDS.usual_rate * (foremost - usual)));
        }
        rejection
    }

    /// What the frame says about the pose. `rejection`: why the frame is rejected, if it is; `contradicted`: that contradicts the pose.
    fn verdict(&mut self, rules: &Rules, fix: &Fix, rejection: Option<Rejection>, contradicted: bool) -> FrameVerdict {
        if rules.refinement && is_lost(&fix.covariance) {
            return FrameVerdict::Uncertain;
        }
        if rejection.is_some() {
            return if contradicted { FrameVerdict::Contradicts } else { FrameVerdict::Silent };
        }
        let TrackingState::Candidate { missing } = self.tracking else { return FrameVerdict::Agrees { frames: 1 } };
        if !self.confirms(rules, fix) {
            // Frames that speak against the pose are counted, so that a lucky frame now and then does not confirm it.
            let has_lines = fix.agreement.expected >= THRESHOLDS.min_expected;
            return FrameVerdict::Unconvincing {
                against: has_lines && missing < THRESHOLDS.max_missing_by_unconvincing,
            };
        }
        // Lines and odometry show different motions: the robot is carried, or the pose is wrong.
        if fix.contradicts_prediction && !self.was_announced {
            return FrameVerdict::Surprises { needed: self.confirmations() };
        }
        let is_whole_frame = self.was_announced || !rules.refinement;
        self.counted += if is_whole_frame { 1.0 } else { (fix.agreement.digits / THRESHOLDS.frame_digits).min(1.0) };
        let frames = libm::floor(self.counted + 1e-9);
        self.counted = (self.counted - frames).max(0.0);
        FrameVerdict::Agrees { frames: frames as u32 }
    }

    /// Updates what frames say about field, lens and mount, before this frame's verdict.
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

    /// The reason why the frame's pose is not to be used, by sensors and lines.
    fn rejection(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> Option<Rejection> {
        reject_unless(self.tracking != TrackingState::Lost, Rejection::PoseUnknown)
            .or_else(|| reject_unless(!moment.stale || rules.random_walk, Rejection::SensorsStale))
            .or_else(|| reject_unless(moment.odometry.is_some() || rules.random_walk, Rejection::NoOdometry))
            .or_else(|| self.rejection_by_lines(rules, moment, fix))
    }

    /// The reason why the frame's pose is not to be used, by what the image shows.
    fn rejection_by_lines(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> Option<Rejection> {
        let Validity { share, points, spread_m, refined_m } = *rules.valid;
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
                let relief = if self.is_well_established(fix) { THRESHOLDS.held_fast_relief } else { 0.0 };
                let least_explained = THRESHOLDS.min_explained - relief;
                reject_unless(!fix.refined || stands(moment, &fix.map_from_optical), Rejection::NotStanding)
                    .or_else(|| reject_unless(!is_contradicted(&fix.agreement), Rejection::LinesDisagree))
                    .or_else(|| reject_unless(fix.explained.share >= least_explained, Rejection::LinesUnexplained))
                    .or_else(|| {
                        reject_unless(
                            !self.is_tracking()
                                || (self.is_usual(fix) && (self.is_well_established(fix) || agrees_both_ways(fix))),
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

    /// Whether the lines in view are certainly those of the confirmed pose, even if sensors are missing.
    pub fn is_in_view(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> bool {
        let is_certain = (self.is_well_established(fix) && !fix.contradicts_prediction) || !rules.refinement;
        self.is_tracking() && is_certain && self.rejection_by_lines(rules, moment, fix).is_none()
    }

    /// Whether the pose is confirmed, all but a few of its lines are seen where they should be, and it once explained nearly all
    /// that was seen.
    fn is_well_established(&self, fix: &Fix) -> bool {
        let lines = &fix.agreement;
        self.is_tracking() && self.has_explained && is_whole(lines)
    }

    /// Whether lines stand out where the pose has them about as much as in the frames before.
    fn is_usual(&self, fix: &Fix) -> bool {
        let is_new = !self.was_announced && self.proven_s < THRESHOLDS.proven_s;
        let less = match (fix.lacks_odometry, is_new) {
            (true, _) => THRESHOLDS.usual_margin_without_odometry,
            (false, true) => THRESHOLDS.usual_margin_new,
            (false, false) => THRESHOLDS.usual_margin,
        };
        let lines = &fix.agreement;
        lines.expected < THRESHOLDS.min_expected
            || self.usual_foremost.is_none_or(|usual| lines.foremost >= usual - less)
    }

    /// Whether the pose has been confirmed.
    pub fn is_tracking(&self) -> bool {
        matches!(self.tracking, TrackingState::Tracking { .. })
    }

    /// Whether the frame is good enough to confirm a candidate.
    fn confirms(&self, rules: &Rules, fix: &Fix) -> bool {
        let lines = &fix.agreement;
        // Lines that lead away from the announced pose must be as good as if nobody had announced one.
        let is_as_announced = self.was_announced && !fix.strays;
        let needed = if is_as_announced { ConfirmationNeeds::ANNOUNCED } else { self.needed_if_found(lines) };
        !rules.refinement
            || (lines.digits >= needed.digits.max(THRESHOLDS.digits_per_place * lines.expected as f64)
                && lines.rms_px <= THRESHOLDS.confirmed_rms_px
                && !fix.misfits
                && fix.explained_in_view >= THRESHOLDS.explained_in_view
                && lines.foremost >= needed.foremost
                && lines.share >= needed.share
                && fix.explained.share >= share_of(needed.unexplained.min(1.0), THRESHOLDS.min_explained))
    }

    /// What a frame with these lines must show to confirm a pose that was found by search.
    fn needed_if_found(&self, lines: &Agreement) -> ConfirmationNeeds {
        // A robot that stands still sees nothing new. Two searches in a row without a rival make up for few lines, not for missing ones.
        let is_alone = self.found_again > 0 || self.in_a_row >= THRESHOLDS.rivals_missing_in_a_row;
        let again = f64::from(self.found_again);
        let foremost = (THRESHOLDS.found_foremost - THRESHOLDS.found_foremost_per_px * lines.half_seen_px)
            .max(THRESHOLDS.min_found_foremost);
        let foremost = foremost - THRESHOLDS.found_again_foremost_relief * again;
        let usual = self.usual_foremost.map_or(0.0, |usual| {
            usual - THRESHOLDS.usual_margin_found - THRESHOLDS.found_again_foremost_relief * again
        });
        let share = THRESHOLDS.found_share - THRESHOLDS.found_share_per_px * lines.half_seen_px;
        ConfirmationNeeds {
            digits: if is_alone { THRESHOLDS.found_again_digits } else { THRESHOLDS.found_digits },
            foremost: if self.was_announced { foremost } else { foremost.max(usual) },
            share: (share - THRESHOLDS.found_again_share_relief * again).max(THRESHOLDS.contradicted_share),
            unexplained: THRESHOLDS.found_unexplained
                + THRESHOLDS.unexplained_per_px * lines.fainter_px()
                + THRESHOLDS.found_again_unexplained_relief * again,
        }
    }

    /// Whether lines agreed with the pose a short time ago.
    fn agreed_lately(&self, moment: &FrameSensors) -> bool {
        self.agreed_ns.is_some_and(|then| moment.stamp_ns.saturating_sub(then) <= THRESHOLDS.max_coast_ns)
    }
}

/// The share of the expected lines that would fit if all were as clear as on a well painted carpet.
fn share_if_clear(lines: &Agreement) -> f64 {
    (lines.share + THRESHOLDS.faint_share_per_px * lines.fainter_px()).min(1.0)
}

/// What a frame must show to confirm a pose.
struct ConfirmationNeeds {
    /// Digits against chance.
    digits: f64,
    /// Share of the expected lines that stand out most where the pose has them.
    foremost: f64,
    /// Share of the expected lines that fit.
    share: f64,
    /// Unexplained line near the robot, as a part of what a valid frame may have.
    unexplained: f64,
}

impl ConfirmationNeeds {
    const ANNOUNCED: Self = Self {
        digits: THRESHOLDS.announced_digits,
        foremost: THRESHOLDS.announced_foremost,
        share: THRESHOLDS.announced_share,
        unexplained: THRESHOLDS.announced_unexplained,
    };
}

/// The rejection, unless `is_held`.
fn reject_unless(is_held: bool, rejection: Rejection) -> Option<Rejection> {
    (!is_held).then_some(rejection)
}

/// The share that must be explained where only `part` of the unexplained line is allowed that a share of `least` leaves.
fn share_of(part: f64, least: f64) -> f64 {
    1.0 - part * (1.0 - least)
}

/// Whether the camera's height and tilt are those that IMU, joints and mount give for a standing robot.
pub fn stands(moment: &FrameSensors, map_from_optical: &Isometry) -> bool {
    let Some(place) = moment.footprint_from_optical else { return true };
    let down = |pose: &Isometry| pose.rotation.conjugate() * DVec3::NEG_Z;
    let (nominal, found) = (down(&place), down(map_from_optical));
    let most_rad = if moment.tilt_is_measured { THRESHOLDS.max_tilt_rad } else { THRESHOLDS.max_unmeasured_tilt_rad };
    let rise = map_from_optical.translation.z - place.translation.z;
    rise.abs() <= THRESHOLDS.max_rise_m && nominal.cross(found).length() <= libm::sin(most_rad)
}

/// Whether enough lines are where the pose has them.
pub fn agrees(lines: &Agreement) -> bool {
    lines.fitting >= THRESHOLDS.min_fitting
        && lines.share > THRESHOLDS.contradicted_share
        && lines.digits >= THRESHOLDS.agrees_digits
}

/// Whether many lines fit and hardly one is missing.
pub fn is_whole(lines: &Agreement) -> bool {
    lines.fitting >= THRESHOLDS.many_places && lines.share >= THRESHOLDS.nearly_all_share
}

/// Whether the lines of a pose are good enough to leave a believed pose for it.
pub fn convinces(lines: &Agreement, explained: f64) -> bool {
    lines.fitting >= THRESHOLDS.many_places
        && lines.share >= THRESHOLDS.better_share
        && explained >= share_of(THRESHOLDS.better_unexplained, THRESHOLDS.min_explained)
}

/// Whether lines agree with the pose both ways: those that should be seen are, and those that are seen should be.
///
/// A pose that passes each test alone may fail this joint one.
fn agrees_both_ways(fix: &Fix) -> bool {
    let lines = &fix.agreement;
    let faint = THRESHOLDS.both_ways_per_px * lines.fainter_px();
    let least = if fix.lacks_odometry { THRESHOLDS.both_ways_without_odometry } else { THRESHOLDS.both_ways - faint };
    lines.expected < THRESHOLDS.min_expected || lines.share.min(lines.foremost) * fix.explained.share >= least
}

/// Whether too many lines are not where the pose has them.
pub fn is_contradicted(lines: &Agreement) -> bool {
    lines.expected >= THRESHOLDS.min_expected && lines.share < THRESHOLDS.contradicted_share
}

/// Whether a pose is too uncertain to be of use.
pub fn is_lost(covariance: &Matrix6<f64>) -> bool {
    longest_axis_of(covariance) > THRESHOLDS.lost_sigma_m
}

/// Standard deviation of x and y along the longer axis, metres.
fn longest_axis_of(covariance: &Matrix6<f64>) -> f64 {
    longest_axis(covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)])
}

#[cfg(test)]
mod tests;
