//! The result of one setting: times and errors over all its runs.

use serde::Serialize;

use super::pareto_front::Point;
use super::sweep_point::SweepPoint;
use crate::Tagged;
use crate::capture::tagged;
use crate::compare::{Comparison, compare, up_to_mirror};
use crate::statistics::{Summary, quantile};
use realitysim_geometry::Isometry;
use realitysim_tagging::Trial;

/// Times and errors of one setting, over one run per seed.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The setting.
    #[serde(flatten)]
    pub sweep_point: SweepPoint,
    /// Median time from the decoded image to the tag, milliseconds.
    ///
    /// Each frame counts with the fastest of its runs: the seeds hardly change the work, so the machine is what makes
    /// the others slower.
    pub p50_ms: f64,
    /// 99 % quantile of the same times, milliseconds.
    pub p99_ms: f64,
    /// Errors of the valid tags in x and y, centimetres, averaged over the seeds.
    pub position_cm: Summary,
    /// Errors of yaw of the valid tags, degrees, averaged over the seeds.
    pub yaw_deg: Summary,
    /// Standard deviation over the seeds of the mean position error, centimetres.
    pub scatter_cm: f64,
    /// Share of the frames with a valid tag, 0 to 1.
    pub valid_share: f64,
    /// Number of valid tags with a true pose at their time, summed over the seeds.
    pub judged: usize,
    /// Whether the setting tags clearly fewer frames than others, most likely leaving out the hard ones.
    pub evasive: bool,
}

/// Resolution of the errors that are compared, centimetres: smaller differences do not make a row better.
pub(super) const ERROR_RESOLUTION_CM: f64 = 0.01;

impl Row {
    /// Judges the runs of one setting over the same frames, one run per seed. `truth` is in order of time.
    pub fn of(sweep_point: SweepPoint, runs: &[Vec<Trial>], truth: &[(i64, Isometry)]) -> Self {
        let (mut position, mut yaw) = (Vec::new(), Vec::new());
        let (mut frames, mut valid, mut judged) = (0, 0, 0);
        for run in runs {
            let comparison = judge(run, truth);
            frames += comparison.frames;
            valid += comparison.valid;
            judged += comparison.judged;
            // A run without judged tags has no errors to average.
            if comparison.judged > 0 {
                position.push(comparison.position_cm);
                yaw.push(comparison.yaw_deg);
            }
        }
        let milliseconds = fastest_frame_times(runs);
        Self {
            sweep_point,
            p50_ms: quantile(&milliseconds, 0.5),
            p99_ms: quantile(&milliseconds, 0.99),
            scatter_cm: standard_deviation(&position.iter().map(|summary| summary.mean).collect::<Vec<_>>()),
            position_cm: average(&position),
            yaw_deg: average(&yaw),
            valid_share: valid as f64 / frames.max(1) as f64,
            judged,
            evasive: false,
        }
    }

    /// Returns time and error of the row, the error rounded to a tenth of a millimetre.
    ///
    /// The error is infinite for rows without judged tags and for evasive rows, which do not count.
    pub fn point(&self) -> Point {
        let counts = self.judged > 0 && !self.evasive;
        let error_cm = libm::round(self.position_cm.mean / ERROR_RESOLUTION_CM) * ERROR_RESOLUTION_CM;
        Point { time_ms: self.p99_ms, error_cm: if counts { error_cm } else { f64::INFINITY } }
    }
}

/// Compares a run with the truth.
///
/// A filter that started without a known pose cannot know its half of the field: of an ambiguous tag the nearer of its
/// two poses counts.
fn judge(run: &[Trial], truth: &[(i64, Isometry)]) -> Comparison {
    let tags: Vec<Tagged> = run.iter().map(|attempt| tagged(&attempt.tag)).collect();
    compare(&up_to_mirror(&tags, truth), truth)
}

