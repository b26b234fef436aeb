//! Judgement of one case: its tags against the truth.

use serde::Serialize;

use super::file::Case;
use crate::compare::{Comparison, Tagged, compare, truth_at, up_to_mirror};
use realitysim_geometry::Isometry;

/// Errors, share of valid tags and recoveries of one case.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Judged {
    /// Errors of the judged tags.
    #[serde(flatten)]
    pub comparison: Comparison,
    /// Share of the judged frames that have a valid tag; `None` if the number of frames is not known.
    pub valid_share: Option<f64>,
    /// Recovery from each time of the case.
    pub recoveries: Vec<Recovery>,
}

/// Time until tags were valid and right again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Recovery {
    /// Time from which on the pose could be found, seconds after the first frame.
    pub from_s: f64,
    /// Time that the recovery took, seconds; `None` if it never came.
    pub took_s: Option<f64>,
}

/// Largest error in x and y of a right tag, centimetres.
const RIGHT_CM: f64 = 10.0;
/// Number of successive right tags that make a recovery: fewer may be chance.
const IN_A_ROW: usize = 3;

impl Judged {
    /// Returns the longest time of a recovery, seconds; `None` if one never came.
    pub fn slowest_recovery_s(&self) -> Option<f64> {
        self.recoveries
            .iter()
            .map(|recovery| recovery.took_s)
            .try_fold(0.0, |slowest: f64, took| Some(slowest.max(took?)))
    }
}

/// Judges the tags of a replay, which has a tag for each frame. `truth` is in order of time.
pub fn judge(case: &Case, tags: &[Tagged], truth: &[(i64, Isometry)]) -> Judged {
    let first_ns = tags.iter().map(|tag| tag.stamp_ns).min().unwrap_or(0);
    let mut judged = judge_since(case, first_ns, tags, truth);
    let c = &judged.comparison;
    judged.valid_share = Some(c.valid as f64 / c.frames.max(1) as f64);
    judged
}

/// Judges poses that another program wrote, and counts them against the frames of the camera.
///
/// A frame without a pose near its time counts as a frame without a valid tag. All arguments are in order of time;
/// `frames` (nanoseconds) is empty if no log has images.
pub fn judge_poses(case: &Case, poses: &[Tagged], frames: &[i64], truth: &[(i64, Isometry)]) -> Judged {
    let Some(first_ns) = frames.first().copied() else {
        let first_ns = poses.first().map_or(0, |pose| pose.stamp_ns);
        return judge_since(case, first_ns, poses, truth);
    };
    let reach_ns = (median_step_ns(frames) / 2).max(SAME_TIME_NS);
    let has_pose = |frame: i64| {
        let after = poses.partition_point(|pose| pose.stamp_ns < frame);
        let near = |index: Option<usize>| index.and_then(|index| poses.get(index));
        [after.checked_sub(1), Some(after)]
            .into_iter()
            .filter_map(near)
            .any(|pose| pose.stamp_ns.abs_diff(frame) <= reach_ns)
    };
    let invalid_tag = |stamp_ns: i64| Tagged {
        stamp_ns,
        valid: false,
        pose: Isometry::IDENTITY,
        covariance: [0.0; 3],
        ambiguous: false,
    };
    let missing = frames.iter().filter(|frame| !has_pose(**frame)).map(|frame| invalid_tag(*frame));
    let mut all: Vec<Tagged> = poses.iter().cloned().chain(missing).collect();
    all.sort_by_key(|tag| tag.stamp_ns);
    let mut judged = judge_since(case, first_ns, &all, truth);
    let judged_frames: Vec<i64> =
        frames.iter().copied().filter(|frame| case.judges(seconds(*frame, first_ns))).collect();
    let with_pose = judged_frames.iter().filter(|frame| has_pose(**frame)).count();
    judged.comparison.frames = judged_frames.len();
    judged.valid_share = Some(with_pose as f64 / judged_frames.len().max(1) as f64);
    judged
}

/// Distance in time within which stamps count as equal, nanoseconds: some tools round them.
const SAME_TIME_NS: u64 = 1_000_000;

fn median_step_ns(frames: &[i64]) -> u64 {
    let mut steps: Vec<u64> = frames.windows(2).map(|pair| pair[0].abs_diff(pair[1])).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).copied().unwrap_or(0)
}

fn seconds(stamp_ns: i64, first_ns: i64) -> f64 {
    (stamp_ns - first_ns) as f64 * 1e-9
}

