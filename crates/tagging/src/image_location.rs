//! The poses that explain a single image, and how far the best one may be trusted.

use nalgebra::Matrix6;
use serde::Serialize;

use realitysim_geometry::{Isometry, Pose2, wrap_angle};
use realitysim_localization::refinement::Agreement;

/// Standard deviations of a pose that is fitted to the lines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PoseSigmas {
    /// Of the position on the ground along its longer axis, metres.
    pub xy_m: f64,
    /// Of the height, metres.
    pub z_m: f64,
    /// Of the rotation: the largest of those about the three axes of `map`, radians.
    pub rotation_rad: f64,
}

/// A pose that explains the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseHypothesis {
    /// Pose of `camera_link` in `map`.
    pub map_from_link: Isometry,
    /// How well the lines determine the pose; `None` if it is not refined.
    pub sigmas: Option<PoseSigmas>,
    /// Whether the pose is fitted to the lines to a fraction of a pixel. Otherwise it is as the search found it.
    pub refined: bool,
    /// How far the lines agree with the pose.
    pub lines: Agreement,
    /// Share of the lines seen that the field has where the pose puts them.
    pub explained: f64,
    /// Share of the expected line contrast that was found, 0 to 1.
    pub share: f64,
    /// Length of painted line in view, each piece weighted by its certainty, in units of 10 cm.
    pub weight: f64,
    /// Log likelihood of the lines, and of the tilt as far as it differs from the given one.
    pub log_likelihood: f64,
}

/// The result of locating an image.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageLocation {
    /// The poses found, best first; empty if the image shows no line on the ground. The mirror image of each pose explains the
    /// image as well.
    pub found: Vec<PoseHypothesis>,
    /// Whether the whole field was searched, because no approximate pose was given.
    pub searched: bool,
    /// Whether attitude and height were known. Otherwise a second pose that explains the image nearly as well makes both
    /// mean nothing, because such poses differ in more than the place.
    pub mount_is_known: bool,
}

/// How far the best pose may be trusted, the most trusted first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FitQuality {
    /// The pose explains the lines, and no other pose does so nearly as well.
    Good,
    /// The pose explains the lines, but a pose elsewhere does so too, or the evidence is too weak to trust it.
    Doubtful,
    /// The lines are not explained, or there are hardly any: the pose means nothing.
    None,
}

/// Least share of the expected line contrast for a pose to mean something.
pub const MIN_SHARE: f64 = 0.4;
/// Least [`PoseHypothesis::weight`] for a pose to mean something, in units of 10 cm of line.
pub const MIN_WEIGHT: f64 = 8.0;
/// Least digits against chance ([`Agreement::digits`]) of a pose that means something, near an initial pose.
///
/// A search of the whole field with all tilts and heights tries some 10^11 poses, one near an initial pose some 10^4.
const MIN_DIGITS: f64 = 4.0;
/// Least digits against chance of a pose that means something, after a search of the whole field.
const MIN_DIGITS_IF_SEARCHED: f64 = 8.0;
/// Digits against chance from which a pose near an initial pose is trusted.
const TRUSTED_DIGITS: f64 = 8.0;
/// Digits against chance from which a pose is trusted after a search of the whole field.
const TRUSTED_DIGITS_IF_SEARCHED: f64 = 15.0;
/// Least product of the share of expected lines that fit and the share of seen lines that are expected, for a trusted pose.
/// With a wrong pose or lens, lines lie beside where they are expected.
const TRUSTED_BOTH_WAYS: f64 = 0.75;
/// Decrease of [`TRUSTED_BOTH_WAYS`] for each pixel beyond the first of the width of a line that is seen half the time.
const BOTH_WAYS_LESS_PER_PX: f64 = 0.1;
/// Difference in log likelihood by which the best pose must exceed every other.
const CLEAR_BY: f64 = 2.0;

/// Share of the best pose's merit from which another makes both mean nothing, where attitude and height were not known.
const RIVAL_MERIT: f64 = 0.7;

/// Poses closer than this, in metres and radians, are the same.
const SAME_M: f64 = 0.4;
const SAME_RAD: f64 = 0.3;
/// Largest standard deviations of a pose that means something, where attitude and height were not known: beyond these the lines
/// do not determine them.
const MAX_SIGMAS: PoseSigmas = PoseSigmas { xy_m: 0.15, z_m: 0.05, rotation_rad: 0.035 };
/// Digits against chance that attitude and height cost where they are not known, because so many more poses were tried.
const DIGITS_FOR_MOUNT: f64 = 2.0;