/// Returns the shortest time over the runs of each frame whose image could be used, milliseconds, in ascending order.
fn fastest_frame_times(runs: &[Vec<Trial>]) -> Vec<f64> {
    let frames = runs.iter().map(Vec::len).min().unwrap_or(0);
    let of_frame = |frame: usize| {
        let seen = runs.iter().map(|run| &run[frame]).filter(|attempt| attempt.seen);
        seen.map(|attempt| attempt.tag.elapsed_ms).min_by(f64::total_cmp)
    };
    let mut times: Vec<f64> = (0..frames).filter_map(of_frame).collect();
    times.sort_by(f64::total_cmp);
    times
}

/// Averages summaries field by field, but takes the largest maximum; all zero if there are none.
fn average(summaries: &[Summary]) -> Summary {
    let count = summaries.len().max(1) as f64;
    let mean = |of: fn(&Summary) -> f64| summaries.iter().map(of).fold(0.0, |sum, value| sum + value) / count;
    Summary {
        mean: mean(|summary| summary.mean),
        median: mean(|summary| summary.median),
        p95: mean(|summary| summary.p95),
        max: summaries.iter().map(|summary| summary.max).fold(0.0, f64::max),
    }
}

/// Returns the sample standard deviation; 0 of fewer than two values.
fn standard_deviation(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    if values.len() < 2 {
        return 0.0;
    }
    let mean = values.iter().sum::<f64>() / count;
    libm::sqrt(values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / (count - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::Settings;
    use realitysim_ros2::messages::{FrameTag, Stamp};

    fn attempt(frame: i64, x: f64, elapsed_ms: f64, valid: bool) -> Trial {
        let mut tag = FrameTag { valid, elapsed_ms, ..FrameTag::default() };
        tag.header.stamp = Stamp::from_nanoseconds(frame * 100_000_000);
        tag.pose.pose.position.x = x;
        tag.pose.pose.orientation.w = 1.0;
        Trial { tag, seen: true }
    }

    #[test]
    fn errors_are_averaged_over_seeds_and_times_are_the_shortest() {
        let truth: Vec<(i64, Isometry)> = (0..2).map(|frame| (frame * 100_000_000, Isometry::IDENTITY)).collect();
        // The last two frames have no true pose, and the second frame was slow in the run of the second seed.
        let run = |x: f64, slow: f64| {
            vec![
                attempt(0, x, 1.0, true),
                attempt(1, x, slow, true),
                attempt(20, 9.0, 3.0, true),
                attempt(21, 9.0, 4.0, false),
            ]
        };
        let runs = [run(0.01, 2.0), run(0.02, 50.0), run(0.03, 2.0)];
        let row = Row::of(SweepPoint::of(&Settings::default()), &runs, &truth);
        assert!((row.position_cm.mean - 2.0).abs() < 1e-9 && (row.scatter_cm - 1.0).abs() < 1e-9);
        assert_eq!((row.judged, row.valid_share), (6, 0.75));
        assert!((row.p50_ms - 2.5).abs() < 1e-9 && row.p99_ms < 4.0 + 1e-9, "{row:?}");
        assert_eq!(row.point(), Point { time_ms: row.p99_ms, error_cm: 2.0 });
    }

    #[test]
    fn an_ambiguous_tag_is_judged_by_the_nearer_of_its_two_poses() {
        let at = Isometry::IDENTITY * Isometry::new(glam::DQuat::IDENTITY, glam::DVec3::new(-1.0, 0.0, 0.0));
        let mut run = vec![attempt(0, 1.0, 1.0, true)];
        let truth = [(0, at)];
        let sweep_point = SweepPoint::of(&Settings::default());
        assert!((Row::of(sweep_point, std::slice::from_ref(&run), &truth).position_cm.mean - 200.0).abs() < 1e-9);
        run[0].tag.ambiguous = true;
        assert!(Row::of(sweep_point, &[run], &truth).position_cm.mean < 1e-9);
    }

    #[test]
    fn a_row_without_judged_tags_does_not_count() {
        let row = Row::of(SweepPoint::of(&Settings::default()), &[vec![attempt(0, 0.0, 1.0, false)]], &[]);
        assert!(!row.point().counts());
        assert!(!Row::of(row.sweep_point, &[], &[]).point().counts());
    }
}
