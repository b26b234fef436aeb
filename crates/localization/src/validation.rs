//! Whether a pose is to be believed, and when the robot is to be looked for elsewhere.

use glam::DVec3;
use nalgebra::Matrix6;
use serde::{Deserialize, Serialize};

use super::localizer::{Fix, FrameSensors};
use super::refinement::Agreement;
use super::relocalization_trigger::RelocalizationTrigger;
use realitysim_geometry::{Field, Isometry, Physical, Pose2, longest_axis, wrap_angle};

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

/// How far the lines have confirmed the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Confidence {
    /// Not known where the robot is: the whole field is searched.
    #[default]
    Nowhere,
    /// A pose that still needs this many frames with good lines.
    Unconfirmed(u32),
    /// Confirmed; frames whose lines contradicted it, less those that have not since: without any it is to be used.
    Tracking(u32),
}

/// What the frames so far say of the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Standing {
    pub confidence: Confidence,
    /// When lines last agreed with the pose.
    agreed_ns: Option<i64>,
    /// Lines have agreed with the pose both ways, with hardly one too many.
    has_explained: bool,
    /// What frames have counted towards the next whole one that the pose needs.
    counted: f64,
    /// Somebody said where the robot is.
    was_told: bool,
    /// It was known before the restart.
    was_kept: bool,
    /// Frames in a row whose lines speak for a pose that needs confirming, but not clearly enough.
    unconvincing: u32,
    /// Where the whole field was last tried for a better pose, and how often, each time from elsewhere, there was none.
    looked_again_at: Option<Pose2>,
    found_again: u32,
    /// Looks in a row, from wherever, that had no better pose to offer.
    in_a_row: u32,
    second_look: RelocalizationTrigger,
    /// Poses of late that were found or told, and that the next frames contradicted: see [`CONFIRMATIONS`].
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