impl ImageLocation {
    /// The second best pose, if it explains the image nearly as well as the best one.
    pub fn rival(&self) -> Option<&PoseHypothesis> {
        let [best, next, ..] = &self.found[..] else { return None };
        if !self.mount_is_known {
            return (next.merit() > RIVAL_MERIT * best.merit()).then_some(next);
        }
        (best.log_likelihood - next.log_likelihood < CLEAR_BY).then_some(next)
    }

    /// How far the best pose may be trusted.
    pub fn fit(&self) -> FitQuality {
        let digits_more = if self.mount_is_known { 0.0 } else { DIGITS_FOR_MOUNT };
        match self.found[..] {
            [best, ..] if !best.means_something(self.searched, digits_more) => FitQuality::None,
            [best, ..] if !self.mount_is_known && (self.rival().is_some() || !best.is_determined()) => FitQuality::None,
            [_, ..] if self.rival().is_some() => FitQuality::Doubtful,
            [best, ..] if best.is_trusted(self.searched, digits_more) => FitQuality::Good,
            [_, ..] => FitQuality::Doubtful,
            [] => FitQuality::None,
        }
    }
}

impl PoseHypothesis {
    /// The pose projected onto the ground: x, y and yaw of `camera_link` in `map`.
    pub fn place(&self) -> Pose2 {
        Pose2::from_isometry(&self.map_from_link)
    }

    /// How much speaks for the pose, whatever attitude and height it has: digits against chance, less where lines are missing or
    /// unexplained.
    pub(crate) fn merit(&self) -> f64 {
        self.lines.digits.max(0.0) * self.lines.share.min(self.lines.foremost) * self.explained
    }

    /// Whether the lines determine the pose, attitude and height included.
    pub fn is_determined(&self) -> bool {
        self.sigmas.is_some_and(|sigmas| sigmas.is_within(&MAX_SIGMAS))
    }

    fn means_something(&self, searched: bool, more_digits: f64) -> bool {
        let digits = more_digits + if searched { MIN_DIGITS_IF_SEARCHED } else { MIN_DIGITS };
        self.share >= MIN_SHARE && self.weight >= MIN_WEIGHT && self.lines.digits >= digits
    }

    fn is_trusted(&self, searched: bool, more_digits: f64) -> bool {
        let digits = more_digits + if searched { TRUSTED_DIGITS_IF_SEARCHED } else { TRUSTED_DIGITS };
        let both_ways = self.lines.share.min(self.lines.foremost) * self.explained;
        let faint = BOTH_WAYS_LESS_PER_PX * self.lines.fainter_px();
        self.lines.digits >= digits && both_ways >= TRUSTED_BOTH_WAYS - faint
    }
}

impl PoseSigmas {
    /// Takes them from a covariance of x, y, z and the rotations about the axes of `map`.
    pub(crate) fn of(covariance: &Matrix6<f64>) -> Self {
        let [xx, xy, yy] = [(0, 0), (0, 1), (1, 1)].map(|at| covariance[at]);
        // The larger eigenvalue of the 2 x 2 part, in closed form.
        let longer = 0.5 * (xx + yy) + libm::hypot(0.5 * (xx - yy), xy);
        let rotation = (3..6).map(|axis| covariance[(axis, axis)]).fold(0.0, f64::max);
        let root = |variance: f64| libm::sqrt(variance.max(0.0));
        Self { xy_m: root(longer), z_m: root(covariance[(2, 2)]), rotation_rad: root(rotation) }
    }

    fn is_within(&self, most: &Self) -> bool {
        self.xy_m <= most.xy_m && self.z_m <= most.z_m && self.rotation_rad <= most.rotation_rad
    }
}

