//! Search of the whole field for poses that explain a frame.
//!
//! The search goes from coarse to fine. A grid of poses is weighed on a ground table in which every line is widened to the grid's
//! step; from the best of them it climbs to local maxima of the table itself.

use core::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::filter::{Effort, TimeCheck};
use super::kernel::Points;
use super::observation::Observation;
use realitysim_geometry::{Field, Physical, Pose2, wrap_angle};
use realitysim_vision::GroundTable;

/// A pose that the search has found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Pose of `base_footprint` in `map`.
    pub pose: Pose2,
    /// Log likelihood of the frame at this pose, up to a constant of the frame.
    pub log_likelihood: f64,
}

/// Searches one field for a robot.
#[derive(Clone, Debug)]
pub struct GlobalSearch {
    spacing: Spacing,
    /// Positions of the grid, in an order in which any part of them covers the field evenly.
    places: Vec<[f64; 2]>,
    /// An observation model with fewer line points, which suffices to tell where a closer look is worthwhile.
    sparse: Observation,
    /// The frame's ground table with widened lines.
    widened: GroundTable,
    /// Line points in view of the poses that are weighed.
    near: Points,
}

/// How far the poses of a grid lie apart, and what makes up for it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Spacing {
    /// Step in x and y, metres.
    step_m: f64,
    /// Number of headings at each position; at most [`TURNS`].
    turns: usize,
    /// Widening of every line on each side, metres: it makes up for what half a step moves a line.
    widened_m: f64,
}

/// Progress of a search that takes several frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SearchState {
    /// Number of positions of the grid that have been tried.
    tried: u32,
    /// The best poses so far; once all positions have been tried, the best that are distinct.
    found: Vec<Candidate>,
    /// Number of `found` poses that have been climbed from; `None` before all positions have been tried.
    climbed: Option<u32>,
}

impl Physical for SearchState {
    fn is_possible(&self) -> bool {
        self.found.iter().all(|candidate| candidate.pose.is_possible() && candidate.log_likelihood.is_finite())
    }
}

/// How much of a search is done in each frame at least, whatever the clock says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SearchRate {
    /// The robot is lost: the whole grid is tried within 15 frames.
    Fast,
    /// A pose is believed: a fixed, small part is tried in each frame, so that frames take little longer than without a search.
    Background,
}

/// What a search is to find, and how fast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SearchRequest {
    /// Number of poses wanted, at most.
    pub candidates: usize,
    /// How much is done in each frame.
    pub rate: SearchRate,
}

impl SearchRate {
    /// Positions to try in each frame at least, of a grid of `count`.
    fn min_places(self, count: usize) -> usize {
        match self {
            Self::Fast => count.div_ceil(GRID_FRAMES),
            Self::Background => BACKGROUND_PLACES,
        }
    }

    /// Poses to climb from in each frame at least.
    fn min_climbed(self) -> usize {
        match self {
            Self::Fast => MIN_CLIMBED,
            Self::Background => BACKGROUND_CLIMBED,
        }
    }
}

impl SearchState {
    /// Whether a search has begun and not ended.
    pub fn is_under_way(&self) -> bool {
        self.tried > 0
    }

    /// Moves the poses found so far by the robot's step since the last frame.
    pub fn move_by(&mut self, walked: &Pose2) {
        for candidate in &mut self.found {
            candidate.pose = candidate.pose.compose(walked);
        }
    }
}