impl Case {
    /// Returns whether the case judges what was taken `time` seconds after the first frame.
    fn judges(&self, time: f64) -> bool {
        time >= self.from_s && !self.except_s.iter().any(|[from, to]| (*from..*to).contains(&time))
    }
}

/// Judges tags; times of the case count from `first_ns`. The share of valid tags is left open.
fn judge_since(case: &Case, first_ns: i64, tags: &[Tagged], truth: &[(i64, Isometry)]) -> Judged {
    let seconds = |tag: &Tagged| seconds(tag.stamp_ns, first_ns);
    let tags = if case.up_to_mirror { up_to_mirror(tags, truth) } else { tags.to_vec() };
    let judged: Vec<Tagged> = tags.iter().filter(|tag| case.judges(seconds(tag))).cloned().collect();
    let comparison = compare(&judged, truth);
    let recoveries = case.recovery_from_s.iter().map(|from_s| {
        let after: Vec<&Tagged> = tags.iter().filter(|tag| seconds(tag) >= *from_s).collect();
        let right: Vec<bool> = after.iter().map(|tag| is_right(tag, truth)).collect();
        let place = right.windows(IN_A_ROW).position(|row| row.iter().all(|right| *right));
        Recovery { from_s: *from_s, took_s: place.map(|place| seconds(after[place]) - from_s) }
    });
    Judged { valid_share: None, recoveries: recoveries.collect(), comparison }
}

/// Returns whether the tag is valid and no farther from the truth than [`RIGHT_CM`].
fn is_right(tag: &Tagged, truth: &[(i64, Isometry)]) -> bool {
    tag.valid && distance_cm(tag, truth).is_some_and(|distance| distance <= RIGHT_CM)
}

