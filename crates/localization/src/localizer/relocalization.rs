//! Relocalization: the whole field is searched, the candidates are refined, and the robot starts over where the frame fits best.

use std::collections::VecDeque;

use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

use super::{FrameSensors, Localizer, TriedPose};
use crate::filter::{Effort, TimeCheck};
use crate::global_search::{Candidate, SearchRate, SearchRequest};
use crate::particles::Spread;
use crate::refinement::Refined;
use crate::slow_states::SlowStateFilter;
use crate::validation::{THRESHOLDS, TrackingState, agrees, convinces, is_whole};
use realitysim_geometry::{Physical, Pose2, wrap_angle};
use realitysim_vision::Observations;

/// A new search begins only in one of this many frames.
const SEARCH_EVERY: u64 = 3;
/// Margin around the carpet in which the robot is searched for, metres.
pub(super) const SEARCH_MARGIN_M: f64 = 0.3;
/// Number of candidates that a search is asked for.
const CANDIDATES: usize = 16;
/// Number of candidates that are refined in a frame, whatever the clock says.
const MIN_REFINED: usize = 3;
/// Distance beyond which a candidate is another pose than the best one and its mirror pose, metres.
const ELSEWHERE_M: f64 = 0.5;
/// Turn beyond which a candidate is another pose than the best one and its mirror pose, radians.
const ELSEWHERE_RAD: f64 = 0.5;
/// Share of the best pose's worth above which another pose is a rival: the frame does not decide between them.
const RIVAL_SHARE: f64 = 0.9;
/// A believed pose is left for one if its worth is below this share of the other's.
const BEATEN_SHARE: f64 = 0.8;
/// The same share if the other pose is not convincing by itself, since the frame shows much that no pose explains.
const OUTSHONE_SHARE: f64 = 0.6;
/// Distance within which refinement of the believed pose may end: such a pose is the same again, metres.
const AGAIN_M: f64 = 0.15;
/// See [`AGAIN_M`]; radians.
const AGAIN_RAD: f64 = 0.1;

impl Localizer {
    /// Whether the whole field is to be searched in this frame.
    pub(super) fn must_search(&self) -> bool {
        let is_under_way = self.state.search.is_under_way() || self.state.fitting.is_under_way();
        let is_turn = is_under_way || self.filter.state().steps.is_multiple_of(SEARCH_EVERY);
        match self.state.validator.tracking {
            TrackingState::Lost => is_turn,
            TrackingState::Candidate { .. } => {
                self.filter.state().particles.is_empty() || is_under_way || self.state.validator.is_unconvincing()
            }
            TrackingState::Tracking { .. } if self.state.validator.is_lost() => true,
            TrackingState::Tracking { .. } => is_turn && (is_under_way || self.state.validator.relocalization_is_due()),
        }
    }

    /// Searches the whole field, or goes on with a search under way. Returns whether the robot starts over at a pose that was found.
    ///
    /// Of two mirror poses, the one nearer to the last known pose is taken. `walked` is the robot's step since the last frame.
    pub(super) fn search(
        &mut self,
        moment: &FrameSensors,
        seen: &Observations,
        walked: Option<Pose2>,
        effort: &mut Effort,
        has_time: &mut TimeCheck,
    ) -> bool {
        let tracking = self.state.validator.tracking;
        let is_tracking = matches!(tracking, TrackingState::Tracking { .. }) && !self.state.validator.is_lost();
        let has_pose = (is_tracking || matches!(tracking, TrackingState::Candidate { .. }))
            && !self.filter.state().particles.is_empty();
        if !has_pose {
            self.state.validator.tracking = TrackingState::Lost;
        }
        let before = Effort { ..*effort };
        let is_fast = !is_tracking || self.state.validator.is_urgent();
        // A background search does in each frame what must be done in one, and no more.
        let rate = if is_fast { SearchRate::Fast } else { SearchRate::Background };
        let mut has_time = |weighed: u32| is_fast && has_time(weighed);
        if !self.state.fitting.is_under_way() {
            let (table, state) = (&seen.table, &mut self.state.search);
            let observation = self.filter.observation();
            let found = self.search.run(
                observation,
                table,
                SearchRequest { candidates: CANDIDATES, rate },
                state,
                effort,
                &mut has_time,
            );
            // A background search leaves nothing out, so it does not count as capped.
            effort.capped &= is_fast || before.capped;
            let Some(found) = found else { return false };
            let now = |track: &SlowStateFilter| track.pose().compose(&walked.unwrap_or_default());
            let believed = self.state.track.as_ref().map(now).filter(|_| has_pose && self.settings.refinement);
            self.state.fitting = CandidateRefinement::of(believed, &found);
            if !is_fast {
                return false;
            }
        }
        let best = match self.settings.refinement {
            false => self.best_supported(seen),
            true => {
                if !self.refine_candidates(moment, seen, effort, &mut has_time) {
                    effort.capped |= is_fast;
                    return false;
                }
                self.choose_pose(is_tracking)
            }
        };
        self.state.fitting = CandidateRefinement::default();
        let Some(pose) = best else { return false };
        let pose = self.state.known.map_or(pose, |known| known.nearer_mirror(pose));
        self.state.ambiguous |= !self.state.known.is_some_and(|known| known.is_consistent_with(&pose));
        self.restart_at(pose, self.settings.initial);
        self.state.validator.start_found();
        true
    }