/// Frames with good lines that a pose found by search or kept over a restart needs.
///
/// On another field, or through another lens, some place looks right for a while again and again, until its lines contradict it. So each
/// pose that is refuted makes field, lens and mount more doubtful, and the next one needs their number plus one to the power of 1.5 times as
/// many frames: 8 after one, 15 after two, a hundred after ten. A robot that was carried has poses refuted too, but has been on its field
/// before: each [`PROOF_S`] of that makes them count less.
const CONFIRMATIONS: u32 = 3;
/// A pose that somebody told and that is wrong counts as three: it should have been right.
const REFUTED_IF_TOLD: f64 = 3.0;
/// A pose that was confirmed for so long was right: its robot was carried.
const PROVEN_S: f64 = 3.0;
const PROOF_S: f64 = 1.0;
/// Refuted poses count less and less, to a third after so long.
const REFUTED_FORGOTTEN_S: f64 = 20.0;
/// Frames that do not confirm a pose ask for as many more that do, up to so many.
const MOST_AGAINST: u32 = 6;
const MOST_CONFIRMATIONS: f64 = 10_000.0;
/// Errors of height and tilt that no mount and no gait has: five standard deviations of what the track expects.
const MOST_RISE_M: f64 = 0.07;
const MOST_TILT_RAD: f64 = 0.095;
const MOST_UNMEASURED_TILT_RAD: f64 = 0.25;
/// Frames in a row whose lines contradict the pose, after which the field is searched: 0.3 s at 10 Hz.
const LOST_AFTER: u32 = 3;
/// A pose as uncertain as this along its longer axis is none.
const LOST_M: f64 = 0.6;
/// How far from the carpet a camera may stand.
const OFF_FIELD_M: f64 = 1.0;
/// A pose is believed for so long without lines that agree.
const LONGEST_COAST_NS: i64 = 500_000_000;
/// Fewer line places than this say nothing for or against a pose.
const FEWEST_EXPECTED: usize = 12;
const FEWEST_FITTING: usize = 10;
/// Lines that chance puts where the pose has them more often than once in 10^4 frames say nothing: docs/lines.md.
pub const AGREES_DIGITS: f64 = 4.0;
/// With less than this share of fitting places the lines contradict the pose.
pub const CONTRADICTED: f64 = 0.5;
/// Through another lens, or from another height, some pose in the neighbourhood has most lines, each beside where it should be. Limits of how
/// far off the lines of a pose may lie on average that is to be confirmed, and of one that is: pixels of the picture that is looked at,
/// 200 of which are about a radian. Right poses are off by 0.05 on carpet and up to 0.33 on worn turf (docs/lines.md).
const CONFIRMED_WITHIN_PX: f64 = 0.35;
const BELIEVED_WITHIN_PX: f64 = 0.5;
/// And least digits for each line place: right poses have 0.14 or more on worn turf and 0.3 to 0.6 on carpet.
const DIGITS_PER_PLACE: f64 = 0.15;
/// What a frame needs to confirm a pose that was found by search or announced.
///
/// Of 10 to the power of so many poses, chance makes at most one fit as well. Within what somebody has said there are some 10^4 poses
/// that differ, on a whole field with all tilts and heights some 10^11.
const DIGITS_IF_TOLD: f64 = 8.0;
const DIGITS_IF_FOUND: f64 = 15.0;
const DIGITS_IF_FOUND_AGAIN: f64 = 8.0;
/// Least shares of the expected lines that stand out most where the pose has them, and that fit: lines of another place, or seen through
/// another lens, lie beside where a pose has them.
///
/// Of a pose that was told little has to be shown but that nothing contradicts it; in sun and shade over a field some fainter lines do not show.
const FOREMOST_IF_TOLD: f64 = 0.6;
const SHARE_IF_TOLD: f64 = 0.55;
/// Of one that was found: the fainter a picture's lines are, the fewer of them show in right places too. The limits fall with the width that is
/// seen half the time (`Agreement::half_seen_px`), for each pixel of it, but not below what right poses have on worn turf.
const FOREMOST_IF_FOUND: f64 = 1.0;
const FOREMOST_LESS_PER_PX: f64 = 0.07;
const LEAST_FOREMOST_IF_FOUND: f64 = 0.8;
const SHARE_IF_FOUND: f64 = 0.95;
const SHARE_LESS_PER_PX: f64 = 0.08;
/// Share of the expected lines that does not fit at right poses because lines are faint, for each pixel of that width beyond the first: they
/// have 0.95 and more on carpet and 0.75 on turf with 2.7.
const FAINT_SHARE_PER_PX: f64 = 0.12;
/// The usual share of lines that stand out follows each confirmed frame by this part of the difference.
const USUAL_RATE: f64 = 0.05;
/// Limits below that usual share: of a pose that was confirmed, of one that nothing but its lines has followed since the last frame,
/// of one that was found by search.
const USUAL_LESS: f64 = 0.3;
const USUAL_LESS_ALONE: f64 = 0.1;
const USUAL_LESS_IF_FOUND: f64 = 0.07;
/// Of one that was found by search and has not been confirmed for long: where a goal's surroundings have led elsewhere, the next lines that
/// come into view are missing.
const USUAL_LESS_IF_NEW: f64 = 0.15;
/// A frame counts fully towards confirming a pose that was found if it has so many digits, else as much less as it has fewer: few lines look
/// the same in several places.
const DIGITS_OF_A_FRAME: f64 = 40.0;
/// Line places that are many, and the share of fitting ones with which hardly one is missing.
const MANY: usize = 40;
const NEARLY_ALL: f64 = 0.9;
/// The share of fitting lines that a pose needs before one that was believed is left for it.
const SHARE_IF_BETTER: f64 = 0.7;
/// And so much less for each time that the whole field had no better pose to offer: behind others, or with a lens that is
/// not quite as it was calibrated, lines are missing in right places too.
const LESS_IF_FOUND_AGAIN: f64 = 0.2;
const MORE_IF_FOUND_AGAIN: f64 = 0.1;
const FOREMOST_LESS_IF_FOUND_AGAIN: f64 = 0.05;
/// Frames that are not convincing before the whole field is tried: the first time that a pose was found, and else.
const UNCONVINCING_AT_FIRST: u32 = 2;
const UNCONVINCING: u32 = 10;
/// Trying it again from the same place says nothing new, ...
const ELSEWHERE_M: f64 = 0.15;
const ELSEWHERE_RAD: f64 = 0.15;
/// ... unless so often in a row.
const IN_A_ROW: u32 = 2;
/// Share of the expected lines that fit, times share of the seen ones that are expected.
const AGREES_BOTH_WAYS: f64 = 0.6;
/// And where nothing but the lines says where the robot has gone since the last frame: half a metre farther on other lines fit too.
const AGREES_ALONE: f64 = 0.75;
/// And so much less for each pixel of the width that is seen half the time.
const AGREES_LESS_PER_PX: f64 = 0.04;
/// Of what a frame shows so much more may be unexplained where a confirmed pose explains nearly all that it expects.
const LESS_IF_HELD_FAST: f64 = 0.2;
/// Once it has explained so much.
const WELL_EXPLAINED: f64 = 0.95;
/// A frame that confirms a pose may leave this part of what any valid frame may leave unexplained near the robot. Of a pose that was told it is all:
/// a ball or sunlight may be a fourth of what little line is near.
const CONFIRMED_WITH_IF_TOLD: f64 = 1.0;
/// Of a pose that was found it is little, and more where lines are faint, since blades and glints of turf stand out as lines do.
const CONFIRMED_WITH_IF_FOUND: f64 = 0.2;
const MORE_PER_PX: f64 = 0.2;
/// And of the lines that the picture shows at any distance, this share must be painted where the pose has them: right poses have 0.97 or more on
/// carpet and 0.94 or more on turf in sun and shade (docs/lines.md).
pub const IN_VIEW: f64 = 0.94;
const BETTER_WITH: f64 = 0.2;

