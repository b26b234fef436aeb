//! Limits of the decision whether a pose is believed.
//!
//! They were set by what right and wrong poses show on the walks and path-traced halls of docs/explanation/lines.md, which also says how often
//! each kind of false pose passes them (`realitysim measure falsify`).

/// Limits of the decision whether a pose is believed. Shares are of 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ValidationThresholds {
    // What confirms a candidate.
    /// Number of frames with good lines that a pose needs which was found by search or restored after a restart, as long as no
    /// pose has been refuted.
    ///
    /// On another field, or through another lens, some place looks right for a while again and again, until its lines
    /// contradict it. So each refuted pose makes field, lens and mount more doubtful: after r of them a pose needs
    /// 3 (1 + r)^1.5 frames, which is 8 after one, 15 after two and a hundred after ten.
    pub confirmations: u32,
    /// Number of refuted poses that one refuted announced pose counts for: it should have been right.
    pub refuted_if_announced: f64,
    /// Time, seconds, for which a pose must have been confirmed to have been right: when it is contradicted later, the robot was carried.
    pub proven_s: f64,
    /// Time constant, seconds, by which time on a confirmed pose lessens the count of refuted poses: field, lens and mount
    /// are as they were said to be.
    pub proof_s: f64,
    /// Time, seconds, after which a refuted pose counts a third.
    pub refuted_forgotten_s: f64,
    /// Each frame that speaks against a candidate asks for one more frame, until this many are missing.
    pub max_missing_by_unconvincing: u32,
    /// Largest number of frames that a pose needs, however many were refuted.
    pub max_confirmations: f64,
    /// Digits against chance ([`Agreement::digits`](crate::refinement::Agreement::digits)) that a frame needs to
    /// confirm an announced pose: within the error of an announcement some 10^4 poses differ. docs/explanation/lines.md derives these
    /// limits.
    pub announced_digits: f64,
    /// Digits that a frame needs to confirm a pose found by search: on a whole field, with all tilts and heights, some
    /// 10^11 poses differ.
    pub found_digits: f64,
    /// Digits that a frame needs to confirm a pose that a second search of the field has found again.
    pub found_again_digits: f64,
    /// Digits per expected line place that a frame needs besides: right poses have 0.14 or more on worn turf, and 0.3 to 0.6
    /// on carpet.
    pub digits_per_place: f64,
    /// Largest root mean square distance of the found line places from where a pose has them, for a frame that confirms it, in
    /// pixels of the working image, 200 of which are about a radian.
    ///
    /// Right poses have 0.05 on carpet and up to 0.33 on worn turf. Through another lens, or from another height, some pose in
    /// the neighbourhood has most lines, each beside where it should be.
    pub confirmed_rms_px: f64,
    /// Share of the expected lines that must stand out most where an announced pose has them. It is small, since it is enough
    /// that nothing contradicts the pose: in sun and shade some fainter lines do not show.
    pub announced_foremost: f64,
    /// Share of the expected lines that must fit an announced pose.
    pub announced_share: f64,
    /// Share of the expected lines that must stand out most where a found pose has them, before
    /// [`Self::found_foremost_per_px`] is subtracted.
    pub found_foremost: f64,
    /// Reduction of [`Self::found_foremost`] for each pixel of the line width that is seen half the time: where lines are
    /// faint, fewer of them show at right poses too.
    pub found_foremost_per_px: f64,
    /// Smallest value of that share after the reduction: what right poses have on worn turf.
    pub min_found_foremost: f64,
    /// Share of the expected lines that must fit a found pose, before [`Self::found_share_per_px`] is subtracted.
    pub found_share: f64,
    /// Reduction of [`Self::found_share`] for each pixel of the line width that is seen half the time.
    pub found_share_per_px: f64,
    /// Part of the unexplained line that any valid frame may have near the robot which a frame may have that confirms an
    /// announced pose. It is all of it: a ball or sunlight may be a fourth of the little line that is near.
    pub announced_unexplained: f64,
    /// The same part for a found pose, before [`Self::unexplained_per_px`] is added.
    pub found_unexplained: f64,
    /// Addition to [`Self::found_unexplained`] for each pixel beyond the first of the line width that is seen half the time,
    /// since blades and glints of turf stand out as lines do.
    pub unexplained_per_px: f64,
    /// Share of the lines in the picture, at any distance, that must be painted where the pose has them. Right poses
    /// have 0.97 or more on carpet and 0.94 or more on turf in sun and shade (docs/explanation/lines.md).
    pub explained_in_view: f64,
    /// Digits with which a frame counts fully towards confirming a found pose. With fewer it counts in proportion: few lines
    /// look the same in several places.
    pub frame_digits: f64,
    /// Number of unconvincing frames after which the field is searched for a better pose, the first time after a search.
    pub unconvincing_first: u32,
    /// Number of unconvincing frames for the further times, and for an announced pose.
    pub unconvincing_later: u32,
    /// Distance from the last searched pose, metres, from which another search of the field is new evidence.
    pub elsewhere_m: f64,
    /// Turn from the last searched pose, radians, from which another search of the field is new evidence.
    pub elsewhere_rad: f64,
    /// Number of searches in a row without a better pose that are evidence wherever they were made.
    pub rivals_missing_in_a_row: u32,
    /// Reduction of the share of lines that must fit, for each search that found no better pose: behind others, or with a
    /// lens that is not quite as calibrated, lines are missing at right poses too.
    pub found_again_share_relief: f64,
    /// Addition to the part that may be left unexplained, for each search that found no better pose.
    pub found_again_unexplained_relief: f64,
    /// Reduction of the share of lines that must stand out most, for each search that found no better pose.
    pub found_again_foremost_relief: f64,
    // What contradicts a pose, and what agrees with it.
    /// Smallest number of expected line places that say anything for or against a pose.
    pub min_expected: usize,
    /// Smallest number of fitting line places with which a frame agrees with a pose.
    pub min_fitting: usize,
    /// Digits against chance that a frame needs to agree with a pose: chance does so once in 10^4 frames
    /// (docs/explanation/lines.md).
    pub agrees_digits: f64,
    /// Share of fitting places below which the lines contradict the pose.
    pub contradicted_share: f64,
    /// Largest root mean square distance of the line places of a confirmed pose, pixels of the working image; see
    /// [`Self::confirmed_rms_px`].
    pub believed_rms_px: f64,
    /// Number of fitting line places that are many.
    pub many_places: usize,
    /// Share of fitting places with which hardly a line is missing.
    pub nearly_all_share: f64,
    /// Share of the expected lines that do not fit at right poses because they are faint, for each pixel of the line
    /// width that is seen half the time, beyond the first. Right poses have 0.95 and more on carpet, and 0.75 on turf
    /// where that width is 2.7 pixels.
    pub faint_share_per_px: f64,
    /// Part of the difference by which the usual share of lines that stand out most follows each confirmed frame.
    pub usual_rate: f64,
    /// Drop of the share of lines that stand out most below the usual one that contradicts a confirmed pose.
    pub usual_margin: f64,
    /// The same drop where nothing but lines has followed the pose since the last frame.
    pub usual_margin_without_odometry: f64,
    /// The same drop for a pose that is found by search.
    pub usual_margin_found: f64,
    /// The same drop for a pose that has not been confirmed for long: where a goal's surroundings have led to a wrong pose, the
    /// next lines that come into view are missing.
    pub usual_margin_new: f64,
    /// Smallest product of the share of expected lines that fit and the share of seen lines that are expected.
    pub both_ways: f64,
    /// The same product where nothing but lines tells where the robot has gone since the last frame: half a metre farther
    /// on, other lines fit too.
    pub both_ways_without_odometry: f64,
    /// Reduction of [`Self::both_ways`] for each pixel of the line width that is seen half the time, beyond the first.
    pub both_ways_per_px: f64,
    /// Smallest share of the clearly seen line that the field must have where a valid refined pose puts it.
    pub min_explained: f64,
    /// Reduction of [`Self::min_explained`], where a confirmed pose has nearly all the lines that it expects.
    pub held_fast_relief: f64,
    /// Share of the seen lines that a pose must have explained once to get [`Self::held_fast_relief`].
    pub well_explained: f64,
    /// Height, metres, by which no mount and no gait moves the camera of a standing robot up or down: five standard deviations
    /// of what is expected.
    pub max_rise_m: f64,
    /// Tilt, radians, by which no mount and no gait moves the camera of a standing robot.
    pub max_tilt_rad: f64,
    /// The same tilt without an IMU, radians.
    pub max_unmeasured_tilt_rad: f64,
    // When a pose is given up.
    /// Number of frames in a row whose lines contradict a confirmed pose before the field is searched: 0.3 s at 10 Hz.
    pub lost_after: u32,
    /// Standard deviation of the position along its longer axis, metres, above which the robot is lost.
    pub lost_sigma_m: f64,
    /// Largest distance of a camera from the carpet, metres.
    pub off_field_m: f64,
    /// Longest time for which a pose is believed without lines that agree, nanoseconds.
    pub max_coast_ns: i64,
    /// Share of fitting lines that a pose needs before a confirmed one is left for it.
    pub better_share: f64,
    /// Part of the unexplained line of any valid frame that such a pose may have.
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
    usual_margin_without_odometry: 0.1,
    usual_margin_found: 0.07,
    usual_margin_new: 0.15,
    both_ways: 0.6,
    both_ways_without_odometry: 0.75,
    both_ways_per_px: 0.04,
    min_explained: 0.7,
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
