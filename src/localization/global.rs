//! Where on the whole field could this frame have been taken? Every place of a grid is tried.

use core::f64::consts::TAU;

use super::observation::Observation;
use crate::geometry::{Field, Pose2, wrap_angle};
use crate::vision::GroundTable;

/// A local best of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    pub pose: Pose2,
    pub log_likelihood: f64,
}

/// How finely the field is searched: coarse enough for a second, fine enough that refinement by halving finds the peak.
const STEP_M: f64 = 0.1;
const TURNS: usize = 120;
/// Candidates closer than this are one.
const SAME_M: f64 = 0.4;
const SAME_RAD: f64 = 0.3;
const HALVINGS: usize = 8;

/// The `count` best poses over the carpet and `margin_m` around it, each refined, best first. A field looks the same
/// from both goals, so each comes with its mirror pose unless `half_only` keeps to one of the two.
pub fn search(
    observation: &Observation,
    table: &GroundTable,
    field: &Field,
    margin_m: f64,
    half_only: bool,
    count: usize,
) -> Vec<Candidate> {
    let half = field.carpet_half_extent();
    let steps = |half: f64| libm::ceil((half + margin_m) / STEP_M) as i32;
    let (columns, rows) = (steps(half.x), steps(half.y));
    let first_column = if half_only { 0 } else { -columns };
    let mut found: Vec<Candidate> = Vec::new();
    for column in first_column..=columns {
        for row in -rows..=rows {
            let (x, y) = (f64::from(column) * STEP_M, f64::from(row) * STEP_M);
            let best = (0..TURNS)
                .map(|turn| {
                    let pose = Pose2::new(x, y, wrap_angle(TAU * turn as f64 / TURNS as f64));
                    Candidate { pose, log_likelihood: observation.log_likelihood(table, &pose) }
                })
                .max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood));
            found.extend(best);
        }
    }
    // Refining is cheap beside the search, and peaks are narrower than the grid: many starts, few kept.
    found.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    found.truncate(20 * count.max(1));
    let mut refined: Vec<Candidate> = found.iter().map(|c| climb(observation, table, *c)).collect();
    refined.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in refined {
        let same = |other: &Candidate| {
            let turned = wrap_angle(other.pose.yaw - candidate.pose.yaw).abs();
            other.pose.distance(&candidate.pose) < SAME_M && turned < SAME_RAD
        };
        if kept.len() < count && !kept.iter().any(same) {
            kept.push(candidate);
        }
    }
    kept
}

/// Steps along each axis while that helps, then with half the step.
pub fn climb(observation: &Observation, table: &GroundTable, start: Candidate) -> Candidate {
    let mut best = start;
    let (mut step, mut turn) = (STEP_M / 2.0, TAU / TURNS as f64 / 2.0);
    for _ in 0..HALVINGS {
        // Eight rounds cross the distance between two grid points several times.
        for _ in 0..8 {
            let before = best.log_likelihood;
            for (dx, dy, dyaw) in [
                (1.0, 0.0, 0.0),
                (-1.0, 0.0, 0.0),
                (0.0, 1.0, 0.0),
                (0.0, -1.0, 0.0),
                (0.0, 0.0, 1.0),
                (0.0, 0.0, -1.0),
            ] {
                let pose = best.pose.compose(&Pose2::new(dx * step, dy * step, dyaw * turn));
                let log_likelihood = observation.log_likelihood(table, &pose);
                if log_likelihood > best.log_likelihood {
                    best = Candidate { pose, log_likelihood };
                }
            }
            if best.log_likelihood == before {
                break;
            }
        }
        step /= 2.0;
        turn /= 2.0;
    }
    best
}