impl Physical for Standing {
    fn is_possible(&self) -> bool {
        self.looked_again_at.is_possible()
            && self.second_look.is_possible()
            && self.usual_foremost.is_possible()
            && self.counted.is_finite()
            && self.refuted.is_finite()
            && self.confirmed_s.is_finite()
            && self.proven_s.is_finite()
    }
}

impl Standing {
    /// A pose that was kept over a restart.
    pub fn kept(&mut self) {
        let was_kept = self.is_known();
        // Field, lens and mount may be others now.
        self.proven_s = 0.0;
        self.found();
        self.was_kept = was_kept;
    }

    /// By somebody, who has not been proven wrong.
    pub fn was_told(&self) -> bool {
        self.was_told
    }

    /// And since then the robot may have walked where it liked.
    pub fn was_away(&mut self) {
        self.was_kept = false;
    }

    /// A pose that was found by search.
    pub fn found(&mut self) {
        let (confidence, second_look) = (Confidence::Unconfirmed(self.confirmations()), RelocalizationTrigger::found());
        *self = Self { confidence, second_look, ..self.remembered() };
    }

    /// A pose that somebody announced.
    pub fn told(&mut self) {
        let confidence = Confidence::Unconfirmed(self.confirmations() / CONFIRMATIONS);
        *self = Self { confidence, was_told: true, ..self.remembered() };
    }

    /// What does not depend on where the robot is.
    fn remembered(&self) -> Self {
        let Self { agreed_ns, usual_foremost, refuted, proven_s, .. } = *self;
        Self { agreed_ns, usual_foremost, refuted, proven_s, ..Self::default() }
    }

    /// Frames with good lines that a pose needs now.
    fn confirmations(&self) -> u32 {
        let doubts = 1.0 + self.refuted / (1.0 + self.proven_s / PROOF_S);
        (f64::from(CONFIRMATIONS) * doubts * libm::sqrt(doubts)).min(MOST_CONFIRMATIONS) as u32
    }

    /// Lines speak for the pose, and not clearly: is there a better one?
    pub fn is_unconvincing(&self) -> bool {
        let is_first = !self.was_told && self.looked_again_at.is_none();
        self.unconvincing >= if is_first { UNCONVINCING_AT_FIRST } else { UNCONVINCING }
    }

    /// The pose is believed; is there a better one all the same?
    pub fn is_to_be_tried(&self) -> bool {
        self.second_look.is_due()
    }

    /// Something has just changed: the sooner it is tried the better.
    pub fn is_urgent(&self) -> bool {
        self.second_look.is_urgent()
    }