/// The grid of a search.
const SEARCH: Spacing = Spacing { step_m: 0.15, turns: TURNS, widened_m: 0.07 };
/// The grid of a survey, an eighth of the poses of a search.
const SURVEY: Spacing = Spacing { step_m: 0.3, turns: TURNS / 2, widened_m: 0.14 };
/// Number of headings at each position of the grid of a search.
const TURNS: usize = 80;
/// Neighbouring headings for which the line points in view are selected together.
const HEADINGS_TOGETHER: usize = 8;
/// On the grid one in so many line points is used.
const SPARSE_STEP: usize = 3;
/// Number of frames within which a fast search has tried the grid, whatever the clock says: 1.5 s at 10 Hz.
const GRID_FRAMES: usize = 15;
/// Positions of the grid that a background search tries in a frame: 6,000 poses.
const BACKGROUND_PLACES: usize = 75;
/// Number of the best grid poses that are kept.
const KEPT_ON_GRID: usize = 600;
/// Number of distinct grid poses that are climbed from.
const CLIMBED: usize = 60;
/// Number of poses that a fast search climbs from in a frame, whatever the clock says.
const MIN_CLIMBED: usize = 6;
/// Number of poses that a background search climbs from in a frame.
const BACKGROUND_CLIMBED: usize = 3;
/// Poses closer than this, and turned by less than [`SAME_RAD`], are the same candidate, metres.
const SAME_M: f64 = 0.4;
/// See [`SAME_M`]; radians.
const SAME_RAD: f64 = 0.3;
/// Step of the fine grid around the best pose of the widened lines, metres: about the width of a line.
const AROUND_M: f64 = 0.05;
/// Step of the fine grid in yaw, radians.
const AROUND_RAD: f64 = 0.02;
/// Steps of the fine grid to each side in x and y.
const AROUND_STEPS: i32 = 2;
/// Steps of the fine grid to each side in yaw.
const AROUND_TURNS: i32 = 5;
/// First steps of climbing: metres and radians.
const CLIMB: (f64, f64) = (0.05, 0.026);
/// Number of step lengths that climbing uses, each half of the one before.
const HALVINGS: usize = 8;

impl GlobalSearch {
    /// Makes a search over half of the carpet and `margin_m` around it.
    ///
    /// A field looks the same from both goals, so each pose stands for its mirror pose as well.
    pub fn new(field: &Field, margin_m: f64, observation: &Observation) -> Self {
        Self::on_grid(SEARCH, field, margin_m, observation)
    }

    /// Makes a search for [`survey`](Self::survey), on a wider grid.
    pub fn for_survey(field: &Field, margin_m: f64, observation: &Observation) -> Self {
        Self::on_grid(SURVEY, field, margin_m, observation)
    }

    fn on_grid(spacing: Spacing, field: &Field, margin_m: f64, observation: &Observation) -> Self {
        let step_m = spacing.step_m;
        let half = field.carpet_half_extent();
        let steps = |half: f64| libm::ceil((half + margin_m) / step_m) as i32;
        let (columns, rows) = (steps(half.x), steps(half.y));
        let grid: Vec<[f64; 2]> = (0..=columns)
            .flat_map(|column| (-rows..=rows).map(move |row| [f64::from(column) * step_m, f64::from(row) * step_m]))
            .collect();
        let stride = golden_stride(grid.len());
        let places = (0..grid.len()).map(|index| grid[index * stride % grid.len()]).collect();
        Self {
            spacing,
            places,
            sparse: observation.sparse(SPARSE_STEP),
            widened: GroundTable::default(),
            near: Points::default(),
        }
    }

    /// Returns the best poses, best first, or `None` if time is up before: then the next frame goes on from `state`.
    pub fn run(
        &mut self,
        observation: &Observation,
        table: &GroundTable,
        SearchRequest { candidates, rate }: SearchRequest,
        state: &mut SearchState,
        effort: &mut Effort,
        has_time: &mut TimeCheck,
    ) -> Option<Vec<Candidate>> {
        table.widen(self.spacing.widened_m, &mut self.widened);
        if state.climbed.is_none() && !self.try_grid(rate, state, effort, has_time) {
            return None;
        }
        let SearchState { found, climbed, .. } = state;
        let climbed = climbed.get_or_insert(0);
        // `found` is sorted, so the best poses come first.
        for (index, candidate) in found.iter_mut().skip(*climbed as usize).enumerate() {
            if index >= rate.min_climbed() && !has_time(effort.weighed) {
                effort.capped = true;
                return None;
            }
            *climbed += 1;
            *candidate = self.climbed(observation, table, *candidate, effort);
        }
        let mut found = core::mem::take(state).found;
        keep_best(&mut found, CLIMBED);
        Some(distinct(&found, candidates))
    }

    /// The best poses of the grid as they are, best first: where a search for the exact pose is worthwhile.
    pub fn survey(&mut self, table: &GroundTable, candidates: usize) -> Vec<Candidate> {
        table.widen(self.spacing.widened_m, &mut self.widened);
        let mut state = SearchState::default();
        let rate = SearchRate::Fast;
        self.try_grid(rate, &mut state, &mut Effort::default(), &mut super::filter::always);
        distinct(&state.found, candidates)
    }