fn distance_cm(tag: &Tagged, truth: &[(i64, Isometry)]) -> Option<f64> {
    let off = tag.pose.translation - truth_at(truth, tag.stamp_ns)?.translation;
    Some(100.0 * off.truncate().length())
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::suite::{Limits, Suite};
    use realitysim_geometry::Euler;

    fn case(rest: &str) -> Case {
        let recovered = if rest.contains("recovery_from_s") { "recovered_within_s = 1, " } else { "" };
        let text = format!("[[case]]\nsource = \"a.mcap\"\nlimits = {{ {recovered}max_cm = 20 }}\n{rest}");
        Suite::parse(&text, "suite.toml".as_ref()).expect("a suite").cases.remove(0)
    }

    fn at(x: f64) -> Isometry {
        Isometry::from_euler(Euler::default(), DVec3::new(x, 0.0, 0.5))
    }

    /// Judges a tag every tenth of a second with the given errors in metres. A negative error makes an invalid tag.
    fn judged(case: &Case, off_m: &[f64]) -> Judged {
        let stamp_ns = |index: usize| index as i64 * 100_000_000;
        let truth: Vec<_> = (0..off_m.len()).map(|index| (stamp_ns(index), at(1.0))).collect();
        let tags: Vec<Tagged> = off_m
            .iter()
            .enumerate()
            .map(|(index, off)| Tagged {
                stamp_ns: stamp_ns(index),
                valid: *off >= 0.0,
                pose: at(1.0 + off.abs()),
                covariance: [1.0, 0.0, 1.0],
                ambiguous: false,
            })
            .collect();
        judge(case, &tags, &truth)
    }

    #[test]
    fn excluded_intervals_are_not_judged() {
        let off = [5.0, 0.0, 3.0, 0.0, -1.0];
        let judged = judged(&case("from_s = 0.1\nexcept_s = [[0.2, 0.3]]"), &off);
        assert_eq!((judged.comparison.frames, judged.comparison.valid), (3, 2));
        assert!(
            judged.comparison.position_cm.max < 1e-9 && (judged.valid_share.expect("known") - 2.0 / 3.0).abs() < 1e-12
        );
    }

    #[test]
    fn a_recovery_is_three_right_tags_in_a_row() {
        let case = case("recovery_from_s = [0.1]");
        let took = |off: &[f64]| judged(&case, off).slowest_recovery_s();
        assert!((took(&[0.0, 1.0, 0.0, 0.0, 1.0, 0.02, 0.0, 0.0]).expect("recovers") - 0.4).abs() < 1e-9);
        assert_eq!(took(&[0.0, 0.0, 0.0, -1.0, 0.0]), None);
        let judged = judged(&case, &[0.0, 0.0, 0.0]);
        assert_eq!(case.limits.broken(&judged)[0].limit, "recovered_within_s");
    }

    #[test]
    fn only_an_ambiguous_tag_may_be_in_the_other_half() {
        let case = case("up_to_mirror = true");
        let truth = [(0, at(1.0))];
        let max = |ambiguous| {
            let tag = Tagged { stamp_ns: 0, valid: true, pose: at(-1.0), covariance: [1.0, 0.0, 1.0], ambiguous };
            judge(&case, &[tag], &truth).comparison.position_cm.max
        };
        assert!(max(true) < 1e-9);
        assert!(max(false) > 199.0);
    }

    #[test]
    fn a_value_at_its_limit_keeps_it_and_a_missing_one_breaks_it() {
        let limits = Limits { mean_cm: Some(20.0), ..Limits::default() };
        let names = |off: &[f64]| -> Vec<&'static str> {
            limits.broken(&judged(&case(""), off)).iter().map(|broken| broken.limit).collect()
        };
        assert!(names(&[0.1, 0.25]).is_empty());
        assert_eq!(names(&[0.1, 0.35]), ["mean_cm"]);
        assert_eq!(names(&[-0.1]), ["mean_cm"]);
        assert_eq!(limits.too_slow(9.0), None);
    }

    /// With standard deviations of one metre, errors of 0.1 m lie within the ellipse and errors of 3 m do not.
    #[test]
    fn errors_beyond_the_covariance_break_the_ellipse_limit() {
        let held = |allowed: f64, off: &[f64]| {
            let limits = Limits { ellipse95_share: Some(allowed), ..Limits::default() };
            assert!(limits.ask_for_truth());
            limits.broken(&judged(&case(""), off)).is_empty()
        };
        assert!(held(1.0, &[0.1, 0.1]) && held(0.5, &[0.1, 3.0]));
        assert!(!held(0.6, &[0.1, 3.0]) && !held(0.5, &[]));
        let suite = Limits { ellipse95_share: Some(0.9), ..Limits::default() };
        let none = Limits { ellipse95_share: Some(0.0), ..Limits::default() };
        assert_eq!(none.merged_over(&suite), Limits::default());
    }

    #[test]
    fn a_frame_without_pose_is_invalid_however_many_poses_there_are() {
        let case = case("");
        let pose = |ms: i64| Tagged {
            stamp_ns: ms * 1_000_000,
            valid: true,
            pose: at(1.0),
            covariance: [1.0, 0.0, 1.0],
            ambiguous: false,
        };
        let frames: Vec<i64> = (0..10).map(|index| index * 100_000_000).collect();
        let share = |poses: &[i64]| {
            let poses: Vec<Tagged> = poses.iter().map(|ms| pose(*ms)).collect();
            judge_poses(&case, &poses, &frames, &[]).valid_share.expect("known")
        };
        assert!((share(&[0, 101, 199, 400]) - 0.4).abs() < 1e-12);
        let fast: Vec<i64> = (0..500).collect();
        assert!((share(&fast) - 0.6).abs() < 1e-12, "{}", share(&fast));
        assert_eq!(judge_poses(&case, &[pose(0)], &[], &[]).valid_share, None);
    }

    #[test]
    fn too_small_a_share_of_judged_tags_breaks_a_limit() {
        let with = |limits: &str| {
            let text = format!("[[case]]\nsource = \"a.mcap\"\nlimits = {{ {limits} }}");
            Suite::parse(&text, "suite.toml".as_ref()).expect("a suite").cases.remove(0)
        };
        let tag = |index: i64| Tagged {
            stamp_ns: index * 1_000_000_000,
            valid: true,
            pose: at(1.0),
            covariance: [1.0, 0.0, 1.0],
            ambiguous: false,
        };
        let tags: Vec<Tagged> = (0..10).map(tag).collect();
        let broken = |limits: &str, known: i64| -> Vec<&'static str> {
            let truth: Vec<_> = (0..known).map(|index| (index * 1_000_000_000, at(1.0))).collect();
            let case = with(limits);
            case.limits.broken(&judge(&case, &tags, &truth)).iter().map(|broken| broken.limit).collect()
        };
        assert_eq!(broken("max_cm = 1", 8), ["judged_share"]);
        assert!(broken("max_cm = 1", 9).is_empty());
        assert!(broken("max_cm = 1, judged_share = 0.8", 8).is_empty());
        assert!(broken("max_cm = 1, judged_share = 0", 1).is_empty());
        assert_eq!(broken("max_cm = 1, judged_share = 1", 9), ["judged_share"]);
        assert!(broken("valid_share = 1", 0).is_empty(), "no limit needs the truth");
    }
}
