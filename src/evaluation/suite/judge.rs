//! The tags of one case against the truth.

use serde::Serialize;

use super::file::Case;
use crate::evaluation::compare::{Comparison, Tagged, compare, truth_at, up_to_mirror};
use crate::geometry::Isometry;

#[derive(Clone, Debug, Default, Serialize)]
pub struct Judged {
    #[serde(flatten)]
    pub comparison: Comparison,
    /// Of the frames that are judged.
    pub valid_share: f64,
    pub recoveries: Vec<Recovery>,
}

/// How long it took until tags were valid and right again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Recovery {
    pub from_s: f64,
    /// None: never.
    pub took_s: Option<f64>,
}

/// A tag is right if it is no farther off than this.
const RIGHT_CM: f64 = 10.0;
/// So many in a row, or it was luck.
const IN_A_ROW: usize = 3;

impl Judged {
    /// None if one of them never came.
    pub fn slowest_recovery_s(&self) -> Option<f64> {
        self.recoveries
            .iter()
            .map(|recovery| recovery.took_s)
            .try_fold(0.0, |slowest: f64, took| Some(slowest.max(took?)))
    }
}

/// `truth` is in time order.
pub fn judge(case: &Case, tags: &[Tagged], truth: &[(i64, Isometry)]) -> Judged {
    let first_ns = tags.iter().map(|tag| tag.stamp_ns).min().unwrap_or(0);
    let seconds = |tag: &Tagged| (tag.stamp_ns - first_ns) as f64 * 1e-9;
    let tags = if case.up_to_mirror { up_to_mirror(tags, truth) } else { tags.to_vec() };
    let is_excepted = |time: f64| case.except_s.iter().any(|[from, to]| (*from..*to).contains(&time));
    let is_judged = |tag: &&Tagged| seconds(tag) >= case.from_s && !is_excepted(seconds(tag));
    let judged: Vec<Tagged> = tags.iter().filter(is_judged).cloned().collect();
    let comparison = compare(&judged, truth);
    let recoveries = case.recovery_from_s.iter().map(|from_s| {
        let after: Vec<&Tagged> = tags.iter().filter(|tag| seconds(tag) >= *from_s).collect();
        let right: Vec<bool> = after.iter().map(|tag| is_right(tag, truth)).collect();
        let place = right.windows(IN_A_ROW).position(|row| row.iter().all(|right| *right));
        Recovery { from_s: *from_s, took_s: place.map(|place| seconds(after[place]) - from_s) }
    });
    Judged {
        valid_share: comparison.valid as f64 / comparison.frames.max(1) as f64,
        recoveries: recoveries.collect(),
        comparison,
    }
}

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
    use crate::evaluation::suite::{Limits, Suite};
    use crate::geometry::Euler;

    fn case(rest: &str) -> Case {
        let text = format!("[[case]]\nsource = \"a.mcap\"\nlimits = {{ recovered_within_s = 1, max_cm = 20 }}\n{rest}");
        Suite::parse(&text, "suite.toml".as_ref()).expect("a suite").cases.remove(0)
    }

    fn at(x: f64) -> Isometry {
        Isometry::from_euler(Euler::default(), DVec3::new(x, 0.0, 0.5))
    }

    /// A tag every tenth of a second, off by so many metres each; below 0: invalid.
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
    fn what_is_left_out_is_not_judged() {
        let off = [5.0, 0.0, 3.0, 0.0, -1.0];
        let judged = judged(&case("from_s = 0.1\nexcept_s = [[0.2, 0.3]]"), &off);
        assert_eq!((judged.comparison.frames, judged.comparison.valid), (3, 2));
        assert!(judged.comparison.position_cm.max < 1e-9 && (judged.valid_share - 2.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn recovered_is_right_three_times_in_a_row() {
        let case = case("recovery_from_s = [0.1]");
        let took = |off: &[f64]| judged(&case, off).slowest_recovery_s();
        assert!((took(&[0.0, 1.0, 0.0, 0.0, 1.0, 0.02, 0.0, 0.0]).expect("recovers") - 0.4).abs() < 1e-9);
        assert_eq!(took(&[0.0, 0.0, 0.0, -1.0, 0.0]), None);
        let judged = judged(&case, &[0.0, 0.0, 0.0]);
        assert_eq!(case.limits.broken(&judged)[0].limit, "recovered_within_s");
    }

    #[test]
    fn only_a_tag_that_says_so_may_be_in_the_other_half() {
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
    fn a_limit_holds_up_to_itself_and_nothing_judged_breaks_all() {
        let limits = Limits { mean_cm: Some(20.0), max_cm: Some(f64::INFINITY), ..Limits::default() };
        let names = |off: &[f64]| -> Vec<&'static str> {
            limits.broken(&judged(&case(""), off)).iter().map(|broken| broken.limit).collect()
        };
        assert!(names(&[0.1, 0.25]).is_empty());
        assert_eq!(names(&[0.1, 0.35]), ["mean_cm"]);
        assert_eq!(names(&[-0.1]), ["mean_cm"]);
        assert_eq!(limits.too_slow(9.0), None);
    }
}
