//! Where on the whole field could this frame have been taken? From coarse to fine: a grid of poses on a table in which
//! every line is widened to the grid's step, then the best of them on the table itself.

use core::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::filter::{Effort, MayGoOn};
use super::kernel::Points;
use super::observation::Observation;
use realitysim_geometry::{Field, Physical, Pose2, wrap_angle};
use realitysim_vision::GroundTable;

/// A local best of the search.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    pub pose: Pose2,
    pub log_likelihood: f64,
}

/// Looks for a robot on one field.
#[derive(Clone, Debug)]
pub struct GlobalSearch {
    /// In an order in which any part of them covers the field evenly.
    places: Vec<[f64; 2]>,
    /// Fewer line points: enough to tell where it is worth looking closer.
    sparse: Observation,
    widened: GroundTable,
    /// Line points in view of the poses at hand.
    near: Points,
}

/// A search that takes several frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SearchState {
    /// Places of the grid.
    tried: u32,
    /// The best of these so far; once all places have been tried, the best that are apart.
    found: Vec<Candidate>,
    /// Of these, how many have been climbed from; `None` before all places have been tried.
    climbed: Option<u32>,
}

impl Physical for SearchState {
    fn is_possible(&self) -> bool {
        self.found.iter().all(|candidate| candidate.pose.is_possible() && candidate.log_likelihood.is_finite())
    }
}

/// How much of a search is done in each frame, whatever the clock says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// The robot is lost: the whole grid within 15 frames.
    Hurried,
    /// A pose is believed: a fixed, small part in each frame, so that frames take little longer than without a search.
    Leisurely,
}

/// What a search is to find, and how fast.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SearchRequest {
    /// So many of the best poses.
    pub candidates: usize,
    pub pace: Pace,
}

impl Pace {
    fn fewest_places(self, of: usize) -> usize {
        match self {
            Self::Hurried => of.div_ceil(MOST_FRAMES),
            Self::Leisurely => PLACES_AT_LEISURE,
        }
    }

    fn fewest_climbed(self) -> usize {
        match self {
            Self::Hurried => FEWEST_CLIMBED,
            Self::Leisurely => CLIMBED_AT_LEISURE,
        }
    }
}

impl SearchState {
    pub fn is_under_way(&self) -> bool {
        self.tried > 0
    }

    /// The robot has walked since the last frame.
    pub fn carry_on(&mut self, walked: &Pose2) {
        for candidate in &mut self.found {
            candidate.pose = candidate.pose.compose(walked);
        }
    }
}

/// The grid. What half a step moves a line, [`WIDENED_M`] makes up for.
const STEP_M: f64 = 0.15;
const TURNS: usize = 80;
/// Neighbouring headings of which the line points in view are looked up together.
const BESIDE: usize = 8;
const WIDENED_M: f64 = 0.07;
/// One in so many line points is looked at on the grid.
const SPARSE: usize = 3;
/// Whatever the clock says, the grid is done with after so many frames: 1.5 s at 10 Hz.
const MOST_FRAMES: usize = 15;
/// Places of the grid that are tried in a frame where nothing hurries: 6,000 poses.
const PLACES_AT_LEISURE: usize = 75;
/// Poses of the grid that are kept, and of these, how many are climbed from.
const CLOSER: usize = 600;
const CLIMBED: usize = 60;
/// Climbed from in one frame whatever the clock says.
const FEWEST_CLIMBED: usize = 6;
const CLIMBED_AT_LEISURE: usize = 3;
/// Candidates closer than this are one.
const SAME_M: f64 = 0.4;
const SAME_RAD: f64 = 0.3;
/// Steps of the fine grid around where the widened lines fit best, about as far as a line is wide, and how many of them to
/// each side.
const AROUND_M: f64 = 0.05;
const AROUND_RAD: f64 = 0.02;
const AROUND_STEPS: i32 = 2;
const AROUND_TURNS: i32 = 5;
/// Metres and radians of the first steps of climbing, and how often they are halved.
const CLIMB: (f64, f64) = (0.05, 0.026);
const HALVINGS: usize = 8;

impl GlobalSearch {
    /// Over the carpet and `margin_m` around it. A field looks the same from both goals: each pose stands for its
    /// mirror pose as well.
    pub fn new(field: &Field, margin_m: f64, observation: &Observation) -> Self {
        let half = field.carpet_half_extent();
        let steps = |half: f64| libm::ceil((half + margin_m) / STEP_M) as i32;
        let (columns, rows) = (steps(half.x), steps(half.y));
        let grid: Vec<[f64; 2]> = (0..=columns)
            .flat_map(|column| (-rows..=rows).map(move |row| [f64::from(column) * STEP_M, f64::from(row) * STEP_M]))
            .collect();
        let stride = golden_stride(grid.len());
        let places = (0..grid.len()).map(|index| grid[index * stride % grid.len()]).collect();
        Self { places, sparse: observation.sparse(SPARSE), widened: GroundTable::default(), near: Points::default() }
    }