    /// The pose to start over at, if any, when all candidates are refined.
    fn choose_pose(&mut self, is_tracking: bool) -> Option<Pose2> {
        let CandidateRefinement { believed, fits, .. } = &self.state.fitting;
        let best = best_without_rival(fits);
        let Some(believed) = *believed else { return best };
        let again = |pose: &Pose2| is_near_or_mirrored(pose, &believed, AGAIN_M, AGAIN_RAD);
        if !is_tracking {
            let found_again = best.as_ref().is_some_and(again);
            self.state.validator.note_search(believed, found_again);
            return best.filter(|_| !found_again);
        }
        let own = fits.iter().find(|fit| again(&fit.pose));
        let beaten = |by: &&ScoredPose| {
            // If too few lines fit the believed pose, a better one need not explain all that is seen.
            own.map_or(by.convinces || by.is_whole, |own| {
                let needed = if by.convinces { BEATEN_SHARE } else { OUTSHONE_SHARE };
                own.worth < needed * by.worth
                    && own.fitting <= by.fitting
                    && (by.convinces || own.explained <= by.explained)
            })
        };
        let Some(better) = fits.first().filter(beaten) else {
            self.state.validator.note_fruitless_search();
            return None;
        };
        // If several poses are better, it is unknown which is right, but the believed one is wrong.
        if best.is_none() && !again(&better.pose) {
            self.state.validator.tracking = TrackingState::Lost;
        }
        best
    }

    /// Without refinement: the best candidate, if the frame supports it well enough.
    fn best_supported(&self, seen: &Observations) -> Option<Pose2> {
        let valid = &self.settings.valid;
        self.state.fitting.left.front().copied().filter(|pose| {
            let support = self.filter.observation().support(seen.lines(), pose);
            support.share >= valid.share && support.weight >= valid.points
        })
    }

    /// Refines candidates until time is up and sorts them, best first. Returns whether all are refined.
    pub(super) fn refine_candidates(
        &mut self,
        moment: &FrameSensors,
        seen: &Observations,
        effort: &mut Effort,
        has_time: &mut TimeCheck,
    ) -> bool {
        let Some(place) = moment.footprint_from_optical else { return false };
        let mut index = 0;
        while let Some(pose) = self.state.fitting.left.pop_front() {
            index += 1;
            // A refinement counts as one pose, so that no two calls of `has_time` have the same argument.
            effort.weighed += 1;
            if let Some(Refined { lines, map_from_optical, .. }) = self.refine_candidate(moment, seen, &pose)
                // A picture without lines fits everywhere, best where none are expected, which is no evidence.
                && agrees(&lines)
            {
                let explained = self.line_distances.explained(seen.lines(), &place, &map_from_optical).share;
                let worth = lines.visible * (lines.share - THRESHOLDS.contradicted_share) * explained;
                let pose = Pose2::from_isometry(&(map_from_optical * place.inverse()));
                let convinces = convinces(&lines, explained);
                let is_whole = is_whole(&lines);
                self.state.fitting.fits.push(ScoredPose {
                    worth,
                    pose,
                    fitting: lines.fitting,
                    explained,
                    convinces,
                    is_whole,
                });
            }
            if index >= MIN_REFINED && !has_time(effort.weighed) {
                break;
            }
        }
        self.state.fitting.fits.sort_by(|a, b| b.worth.total_cmp(&a.worth));
        self.state.fitting.left.is_empty()
    }

