//! Limits of the decision whether a pose is believed.
//!
//! They were set by what right and wrong poses show on the walks and path-traced halls of docs/lines.md, which also says how often each kind of
//! false pose passes them (`realitysim falsify`).

/// Limits of the decision whether a pose is believed. Shares are of 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValidationThresholds {
    // What confirms a candidate.
    /// Frames with good lines that a pose needs which was found by search or restored after a restart, as long as no
    /// pose has been refuted. On another field, or through another lens, some place looks right for a while again and
    /// again, until its lines contradict it. So each refuted pose makes field, lens and mount more doubtful: after r
    /// of them a pose needs 3 (1 + r)^1.5 frames, which is 8 after one, 15 after two and a hundred after ten.
    pub confirmations: u32,
    /// An announced pose that is refuted counts as so many: it should have been right.
    pub refuted_if_announced: f64,
    /// Seconds. A pose that was confirmed for so long was right, and its robot was carried.
    pub proven_s: f64,
    /// Seconds. Each of them on a confirmed pose makes refuted poses count less: field, lens and mount are as they
    /// were said to be.
    pub proof_s: f64,
    /// Seconds, after which refuted poses count a third.
    pub refuted_forgotten_s: f64,
    /// Frames that speak against a candidate ask for one more frame each, until so many are missing.
    pub max_missing_by_unconvincing: u32,
    /// Frames that a pose needs at most, whatever was refuted.
    pub max_confirmations: f64,
    /// Digits against chance ([`Agreement::digits`](crate::refinement::Agreement::digits)) that a frame needs to
    /// confirm an announced pose: within what somebody has said some 10^4 poses differ. docs/lines.md derives these
    /// limits.
    pub announced_digits: f64,
    /// The same of a pose that was found by search: on a whole field, with all tilts and heights, some 10^11 poses
    /// differ.
    pub found_digits: f64,
    /// The same of a pose that a second search of the field has found again.
    pub found_again_digits: f64,
    /// And least digits for each line place: right poses have 0.14 or more on worn turf, and 0.3 to 0.6 on carpet.
    pub digits_per_place: f64,
    /// Root mean square distance of the found line places from where a pose has them that is to be confirmed, in
    /// pixels of the picture that is looked at, 200 of which are about a radian. Right poses have 0.05 on carpet and
    /// up to 0.33 on worn turf; through another lens, or from another height, some pose in the neighbourhood has most
    /// lines, each beside where it should be.
    pub confirmed_rms_px: f64,
    /// Share of the expected lines that must stand out most where an announced pose has them. Little has to be shown
    /// but that nothing contradicts it: in sun and shade some fainter lines do not show.
    pub announced_foremost: f64,
    /// Share of the expected lines that must fit an announced pose.
    pub announced_share: f64,
    /// Share of the expected lines that must stand out most where a found pose has them, less the next for each pixel
    /// of the line width that is seen half the time: where lines are faint, fewer of them show in right places too.
    pub found_foremost: f64,
    /// See above; per pixel.
    pub found_foremost_per_px: f64,
    /// What right poses have on worn turf: the share above falls no lower.
    pub min_found_foremost: f64,
    /// Share of the expected lines that must fit a found pose, less the next for each pixel of that width.
    pub found_share: f64,
    /// See above; per pixel.
    pub found_share_per_px: f64,
    /// Part of what any valid frame may leave unexplained near the robot that a frame may leave which confirms an
    /// announced pose. It is all: a ball or sunlight may be a fourth of what little line is near.
    pub announced_unexplained: f64,
    /// The same of a found pose, and the next more for each pixel of that width beyond the first, since blades and
    /// glints of turf stand out as lines do.
    pub found_unexplained: f64,
    /// See above; per pixel.
    pub unexplained_per_px: f64,
    /// Share of the lines in the picture, at any distance, that must be painted where the pose has them. Right poses
    /// have 0.97 or more on carpet and 0.94 or more on turf in sun and shade (docs/lines.md).
    pub explained_in_view: f64,
    /// A frame counts fully towards confirming a found pose if it has so many digits, else as much less as it has
    /// fewer: few lines look the same in several places.
    pub frame_digits: f64,
    /// Frames that do not convince, before the whole field is tried for a better pose: the first time after a search.
    pub unconvincing_first: u32,
    /// The same afterwards, and of an announced pose.
    pub unconvincing_later: u32,
    /// Metres. Trying the field again from as near says nothing new, ...
    pub elsewhere_m: f64,
    /// ... or from a heading as near, in radians, ...
    pub elsewhere_rad: f64,
    /// ... unless there was no better pose so often in a row.
    pub rivals_missing_in_a_row: u32,
    /// Each time that the whole field had no better pose to offer, so much less has to fit: behind others, or with a
    /// lens that is not quite as it was calibrated, lines are missing in right places too.
    pub found_again_share_relief: f64,
    /// And so much more may be left unexplained, as a part of what any valid frame may.
    pub found_again_unexplained_relief: f64,
    /// And so much less has to stand out most.
    pub found_again_foremost_relief: f64,
    // What contradicts a pose, and what agrees with it.
    /// Fewer line places say nothing for or against a pose.
    pub min_expected: usize,
    /// Line places that must fit for a frame to agree with a pose.
    pub min_fitting: usize,
    /// Digits against chance that a frame needs to agree with a pose: chance does so once in 10^4 frames
    /// (docs/lines.md).
    pub agrees_digits: f64,
    /// With a smaller share of fitting places the lines contradict the pose.
    pub contradicted_share: f64,
    /// Root mean square distance of the line places of a confirmed pose, pixels: see the same of one that is to be
    /// confirmed.
    pub believed_rms_px: f64,
    /// Line places that are many.
    pub many_places: usize,
    /// Share of fitting ones with which hardly a line is missing.
    pub nearly_all_share: f64,
    /// Share of the expected lines that do not fit at right poses because they are faint, for each pixel of the line
    /// width that is seen half the time, beyond the first. Right poses have 0.95 and more on carpet, and 0.75 on turf
    /// where that width is 2.7 pixels.
    pub faint_share_per_px: f64,
    /// The usual share of lines that stand out most follows each confirmed frame by this part of the difference.
    pub usual_rate: f64,
    /// A confirmed pose is contradicted where fewer lines stand out than usual, by this share.
    pub usual_margin: f64,
    /// The same where nothing but its lines has followed the pose since the last frame.
    pub usual_margin_adrift: f64,
    /// The same of a pose that is found by search.
    pub usual_margin_found: f64,
    /// The same of one that has not been confirmed for long: where a goal's surroundings have led elsewhere, the next
    /// lines that come into view are missing.
    pub usual_margin_new: f64,
    /// Least share of the expected lines that fit, times the share of the seen lines that are expected.
    pub both_ways: f64,
    /// The same where nothing but the lines says where the robot has gone since the last frame: half a metre farther
    /// on other lines fit too.
    pub both_ways_adrift: f64,
    /// And so much less for each pixel of the line width that is seen half the time, beyond the first.
    pub both_ways_per_px: f64,
    /// So much more may be left unexplained where a confirmed pose explains nearly all that it expects.
    pub held_fast_relief: f64,
    /// Share of the seen lines that it must have explained once for that.
    pub well_explained: f64,
    /// Metres by which no mount and no gait moves the camera of a standing robot up or down: five standard deviations
    /// of what is expected.
    pub max_rise_m: f64,
    /// The same of its tilt, radians.
    pub max_tilt_rad: f64,
    /// The same without an IMU, radians.
    pub max_unmeasured_tilt_rad: f64,
    // When a pose is given up.
    /// Frames in a row whose lines contradict a confirmed pose before the field is searched: 0.3 s at 10 Hz.
    pub lost_after: u32,
    /// Standard deviation along the longer axis, metres, of what is no pose any more.
    pub lost_sigma_m: f64,
    /// How far from the carpet a camera may be, metres.
    pub off_field_m: f64,
    /// For so long a pose is believed without lines that agree, nanoseconds.
    pub max_coast_ns: i64,
    /// Share of fitting lines that a pose needs before a confirmed one is left for it.
    pub better_share: f64,
    /// Part of what any valid frame may leave unexplained that such a pose may leave.
    pub better_unexplained: f64,
}