    /// Lines are missing that were there a moment ago: have some been taken for their neighbours?
    pub fn falls_short(&self, lines: &Agreement) -> bool {
        lines.expected >= FEWEST_EXPECTED && self.second_look.falls_to(lines.share_of_places())
    }

    /// There was none.
    pub fn has_been_tried(&mut self) {
        self.second_look.looked();
    }

    /// The whole field was tried while the robot was believed to be at `pose`.
    pub fn looked_again(&mut self, pose: Pose2, found_again: bool) {
        self.unconvincing = 0;
        let is_new = self.looked_again_at.is_none_or(|last| {
            pose.distance(&last) > ELSEWHERE_M || wrap_angle(pose.yaw - last.yaw).abs() > ELSEWHERE_RAD
        });
        self.in_a_row = if found_again { self.in_a_row + 1 } else { 0 };
        if is_new {
            self.looked_again_at = Some(pose);
            self.found_again = if found_again { self.found_again + 1 } else { 0 };
        }
    }

    /// Lines have confirmed the pose, and have not taken that back; or, as long as there were none, somebody else has.
    pub fn is_known(&self) -> bool {
        match self.confidence {
            Confidence::Nowhere => false,
            Confidence::Unconfirmed(_) => self.was_told || self.was_kept,
            Confidence::Tracking(_) => !self.is_lost(),
        }
    }

    /// The pose has been contradicted too often.
    pub fn is_lost(&self) -> bool {
        matches!(self.confidence, Confidence::Tracking(contradicted) if contradicted >= LOST_AFTER)
    }

    pub fn agreed(&mut self, stamp_ns: i64) {
        self.agreed_ns = Some(stamp_ns);
    }

