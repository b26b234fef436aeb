//! Runs of all settings on the same frames, with several seeds.

use super::row::Row;
use super::sweep_point::SweepPoint;
use crate::capture::tagged;
use realitysim_geometry::Isometry;
use realitysim_tagging::Trial;

/// Difference in the share of valid tags to the best row beyond which a row is evasive: its errors are those of easier
/// frames.
const EVASION: f64 = 0.02;

/// Callback that runs one setting with one seed and returns the result of each frame.
pub type Measure<'a, E> = &'a mut dyn FnMut(&SweepPoint, u64) -> Result<Vec<Trial>, E>;

/// Runs every setting with every seed and returns the judged rows, sorted by the 99 % quantile of their times.
///
/// All settings run with the first seed, then all with the next: what slows the machine down for a while affects all
/// settings alike, and only one run of each. `truth` is in order of time.
///
/// # Errors
///
/// Returns the first error of `measure`.
pub fn sweep<E>(
    settings: &[SweepPoint],
    seeds: &[u64],
    truth: &[(i64, Isometry)],
    measure: Measure<E>,
) -> Result<Vec<Row>, E> {
    let mut runs: Vec<Vec<Vec<Trial>>> = vec![Vec::new(); settings.len()];
    for seed in seeds {
        for (sweep_point, runs) in settings.iter().zip(&mut runs) {
            runs.push(measure(sweep_point, *seed)?);
        }
    }
    let mut rows: Vec<Row> =
        settings.iter().zip(&runs).map(|(sweep_point, runs)| Row::of(*sweep_point, runs, truth)).collect();
    let best_share = rows.iter().map(|row| row.valid_share).fold(0.0, f64::max);
    for row in &mut rows {
        row.evasive = row.valid_share < best_share - EVASION;
    }
    rows.sort_by(|a, b| a.p99_ms.total_cmp(&b.p99_ms));
    Ok(rows)
}

/// Returns the valid tags of a run in the form of a truth: times in nanoseconds and poses, in order of time.
pub fn as_truth(run: &[Trial]) -> Vec<(i64, Isometry)> {
    let mut truth: Vec<(i64, Isometry)> = run
        .iter()
        .map(|attempt| tagged(&attempt.tag))
        .filter(|tag| tag.valid)
        .map(|tag| (tag.stamp_ns, tag.pose))
        .collect();
    truth.sort_by_key(|(stamp_ns, _)| *stamp_ns);
    truth.dedup_by_key(|(stamp_ns, _)| *stamp_ns);
    truth
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cost::plan;
    use realitysim_config::Settings;
    use realitysim_ros2::messages::{FrameTag, Stamp};

    fn run(sweep_point: &SweepPoint, seed: u64) -> Vec<Trial> {
        let attempt = |frame: i64| {
            // A setting with few particles tags only half of the frames, with small errors.
            let valid = sweep_point.particles > 50 || frame < 5;
            let mut tag = FrameTag { valid, elapsed_ms: sweep_point.particles as f64 / 100.0, ..FrameTag::default() };
            tag.header.stamp = Stamp::from_nanoseconds(frame * 100_000_000);
            tag.pose.pose.position.x = if sweep_point.particles > 50 { 0.01 + seed as f64 * 1e-4 } else { 0.0 };
            tag.pose.pose.orientation.w = 1.0;
            Trial { tag, seen: true }
        };
        (0..10).map(attempt).collect()
    }

    #[test]
    fn every_setting_runs_with_every_seed_and_evasion_is_noticed() {
        let settings = plan(SweepPoint::of(&Settings::default()), 1);
        let truth: Vec<(i64, Isometry)> = (0..10).map(|frame| (frame * 100_000_000, Isometry::IDENTITY)).collect();
        let mut asked = Vec::new();
        let rows = sweep::<()>(&settings, &[1, 2], &truth, &mut |sweep_point, seed| {
            asked.push((*sweep_point, seed));
            Ok(run(sweep_point, seed))
        });
        let rows = rows.expect("measured");
        assert_eq!((rows.len(), asked.len()), (settings.len(), 2 * settings.len()));
        assert!(asked[..settings.len()].iter().all(|(_, seed)| *seed == 1));
        assert!(rows.windows(2).all(|pair| pair[0].p99_ms <= pair[1].p99_ms));
        for row in &rows {
            assert_eq!(row.evasive, row.sweep_point.particles <= 50, "{row:?}");
        }
        assert_eq!(sweep(&settings, &[1], &truth, &mut |_, _| Err("broken")).expect_err("passed on"), "broken");
    }

    #[test]
    fn only_valid_tags_are_taken_for_the_truth() {
        let sweep_point = SweepPoint { particles: 10, ..SweepPoint::of(&Settings::default()) };
        assert_eq!(as_truth(&run(&sweep_point, 1)).len(), 5);
    }
}