/// Removes poses that are near an earlier one or near its mirror image. Near the halfway line a search finds both.
pub(crate) fn without_mirrors(found: impl Iterator<Item = PoseHypothesis>) -> Vec<PoseHypothesis> {
    let mut kept: Vec<PoseHypothesis> = Vec::new();
    for candidate in found {
        let mirror = candidate.place().mirrored();
        let is_known = |known: &PoseHypothesis| {
            let near = |pose: &Pose2| {
                let place = known.place();
                place.distance(pose) < SAME_M && wrap_angle(place.yaw - pose.yaw).abs() < SAME_RAD
            };
            near(&mirror) || near(&candidate.place())
        };
        if !kept.iter().any(is_known) {
            kept.push(candidate);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;

    /// A hypothesis at which every measure is good.
    fn found(x: f64, y: f64, yaw: f64, log_likelihood: f64) -> PoseHypothesis {
        let lines = Agreement { digits: 60.0, share: 0.9, foremost: 0.9, ..Agreement::default() };
        let map_from_link = Pose2::new(x, y, yaw).to_isometry();
        let sigmas = Some(PoseSigmas { xy_m: 0.01, z_m: 0.005, rotation_rad: 0.002 });
        let (share, weight) = (0.9, 30.0);
        PoseHypothesis { map_from_link, sigmas, refined: true, lines, explained: 0.9, share, weight, log_likelihood }
    }

    #[test]
    fn a_pose_stands_for_its_mirror_and_for_its_neighbours() {
        let (one, mirror) = (found(0.05, 0.02, 1.0, 9.0), found(-0.05, -0.02, 1.0 - PI, 9.0));
        let (neighbour, other) = (found(0.1, 0.1, 1.1, 8.5), found(2.0, 0.02, 1.0, 8.0));
        assert_eq!(without_mirrors([one, mirror, neighbour, other].into_iter()), [one, other]);
    }

    #[test]
    fn a_fit_needs_contrast_line_digits_and_no_rival() {
        let fit = |found: &[PoseHypothesis], searched| {
            ImageLocation { found: found.to_vec(), searched, mount_is_known: true }.fit()
        };
        let best = found(1.0, 1.0, 0.0, 9.0);
        assert_eq!(fit(&[], true), FitQuality::None);
        assert_eq!(fit(&[best], true), FitQuality::Good);
        assert_eq!(fit(&[best, found(2.0, 1.0, 0.0, 4.0)], true), FitQuality::Good);
        assert_eq!(fit(&[best, found(2.0, 1.0, 0.0, 8.5)], true), FitQuality::Doubtful);
        assert_eq!(fit(&[PoseHypothesis { share: 0.3, ..best }], true), FitQuality::None);
        assert_eq!(fit(&[PoseHypothesis { weight: 3.0, ..best }], true), FitQuality::None);
        let digits = |digits| PoseHypothesis { lines: Agreement { digits, ..best.lines }, ..best };
        let fits = [3.0, 6.0, 10.0, 20.0].map(|many| [true, false].map(|searched| fit(&[digits(many)], searched)));
        assert_eq!(fits[0], [FitQuality::None, FitQuality::None], "by chance");
        assert_eq!(fits[1], [FitQuality::None, FitQuality::Doubtful], "by chance, on a whole field");
        assert_eq!(fits[2], [FitQuality::Doubtful, FitQuality::Good]);
        assert_eq!(fits[3], [FitQuality::Good, FitQuality::Good]);
        assert_eq!(
            fit(&[PoseHypothesis { explained: 0.6, ..best }], true),
            FitQuality::Doubtful,
            "lines that the field does not have"
        );
    }

    #[test]
    fn an_unknown_mount_needs_one_solution_that_the_lines_determine() {
        let fit = |found: &[PoseHypothesis]| {
            ImageLocation { found: found.to_vec(), searched: true, mount_is_known: false }.fit()
        };
        let best = found(1.0, 1.0, 0.0, 9.0);
        assert_eq!(fit(&[best]), FitQuality::Good);
        assert_eq!(fit(&[best, found(2.0, 1.0, 0.0, 8.5)]), FitQuality::None, "two solutions differ");
        for sigmas in [None, Some(PoseSigmas { z_m: 0.2, ..MAX_SIGMAS })] {
            assert_eq!(fit(&[PoseHypothesis { sigmas, ..best }]), FitQuality::None, "{sigmas:?}");
        }
        let lines = Agreement { digits: 9.0, ..best.lines };
        assert_eq!(fit(&[PoseHypothesis { lines, ..best }]), FitQuality::None, "by chance");
    }
}