    /// The best poses near `starts`, best first, as a search of the whole field would find them from there.
    pub fn run_from(
        &mut self,
        observation: &Observation,
        table: &GroundTable,
        starts: &[Candidate],
        candidates: usize,
    ) -> Vec<Candidate> {
        table.widen(SEARCH.widened_m, &mut self.widened);
        let mut effort = Effort::default();
        let each = starts.iter().map(|start| {
            let log_likelihood = self.sparse.log_likelihood(&self.widened, &start.pose);
            self.climbed(observation, table, Candidate { log_likelihood, ..*start }, &mut effort)
        });
        let mut found: Vec<Candidate> = each.collect();
        keep_best(&mut found, CLIMBED);
        distinct(&found, candidates)
    }

    /// The maximum near a pose of the grid. Half a step of the grid away from the right pose, the table itself has no gradient towards
    /// it; widened lines do, but their maximum is not exact.
    fn climbed(
        &mut self,
        observation: &Observation,
        table: &GroundTable,
        start: Candidate,
        effort: &mut Effort,
    ) -> Candidate {
        let points = &mut self.near;
        let near = climb(&self.sparse, &self.widened, start, points, effort);
        let nearest = best_around(observation, table, &near.pose, points, effort);
        climb(observation, table, nearest, points, effort)
    }

    /// Tries positions of the grid until time is up. Returns whether all have been tried: then `state` holds the best distinct poses.
    fn try_grid(
        &mut self,
        rate: SearchRate,
        state: &mut SearchState,
        effort: &mut Effort,
        has_time: &mut TimeCheck,
    ) -> bool {
        let SearchState { tried, found, .. } = state;
        let (mut done, least) = (0, rate.min_places(self.places.len()));
        for [x, y] in self.places.get(*tried as usize..).unwrap_or_default() {
            let turns = self.spacing.turns;
            let mut headings: [Candidate; TURNS] = core::array::from_fn(|turn| {
                let pose = Pose2::new(*x, *y, wrap_angle(TAU * turn as f64 / turns as f64));
                Candidate { pose, log_likelihood: 0.0 }
            });
            let headings = &mut headings[..turns];
            for beside in headings.chunks_mut(HEADINGS_TOGETHER) {
                let poses: [Pose2; HEADINGS_TOGETHER] = core::array::from_fn(|index| beside[index].pose);
                self.sparse.look_near(&self.widened, &poses, &mut self.near);
                for Candidate { pose, log_likelihood } in beside {
                    *log_likelihood = self.sparse.log_likelihood_near(&self.widened, pose, &self.near);
                }
            }
            found.extend(two_best_headings(headings));
            effort.weighed += turns as u32;
            *tried += 1;
            done += 1;
            if done >= least && !has_time(effort.weighed) {
                effort.capped = true;
                keep_best(found, KEPT_ON_GRID);
                return false;
            }
        }
        keep_best(found, KEPT_ON_GRID);
        *found = distinct(found, CLIMBED);
        true
    }
}

impl Candidate {
    /// Weighs a pose. `near` are the line points in view.
    fn of(pose: Pose2, observation: &Observation, table: &GroundTable, near: &Points) -> Self {
        Self { pose, log_likelihood: observation.log_likelihood_near(table, &pose, near) }
    }
}

/// A stride through `count` positions that visits all of them and, at any time, has visited them evenly.
///
/// It is about the golden section of `count` and coprime to it.
fn golden_stride(count: usize) -> usize {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let coprime = |stride: &usize| {
        let (mut a, mut b) = (count, *stride);
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a == 1
    };
    let start = (libm::round(count as f64 * GOLDEN) as usize).max(1);
    (start..).find(coprime).unwrap_or(1)
}

/// The best heading at one position, and the best of those farther than [`SAME_RAD`] from it.
fn two_best_headings(headings: &[Candidate]) -> impl Iterator<Item = Candidate> {
    let better = |a: &Candidate, b: &Candidate| a.log_likelihood.total_cmp(&b.log_likelihood);
    let first = headings.iter().copied().max_by(better);
    let second = first.and_then(|first| {
        let elsewhere = |other: &Candidate| wrap_angle(other.pose.yaw - first.pose.yaw).abs() > SAME_RAD;
        headings.iter().copied().filter(elsewhere).max_by(better)
    });
    first.into_iter().chain(second)
}