/// The limits in use.
pub const THRESHOLDS: ValidationThresholds = ValidationThresholds {
    confirmations: 3,
    refuted_if_announced: 3.0,
    proven_s: 3.0,
    proof_s: 1.0,
    refuted_forgotten_s: 20.0,
    max_missing_by_unconvincing: 6,
    max_confirmations: 10_000.0,
    announced_digits: 8.0,
    found_digits: 15.0,
    found_again_digits: 8.0,
    digits_per_place: 0.15,
    confirmed_rms_px: 0.35,
    announced_foremost: 0.6,
    announced_share: 0.55,
    found_foremost: 1.0,
    found_foremost_per_px: 0.07,
    min_found_foremost: 0.8,
    found_share: 0.95,
    found_share_per_px: 0.08,
    announced_unexplained: 1.0,
    found_unexplained: 0.2,
    unexplained_per_px: 0.2,
    explained_in_view: 0.94,
    frame_digits: 40.0,
    unconvincing_first: 2,
    unconvincing_later: 10,
    elsewhere_m: 0.15,
    elsewhere_rad: 0.15,
    rivals_missing_in_a_row: 2,
    found_again_share_relief: 0.2,
    found_again_unexplained_relief: 0.1,
    found_again_foremost_relief: 0.05,
    min_expected: 12,
    min_fitting: 10,
    agrees_digits: 4.0,
    contradicted_share: 0.5,
    believed_rms_px: 0.5,
    many_places: 40,
    nearly_all_share: 0.9,
    faint_share_per_px: 0.12,
    usual_rate: 0.05,
    usual_margin: 0.3,
    usual_margin_adrift: 0.1,
    usual_margin_found: 0.07,
    usual_margin_new: 0.15,
    both_ways: 0.6,
    both_ways_adrift: 0.75,
    both_ways_per_px: 0.04,
    held_fast_relief: 0.2,
    well_explained: 0.95,
    max_rise_m: 0.07,
    max_tilt_rad: 0.095,
    max_unmeasured_tilt_rad: 0.25,
    lost_after: 3,
    lost_sigma_m: 0.6,
    off_field_m: 1.0,
    max_coast_ns: 500_000_000,
    better_share: 0.7,
    better_unexplained: 0.2,
};