    /// Refines one candidate by least squares.
    fn refine_candidate(&mut self, moment: &FrameSensors, seen: &Observations, pose: &Pose2) -> Option<Refined> {
        let model = self.model(moment);
        let Spread { xy_m, yaw_rad } = self.settings.initial;
        let track = match &self.state.track {
            // At a wrong pose the filter may have learnt a wrong lean.
            Some(track) if !matches!(self.state.validator.tracking, TrackingState::Candidate { .. }) => {
                track.moved_to(*pose, xy_m, yaw_rad).with_lean_forgotten(&model)
            }
            Some(track) => track.moved_to(*pose, xy_m, yaw_rad),
            None => SlowStateFilter::around(*pose, xy_m, yaw_rad, &model),
        };
        let prediction = self.prediction_of(&track, moment)?.with_lens_known();
        self.refiner.refine(&seen.image, &prediction.prior, &[Vector6::zeros()])
    }
}

/// Candidates that are being refined, over several frames where time is short.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CandidateRefinement {
    /// Candidates that are not refined yet; the believed pose comes first.
    left: VecDeque<Pose2>,
    /// The pose believed so far, if any.
    believed: Option<Pose2>,
    /// Candidates that are refined and agree with the lines.
    fits: Vec<ScoredPose>,
}

impl Physical for CandidateRefinement {
    fn is_possible(&self) -> bool {
        let is_fit = |fit: &ScoredPose| fit.pose.is_possible() && fit.worth.is_finite() && fit.explained.is_finite();
        self.left.iter().all(Physical::is_possible) && self.believed.is_possible() && self.fits.iter().all(is_fit)
    }
}

impl CandidateRefinement {
    /// The believed pose and the candidates of a search, to be refined.
    pub(super) fn of(believed: Option<Pose2>, found: &[Candidate]) -> Self {
        let left = believed.into_iter().chain(found.iter().map(|candidate| candidate.pose)).collect();
        Self { left, believed, fits: Vec::new() }
    }

    /// Whether candidates are left to refine.
    fn is_under_way(&self) -> bool {
        !self.left.is_empty()
    }

    /// The poses that were refined, the best first.
    pub(super) fn tried_poses(&self) -> Vec<TriedPose> {
        let tried = self.fits.iter().map(|fit| {
            let ScoredPose { pose: Pose2 { x, y, yaw }, worth, fitting, explained, .. } = *fit;
            TriedPose { x, y, yaw_deg: yaw.to_degrees(), worth, fitting, explained }
        });
        tried.collect()
    }

    /// Moves all poses by the robot's step since the last frame.
    pub(super) fn move_by(&mut self, walked: &Pose2) {
        let poses = self.left.iter_mut().chain(&mut self.believed).chain(self.fits.iter_mut().map(|fit| &mut fit.pose));
        poses.for_each(|pose| *pose = pose.compose(walked));
    }
}

/// A refined pose and what speaks for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct ScoredPose {
    /// See [`TriedPose::worth`].
    worth: f64,
    pose: Pose2,
    /// Number of line places that fit.
    fitting: usize,
    /// Share of the seen line that the pose explains.
    explained: f64,
    /// Whether lines are good enough to leave a believed pose for this one.
    convinces: bool,
    /// Whether hardly a line is missing, however much is unexplained.
    is_whole: bool,
}

/// The best pose, unless another one explains the frame nearly as well.
fn best_without_rival(fits: &[ScoredPose]) -> Option<Pose2> {
    let best = fits.first()?;
    let rivals = |other: &ScoredPose| {
        other.worth > RIVAL_SHARE * best.worth
            && !is_near_or_mirrored(&other.pose, &best.pose, ELSEWHERE_M, ELSEWHERE_RAD)
    };
    (!fits.iter().any(rivals)).then_some(best.pose)
}

/// Whether two poses are within `within_m` and `within_rad` of each other.
fn is_near(one: &Pose2, other: &Pose2, within_m: f64, within_rad: f64) -> bool {
    one.distance(other) <= within_m && wrap_angle(one.yaw - other.yaw).abs() <= within_rad
}

/// Whether two poses are near each other, or one is near the other's mirror pose.
fn is_near_or_mirrored(one: &Pose2, other: &Pose2, within_m: f64, within_rad: f64) -> bool {
    is_near(one, other, within_m, within_rad) || is_near(one, &other.mirrored(), within_m, within_rad)
}