    /// Why the pose is not to be used, and what that means for the next frames; `seconds` since the last one.
    pub fn judge(&mut self, rules: &Rules, moment: &FrameSensors, fix: &Fix, seconds: f64) -> Option<&'static str> {
        if fix.agreement.fitting >= MANY && fix.explained.share >= WELL_EXPLAINED {
            self.has_explained = true;
        }
        let doubt = self.complaint(rules, moment, fix);
        let shares = (fix.agreement.expected >= FEWEST_EXPECTED)
            .then(|| [fix.agreement.share_of_places(), share_if_clear(&fix.agreement)]);
        self.second_look.note(seconds, shares, matches!(doubt, Some("spread" | "few_lines")), fix.surprised);
        let contradicted = match doubt {
            Some("lines_disagree" | "not_standing" | "off_field") => true,
            // Something white stands before a place that is right all the same.
            Some("lines_unexplained") => !self.holds_fast(fix),
            _ => false,
        };
        self.note_proof(contradicted, seconds);
        if rules.refinement && is_lost(&fix.covariance) {
            self.confidence = Confidence::Nowhere;
        }
        self.confidence = match (self.confidence, doubt) {
            (Confidence::Tracking(bad), Some(_)) if contradicted => Confidence::Tracking(bad.saturating_add(1)),
            (Confidence::Unconfirmed(_), Some(_)) if contradicted => Confidence::Nowhere,
            (Confidence::Unconfirmed(needed), Some("spread" | "few_lines")) if !self.was_told => {
                self.unconvincing = self.unconvincing.saturating_add(1);
                Confidence::Unconfirmed(needed)
            }
            (other, Some(_)) => other,
            (Confidence::Unconfirmed(needed), None) if !self.confirms(rules, fix) => {
                self.unconvincing = self.unconvincing.saturating_add(1);
                // A pose whose lines speak against it now and then is not confirmed by a lucky frame.
                let speaks_against = fix.agreement.expected >= FEWEST_EXPECTED && needed < MOST_AGAINST;
                Confidence::Unconfirmed(needed + u32::from(speaks_against))
            }
            // Carried, or found in a wrong place: lines and odometry do not tell of one walk.
            (Confidence::Unconfirmed(_), None) if fix.surprised && !self.was_told => {
                Confidence::Unconfirmed(self.confirmations())
            }
            (Confidence::Unconfirmed(needed), None) => {
                let counts = if self.was_told { 1.0 } else { (fix.agreement.digits / DIGITS_OF_A_FRAME).min(1.0) };
                self.counted += if rules.refinement { counts } else { 1.0 };
                let whole = libm::floor(self.counted + 1e-9);
                self.counted = (self.counted - whole).max(0.0);
                match needed.saturating_sub(whole as u32) {
                    0 => Confidence::Tracking(0),
                    left => Confidence::Unconfirmed(left),
                }
            }
            (Confidence::Tracking(bad), None) => Confidence::Tracking(bad.saturating_sub(1)),
            (Confidence::Nowhere, None) => Confidence::Nowhere,
        };
        let confirmed = matches!(self.confidence, Confidence::Tracking(0)) && !self.second_look.may_be_elsewhere();
        let doubt = doubt.or((!confirmed).then_some("unconfirmed"));
        if doubt.is_none() && fix.agreement.expected >= FEWEST_EXPECTED {
            let foremost = fix.agreement.foremost;
            self.usual_foremost =
                Some(self.usual_foremost.map_or(foremost, |usual| usual + USUAL_RATE * (foremost - usual)));
        }
        doubt
    }

    /// Before this frame's verdict: what it says of field, lens and mount.
    fn note_proof(&mut self, contradicted: bool, seconds: f64) {
        self.refuted *= libm::exp(-seconds / REFUTED_FORGOTTEN_S);
        match self.confidence {
            Confidence::Tracking(bad) if contradicted && bad + 1 == LOST_AFTER && self.confirmed_s < PROVEN_S => {
                self.refuted += 1.0;
                self.proven_s = 0.0;
            }
            Confidence::Tracking(_) => {
                self.confirmed_s += seconds;
                self.proven_s += seconds;
            }
            Confidence::Unconfirmed(_) if contradicted => {
                self.refuted += if self.was_told { REFUTED_IF_TOLD } else { 1.0 };
            }
            _ => {}
        }
    }

    fn complaint(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> Option<&'static str> {
        held(self.confidence != Confidence::Nowhere, "pose_unknown")
            .or_else(|| held(!moment.stale || rules.random_walk, "sensors_stale"))
            .or_else(|| held(moment.odometry.is_some() || rules.random_walk, "no_odometry"))
            .or_else(|| self.complaint_of_lines(rules, moment, fix))
    }

    fn complaint_of_lines(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> Option<&'static str> {
        let Validity { share, points, spread_m, refined_m, explained } = *rules.valid;
        let half = rules.field.carpet_half_extent();
        let at = fix.map_from_optical.translation;
        let off_field = at.x.abs() > half.x + OFF_FIELD_M || at.y.abs() > half.y + OFF_FIELD_M;
        held(!fix.estimate.degenerate, "degenerate_weights").or_else(|| held(!off_field, "off_field")).or_else(|| {
            if !rules.refinement {
                return held(fix.support.weight >= points, "few_lines")
                    .or_else(|| held(fix.support.share >= share, "lines_disagree"))
                    .or_else(|| held(fix.estimate.spread_m <= spread_m, "spread"));
            }
            let least_explained = if self.holds_fast(fix) { explained - LESS_IF_HELD_FAST } else { explained };
            held(!fix.refined || stands(moment, &fix.map_from_optical), "not_standing")
                .or_else(|| held(!is_contradicted(&fix.agreement), "lines_disagree"))
                .or_else(|| held(fix.explained.share >= least_explained, "lines_unexplained"))
                .or_else(|| {
                    held(
                        !self.is_tracking() || (self.is_usual(fix) && (self.holds_fast(fix) || agrees_both_ways(fix))),
                        "lines_disagree",
                    )
                })
                .or_else(|| held(!self.is_tracking() || fix.agreement.rms_px <= BELIEVED_WITHIN_PX, "lines_disagree"))
                .or_else(|| held(fix.refined || self.agreed_lately(moment), "few_lines"))
                .or_else(|| held(longest_axis_of(&fix.covariance) <= refined_m, "spread"))
        })
    }

    /// All says that the lines in view are those of the confirmed pose, even where nothing else is known.
    pub fn is_in_view(&self, rules: &Rules, moment: &FrameSensors, fix: &Fix) -> bool {
        let holds_fast = (self.holds_fast(fix) && !fix.surprised) || !rules.refinement;
        self.is_tracking() && holds_fast && self.complaint_of_lines(rules, moment, fix).is_none()
    }

    /// A confirmed pose of which all but a few lines are seen where they should be, and that has explained all it saw.
    fn holds_fast(&self, fix: &Fix) -> bool {
        let lines = &fix.agreement;
        self.is_tracking() && self.has_explained && is_whole(lines)
    }

    /// Lines stand out where the pose has them about as they have in frames before.
    fn is_usual(&self, fix: &Fix) -> bool {
        let is_new = !self.was_told && self.proven_s < PROVEN_S;
        let less = match (fix.adrift, is_new) {
            (true, _) => USUAL_LESS_ALONE,
            (false, true) => USUAL_LESS_IF_NEW,
            (false, false) => USUAL_LESS,
        };
        let lines = &fix.agreement;
        lines.expected < FEWEST_EXPECTED || self.usual_foremost.is_none_or(|usual| lines.foremost >= usual - less)
    }

    /// The pose has been confirmed.
    pub fn is_tracking(&self) -> bool {
        matches!(self.confidence, Confidence::Tracking(_))
    }

    fn confirms(&self, rules: &Rules, fix: &Fix) -> bool {
        let lines = &fix.agreement;
        // Lines that lead elsewhere than somebody said need to be as many as if nobody had.
        let is_told = self.was_told && !fix.strays;
        let needed = if is_told { Needed::IF_TOLD } else { self.needed_if_found(lines) };
        !rules.refinement
            || (lines.digits >= needed.digits.max(DIGITS_PER_PLACE * lines.expected as f64)
                && lines.rms_px <= CONFIRMED_WITHIN_PX
                && !fix.misfits
                && fix.explained_in_view >= IN_VIEW
                && lines.foremost >= needed.foremost
                && lines.share >= needed.share
                && fix.explained.share >= share_of(needed.unexplained.min(1.0), rules.valid.explained))
    }

    /// Of a pose that was found by search, in a frame with such lines.
    fn needed_if_found(&self, lines: &Agreement) -> Needed {
        // Of a robot that stands still nothing new is seen; that no rival comes up twice in a row makes up for few lines, not for
        // missing ones.
        let is_alone = self.found_again > 0 || self.in_a_row >= IN_A_ROW;
        let again = f64::from(self.found_again);
        let foremost = (FOREMOST_IF_FOUND - FOREMOST_LESS_PER_PX * lines.half_seen_px).max(LEAST_FOREMOST_IF_FOUND);
        let foremost = foremost - FOREMOST_LESS_IF_FOUND_AGAIN * again;
        let usual = self.usual_foremost.map_or(0.0, |usual| usual - USUAL_LESS_IF_FOUND - LESS_IF_FOUND_AGAIN * again);
        let share = SHARE_IF_FOUND - SHARE_LESS_PER_PX * lines.half_seen_px;
        Needed {
            digits: if is_alone { DIGITS_IF_FOUND_AGAIN } else { DIGITS_IF_FOUND },
            foremost: if self.was_told { foremost } else { foremost.max(usual) },
            share: (share - LESS_IF_FOUND_AGAIN * again).max(CONTRADICTED),
            unexplained: CONFIRMED_WITH_IF_FOUND + MORE_PER_PX * lines.fainter_px() + MORE_IF_FOUND_AGAIN * again,
        }
    }

    fn agreed_lately(&self, moment: &FrameSensors) -> bool {
        self.agreed_ns.is_some_and(|then| moment.stamp_ns.saturating_sub(then) <= LONGEST_COAST_NS)
    }
}