    /// The best poses, best first. `None` if time is up before: then `state` knows where the next frame goes on.
    pub fn run(
        &mut self,
        observation: &Observation,
        table: &GroundTable,
        SearchRequest { candidates, pace }: SearchRequest,
        state: &mut SearchState,
        effort: &mut Effort,
        may_go_on: &mut MayGoOn,
    ) -> Option<Vec<Candidate>> {
        table.widen(WIDENED_M, &mut self.widened);
        if state.climbed.is_none() && !self.try_grid(pace, state, effort, may_go_on) {
            return None;
        }
        let SearchState { found, climbed, .. } = state;
        let climbed = climbed.get_or_insert(0);
        // The best first.
        for (index, candidate) in found.iter_mut().skip(*climbed as usize).enumerate() {
            if index >= pace.fewest_climbed() && !may_go_on(effort.weighed) {
                effort.capped = true;
                return None;
            }
            *climbed += 1;
            // Half a step of the grid away from the right pose the table itself says little: only its widened lines do,
            // and these not exactly.
            let points = &mut self.near;
            let near = climb(&self.sparse, &self.widened, *candidate, points, effort);
            let nearest = best_around(observation, table, &near.pose, points, effort);
            *candidate = climb(observation, table, nearest, points, effort);
        }
        let mut found = core::mem::take(state).found;
        best_of(&mut found, CLIMBED);
        Some(apart(&found, candidates))
    }

    /// Whether all places have been tried: then the best of them are left that are apart.
    fn try_grid(&mut self, pace: Pace, state: &mut SearchState, effort: &mut Effort, may_go_on: &mut MayGoOn) -> bool {
        let SearchState { tried, found, .. } = state;
        let (mut done, least) = (0, pace.fewest_places(self.places.len()));
        for [x, y] in self.places.get(*tried as usize..).unwrap_or_default() {
            let mut headings: [Candidate; TURNS] = core::array::from_fn(|turn| {
                let pose = Pose2::new(*x, *y, wrap_angle(TAU * turn as f64 / TURNS as f64));
                Candidate { pose, log_likelihood: 0.0 }
            });
            for beside in headings.chunks_mut(BESIDE) {
                let poses: [Pose2; BESIDE] = core::array::from_fn(|index| beside[index].pose);
                self.sparse.look_near(&self.widened, &poses, &mut self.near);
                for Candidate { pose, log_likelihood } in beside {
                    *log_likelihood = self.sparse.log_likelihood_near(&self.widened, pose, &self.near);
                }
            }
            found.extend(two_best(&headings));
            effort.weighed += TURNS as u32;
            *tried += 1;
            done += 1;
            if done >= least && !may_go_on(effort.weighed) {
                effort.capped = true;
                best_of(found, CLOSER);
                return false;
            }
        }
        best_of(found, CLOSER);
        *found = apart(found, CLIMBED);
        true
    }
}

impl Candidate {
    /// `near` are the points in view.
    fn of(pose: Pose2, observation: &Observation, table: &GroundTable, near: &Points) -> Self {
        Self { pose, log_likelihood: observation.log_likelihood_near(table, &pose, near) }
    }
}

/// A step through `count` places that visits all of them and, at any time, has visited them evenly: about the golden
/// section of their number, and without a divisor in common with it.
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

/// Of the headings at one place, the best and the best of those that are no neighbours of it.
fn two_best(headings: &[Candidate]) -> impl Iterator<Item = Candidate> {
    let better = |a: &Candidate, b: &Candidate| a.log_likelihood.total_cmp(&b.log_likelihood);
    let first = headings.iter().copied().max_by(better);
    let second = first.and_then(|first| {
        let elsewhere = |other: &Candidate| wrap_angle(other.pose.yaw - first.pose.yaw).abs() > SAME_RAD;
        headings.iter().copied().filter(elsewhere).max_by(better)
    });
    first.into_iter().chain(second)
}

fn best_of(candidates: &mut Vec<Candidate>, count: usize) {
    candidates.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
    candidates.truncate(count);
}

/// Of candidates in their order, those that are no neighbours of one before them or of its mirror pose.
fn apart(candidates: &[Candidate], count: usize) -> Vec<Candidate> {
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

/// Of the poses of a fine grid around one. `near` is only room to work in.
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

/// Steps along each axis while that helps, then with half the step. `near` is only room to work in.
pub fn climb(
    observation: &Observation,
    table: &GroundTable,
    start: Candidate,
    near: &mut Points,
    effort: &mut Effort,
) -> Candidate {
    /// Rounds of one step length: enough to cross the distance between two points of the grid several times.
    const ROUNDS: u32 = 8;
    let mut best = start;
    let (mut step, mut turn) = CLIMB;
    for _ in 0..HALVINGS {
        // A round may go one step along each axis.
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
    fn any_part_of_the_places_covers_the_field_and_the_whole_all_of_them() {
        for count in [1, 2, 6, 7, 100, 840, 841] {
            let stride = golden_stride(count);
            let mut visited: Vec<usize> = (0..count).map(|index| index * stride % count).collect();
            if count > 50 {
                // No gap in the first tenth is wider than four times the mean one.
                let mut first: Vec<usize> = visited[..count / 10].to_vec();
                first.sort();
                assert!(first.windows(2).all(|pair| pair[1] - pair[0] <= 40), "{count}");
            }
            visited.sort();
            assert!(visited.into_iter().eq(0..count), "{count}");
        }
    }
}