/// Sorts candidates, best first, and keeps the first `count`.
fn keep_best(candidates: &mut Vec<Candidate>, count: usize) {
    candidates.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    candidates.truncate(count);
}

/// The first `count` candidates that are not close to one before them, or to its mirror pose.
fn distinct(candidates: &[Candidate], count: usize) -> Vec<Candidate> {
    let mut kept: Vec<Candidate> = Vec::new();
    for candidate in candidates {
        let mirrored = candidate.pose.mirrored();
        let same = |other: &Candidate| {
            let near = |pose: &Pose2| {
                other.pose.distance(pose) < SAME_M && wrap_angle(other.pose.yaw - pose.yaw).abs() < SAME_RAD
            };
            near(&candidate.pose) || near(&mirrored)
        };
        if kept.len() < count && !kept.iter().any(same) {
            kept.push(*candidate);
        }
    }
    kept
}

/// The best pose of a fine grid around `pose`. `near` is a buffer.
fn best_around(
    observation: &Observation,
    table: &GroundTable,
    pose: &Pose2,
    near: &mut Points,
    effort: &mut Effort,
) -> Candidate {
    let aside_m = AROUND_M * f64::from(AROUND_STEPS);
    observation.look_around(table, pose, 2.0 * aside_m, AROUND_RAD * f64::from(AROUND_TURNS), near);
    let mut best = Candidate::of(*pose, observation, table, near);
    for turn in -AROUND_TURNS..=AROUND_TURNS {
        for ahead in -AROUND_STEPS..=AROUND_STEPS {
            for aside in -AROUND_STEPS..=AROUND_STEPS {
                let (x, y) = (AROUND_M * f64::from(ahead), AROUND_M * f64::from(aside));
                let off = Pose2::new(pose.x + x, pose.y + y, wrap_angle(pose.yaw + AROUND_RAD * f64::from(turn)));
                let candidate = Candidate::of(off, observation, table, near);
                if candidate.log_likelihood > best.log_likelihood {
                    best = candidate;
                }
            }
        }
    }
    effort.weighed += ((2 * AROUND_TURNS + 1) * (2 * AROUND_STEPS + 1) * (2 * AROUND_STEPS + 1)) as u32;
    best
}

/// Climbs from `start` to a local maximum: steps along each axis while that helps, then halves the step. `near` is a buffer.
pub fn climb(
    observation: &Observation,
    table: &GroundTable,
    start: Candidate,
    near: &mut Points,
    effort: &mut Effort,
) -> Candidate {
    /// Rounds of one step length, enough to cross the distance between two points of the grid several times.
    const ROUNDS: u32 = 8;
    let mut best = start;
    let (mut step, mut turn) = CLIMB;
    for _ in 0..HALVINGS {
        // A round may go one step along each axis, so this is the farthest that one step length leads.
        let (reach_m, reach_rad) = (1.5 * f64::from(ROUNDS + 1) * step, f64::from(ROUNDS + 1) * turn);
        observation.look_around(table, &best.pose, reach_m, reach_rad, near);
        for _ in 0..ROUNDS {
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
                let candidate = Candidate::of(pose, observation, table, near);
                effort.weighed += 1;
                if candidate.log_likelihood > best.log_likelihood {
                    best = candidate;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_of_the_visits_covers_the_grid_evenly_and_all_cover_it_whole() {
        for count in [1, 2, 6, 7, 100, 840, 841] {
            let stride = golden_stride(count);
            let mut visited: Vec<usize> = (0..count).map(|index| index * stride % count).collect();
            if count > 50 {
                // No gap between the first tenth of the visits is wider than four times their mean distance.
                let mut first: Vec<usize> = visited[..count / 10].to_vec();
                first.sort();
                assert!(first.windows(2).all(|pair| pair[1] - pair[0] <= 40), "{count}");
            }
            visited.sort();
            assert!(visited.into_iter().eq(0..count), "{count}");
        }
    }
}