/// The share of the expected lines that would fit if all were as clear as on well painted carpet.
fn share_if_clear(lines: &Agreement) -> f64 {
    (lines.share + FAINT_SHARE_PER_PX * lines.fainter_px()).min(1.0)
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
        digits: DIGITS_IF_TOLD,
        foremost: FOREMOST_IF_TOLD,
        share: SHARE_IF_TOLD,
        unexplained: CONFIRMED_WITH_IF_TOLD,
    };
}

/// What is not as wanted is complained of.
fn held(wanted: bool, complaint: &'static str) -> Option<&'static str> {
    (!wanted).then_some(complaint)
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
    let most_rad = if moment.tilt_is_measured { MOST_TILT_RAD } else { MOST_UNMEASURED_TILT_RAD };
    let rise = map_from_optical.translation.z - place.translation.z;
    rise.abs() <= MOST_RISE_M && nominal.cross(found).length() <= libm::sin(most_rad)
}

/// Enough lines are where the pose has them.
pub fn agrees(lines: &Agreement) -> bool {
    lines.fitting >= FEWEST_FITTING && lines.share > CONTRADICTED && lines.digits >= AGREES_DIGITS
}

/// Hardly one is missing.
pub fn is_whole(lines: &Agreement) -> bool {
    lines.fitting >= MANY && lines.share >= NEARLY_ALL
}

/// Enough to leave a pose for it that was believed.
pub fn convinces(lines: &Agreement, explained: f64, least_explained: f64) -> bool {
    lines.fitting >= MANY && lines.share >= SHARE_IF_BETTER && explained >= share_of(BETTER_WITH, least_explained)
}

/// Lines that should be seen and are not, and lines that are seen and should not be, say the same together: a pose that passes each
/// test alone may fail this one. docs/design.md says how often right poses do, and on which walks.
fn agrees_both_ways(fix: &Fix) -> bool {
    let lines = &fix.agreement;
    let faint = AGREES_LESS_PER_PX * lines.fainter_px();
    let least = if fix.adrift { AGREES_ALONE } else { AGREES_BOTH_WAYS - faint };
    lines.expected < FEWEST_EXPECTED || lines.share.min(lines.foremost) * fix.explained.share >= least
}

/// Too many lines are not.
pub fn is_contradicted(lines: &Agreement) -> bool {
    lines.expected >= FEWEST_EXPECTED && lines.share < CONTRADICTED
}

/// Too uncertain to be a place.
pub fn is_lost(covariance: &Matrix6<f64>) -> bool {
    longest_axis_of(covariance) > LOST_M
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

    fn needed(standing: &Standing) -> u32 {
        let mut found = *standing;
        found.found();
        match found.confidence {
            Confidence::Unconfirmed(frames) => frames,
            other => panic!("{other:?}"),
        }
    }

    /// So many poses in a row that the next frame contradicts.
    fn refuted(mut standing: Standing, poses: usize) -> Standing {
        for _ in 0..poses {
            standing.found();
            standing.note_proof(true, 0.1);
        }
        standing
    }

    #[test]
    fn each_refuted_pose_asks_for_more_frames_and_time_for_fewer() {
        let fresh = Standing::default();
        assert_eq!(needed(&fresh), CONFIRMATIONS);
        let needs: Vec<u32> = (0..12).map(|poses| needed(&refuted(fresh, poses))).collect();
        assert!(needs.windows(2).all(|pair| pair[0] < pair[1]), "{needs:?}");
        assert!((7..=9).contains(&needs[1]) && needs[10] > 90, "{needs:?}");
        let mut later = refuted(fresh, 10);
        later.confidence = Confidence::Nowhere;
        (0..1000).for_each(|_| later.note_proof(false, 0.1));
        assert_eq!(needed(&later), CONFIRMATIONS, "100 s later");
    }

    #[test]
    fn a_pose_that_was_told_and_is_wrong_counts_as_three() {
        let mut told = Standing::default();
        told.told();
        told.note_proof(true, 0.1);
        assert!(needed(&told).abs_diff(needed(&refuted(Standing::default(), 3))) <= 1);
    }

    /// On the field for some seconds, then carried: refuted poses count less, unless the seconds were few and ended in contradiction.
    #[test]
    fn a_robot_that_has_been_on_its_field_is_believed_sooner() {
        let tracked = |frames: u32| {
            let mut standing = Standing { confidence: Confidence::Tracking(0), ..Standing::default() };
            (0..frames).for_each(|_| standing.note_proof(false, 0.1));
            for bad in 0..LOST_AFTER {
                standing.confidence = Confidence::Tracking(bad);
                standing.note_proof(true, 0.1);
            }
            needed(&refuted(standing, 4))
        };
        let strange = needed(&refuted(Standing::default(), 4));
        assert!(tracked(100) <= 2 * CONFIRMATIONS, "{} after ten seconds", tracked(100));
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
                digits: DIGITS_OF_A_FRAME,
                foremost: 1.0,
                half_seen_px: 1.0,
            },
            explained: ExplainedLines { shown_m2: 1.0, share: 1.0 },
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: false,
            doubt: None,
        }
    }

    fn changed(change: impl FnOnce(&mut Fix)) -> Fix {
        let mut fix = good();
        change(&mut fix);
        fix
    }

    /// What is said of these frames, a tenth of a second apart.
    fn judged(standing: &mut Standing, frames: &[Fix]) -> Vec<Option<&'static str>> {
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
        frames.iter().map(|fix| standing.judge(&rules, &moment, fix, 0.1)).collect()
    }

    #[test]
    fn a_found_pose_needs_three_frames_of_forty_digits_or_more_with_fewer() {
        for (digits, frames) in [(80.0, 3), (DIGITS_OF_A_FRAME, 3), (DIGITS_OF_A_FRAME / 2.0, 6)] {
            let mut standing = Standing::default();
            standing.found();
            let said = judged(&mut standing, &vec![changed(|fix| fix.agreement.digits = digits); frames]);
            assert!(said[..frames - 1].iter().all(|doubt| *doubt == Some("unconfirmed")), "{digits} digits: {said:?}");
            assert_eq!(said[frames - 1], None, "{digits} digits: {said:?}");
        }
    }

    #[test]
    fn lines_of_elsewhere_never_confirm() {
        let poor = [
            changed(|fix| fix.agreement.rms_px = CONFIRMED_WITHIN_PX + 0.01),
            changed(|fix| fix.agreement.digits = DIGITS_PER_PLACE * 100.0 - 0.1),
            changed(|fix| fix.agreement.foremost = FOREMOST_IF_TOLD - 0.01),
            changed(|fix| fix.misfits = true),
            changed(|fix| fix.explained_in_view = IN_VIEW - 0.01),
        ];
        for told in [false, true] {
            for fix in &poor {
                let mut standing = Standing::default();
                if told {
                    standing.told()
                } else {
                    standing.found()
                }
                let said = judged(&mut standing, &vec![fix.clone(); 200]);
                assert!(said.iter().all(|doubt| *doubt == Some("unconfirmed")), "told: {told}, {fix:?}");
            }
        }
    }

    #[test]
    fn a_lucky_frame_among_poor_ones_confirms_nothing() {
        let frames: Vec<Fix> = (0..200).map(|index| changed(|fix| fix.misfits = index % 2 == 0)).collect();
        let mut standing = Standing::default();
        standing.found();
        assert!(judged(&mut standing, &frames).iter().all(|doubt| *doubt == Some("unconfirmed")));
    }

    #[test]
    fn a_contradicted_pose_is_used_again_after_as_many_good_frames() {
        let bad = changed(|fix| fix.agreement.rms_px = BELIEVED_WITHIN_PX + 0.01);
        let mut standing = Standing { confidence: Confidence::Tracking(0), ..Standing::default() };
        let said = judged(&mut standing, &[bad.clone(), bad, good(), good(), good()]);
        let disagree = Some("lines_disagree");
        assert_eq!(said, [disagree, disagree, Some("unconfirmed"), None, None]);
    }

    #[test]
    fn lines_that_are_missing_call_for_a_second_look_unless_they_are_too_faint_to_be_seen() {
        for (half_seen_px, share, is_due) in
            [(1.0, 0.95, false), (1.0, 0.75, true), (2.7, 0.75, false), (2.7, 0.5, true)]
        {
            let mut standing = Standing { confidence: Confidence::Tracking(0), ..Standing::default() };
            let frame = changed(|fix| {
                fix.agreement.share = share;
                fix.agreement.half_seen_px = half_seen_px;
            });
            judged(&mut standing, &vec![frame; 20]);
            assert_eq!(standing.is_to_be_tried(), is_due, "{share} of lines seen half the time at {half_seen_px} px");
        }
    }
}
