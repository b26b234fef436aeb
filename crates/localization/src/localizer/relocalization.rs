//! Lost: the whole field is tried, and what fits the frame best, refined, is where the robot starts over.

use std::collections::VecDeque;

use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

use super::{FrameSensors, Localizer, TriedPose};
use crate::filter::{Effort, MayGoOn};
use crate::global_search::{Candidate, Pace, SearchRequest};
use crate::particles::Spread;
use crate::refinement::Refined;
use crate::slow_states::SlowStateFilter;
use crate::validation::{THRESHOLDS, TrackingState, agrees, convinces, is_whole};
use realitysim_geometry::{Physical, Pose2, wrap_angle};
use realitysim_vision::Observations;

/// While lost, only every so many frames pay for a search.
const SEARCH_EVERY: u64 = 3;
/// A pose a little off the carpet is possible.
pub(super) const SEARCH_MARGIN_M: f64 = 0.3;
const CANDIDATES: usize = 16;
/// Of these, how many are refined in a frame whatever the clock says.
const FEWEST_FITTED: usize = 3;
/// A pose so far from the best one, and from its mirror pose, that explains so much of what that does: the frame does not
/// say which it is.
const ELSEWHERE_M: f64 = 0.5;
const ELSEWHERE_RAD: f64 = 0.5;
const RIVALS: f64 = 0.9;
/// A pose that was believed is left for one that explains the frame so much better.
const BEATEN: f64 = 0.8;
/// Or so much better, where the frame shows much that no pose explains.
const OUTSHONE: f64 = 0.6;
/// As near to the pose believed so far its own refinement would have come.
const AGAIN_M: f64 = 0.15;
const AGAIN_RAD: f64 = 0.1;

impl Localizer {
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

    /// Tries the whole field. Of the two mirror poses the one nearer to the last known pose is taken. Whether the robot is
    /// somewhere else now than it was believed to be; `walked` since the last frame.
    pub(super) fn search(
        &mut self,
        moment: &FrameSensors,
        seen: &Observations,
        walked: Option<Pose2>,
        effort: &mut Effort,
        may_go_on: &mut MayGoOn,
    ) -> bool {
        let tracking = self.state.validator.tracking;
        let is_tracking = matches!(tracking, TrackingState::Tracking { .. }) && !self.state.validator.is_lost();
        let has_pose = (is_tracking || matches!(tracking, TrackingState::Candidate { .. }))
            && !self.filter.state().particles.is_empty();
        if !has_pose {
            self.state.validator.tracking = TrackingState::Lost;
        }
        let before = Effort { ..*effort };
        let is_hurried = !is_tracking || self.state.validator.is_urgent();
        // A look that takes its time does in each frame what has to be done in one, and no more.
        let pace = if is_hurried { Pace::Hurried } else { Pace::Leisurely };
        let mut may_go_on = |weighed: u32| is_hurried && may_go_on(weighed);
        if !self.state.fitting.is_under_way() {
            let (table, state) = (&seen.table, &mut self.state.search);
            let observation = self.filter.observation();
            let found = self.search.run(
                observation,
                table,
                SearchRequest { candidates: CANDIDATES, pace },
                state,
                effort,
                &mut may_go_on,
            );
            // A look that takes its time leaves nothing out.
            effort.capped &= is_hurried || before.capped;
            let Some(found) = found else { return false };
            let now = |track: &SlowStateFilter| track.pose().compose(&walked.unwrap_or_default());
            let believed = self.state.track.as_ref().map(now).filter(|_| has_pose && self.settings.refinement);
            self.state.fitting = CandidateRefinement::of(believed, &found);
            if !is_hurried {
                return false;
            }
        }
        let best = match self.settings.refinement {
            false => self.best_supported(seen),
            true => {
                if !self.fit(moment, seen, effort, &mut may_go_on) {
                    effort.capped |= is_hurried;
                    return false;
                }
                self.settle(is_tracking)
            }
        };
        self.state.fitting = CandidateRefinement::default();
        let Some(pose) = best else { return false };
        let pose = self.state.known.map_or(pose, |known| known.nearer_of(pose));
        self.state.ambiguous |= !self.state.known.is_some_and(|known| known.leads_to(&pose));
        self.place(pose, self.settings.initial);
        self.state.validator.found_by_search();
        true
    }

    /// Where to start over, if anywhere, now that all candidates are fitted.
    fn settle(&mut self, is_tracking: bool) -> Option<Pose2> {
        let CandidateRefinement { believed, fits, .. } = &self.state.fitting;
        let best = only_best(fits);
        let Some(believed) = *believed else { return best };
        let again = |pose: &Pose2| is_near(pose, &believed, AGAIN_M, AGAIN_RAD);
        if !is_tracking {
            let found_again = best.as_ref().is_some_and(again);
            self.state.validator.field_was_searched(believed, found_again);
            return best.filter(|_| !found_again);
        }
        let own = fits.iter().find(|fit| again(&fit.pose));
        let beaten = |by: &&ScoredPose| {
            // Where too few lines fit the place believed, another one's need not explain all that is seen.
            own.map_or(by.convinces || by.is_whole, |own| {
                let needed = if by.convinces { BEATEN } else { OUTSHONE };
                own.worth < needed * by.worth
                    && own.fitting <= by.fitting
                    && (by.convinces || own.explained <= by.explained)
            })
        };
        let Some(better) = fits.first().filter(beaten) else {
            self.state.validator.found_nothing_better();
            return None;
        };
        // Where several are better nobody knows which it is, but not this one.
        if best.is_none() && !again(&better.pose) {
            self.state.validator.tracking = TrackingState::Lost;
        }
        best
    }

    fn best_supported(&self, seen: &Observations) -> Option<Pose2> {
        let valid = &self.settings.valid;
        self.state.fitting.left.front().copied().filter(|pose| {
            let support = self.filter.observation().support(seen.lines(), pose);
            support.share >= valid.share && support.weight >= valid.points
        })
    }

    /// Refines the candidates; whether that is all. The best are first then.
    pub(super) fn fit(
        &mut self,
        moment: &FrameSensors,
        seen: &Observations,
        effort: &mut Effort,
        may_go_on: &mut MayGoOn,
    ) -> bool {
        let Some(place) = moment.footprint_from_optical else { return false };
        let mut index = 0;
        while let Some(pose) = self.state.fitting.left.pop_front() {
            index += 1;
            // Every question to the clock has a number of its own.
            effort.weighed += 1;
            if let Some(Refined { lines, map_from_optical, .. }) = self.refine_candidate(moment, seen, &pose)
                // A picture without lines fits everywhere, best where none are to be seen: no reason to go there.
                && agrees(&lines)
            {
                let explained = self.painted.explained(seen.lines(), &place, &map_from_optical).share;
                let worth = lines.visible * (lines.share - THRESHOLDS.contradicted_share) * explained;
                let pose = Pose2::from_isometry(&(map_from_optical * place.inverse()));
                let convinces = convinces(&lines, explained, self.settings.valid.explained);
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
            if index >= FEWEST_FITTED && !may_go_on(effort.weighed) {
                break;
            }
        }
        self.state.fitting.fits.sort_by(|a, b| b.worth.total_cmp(&a.worth));
        self.state.fitting.left.is_empty()
    }

    fn refine_candidate(&mut self, moment: &FrameSensors, seen: &Observations, pose: &Pose2) -> Option<Refined> {
        let model = self.model(moment);
        let Spread { xy_m, yaw_rad } = self.settings.initial;
        let track = match &self.state.track {
            // Where it was believed to be, wrongly, it may have learnt to lean.
            Some(track) if !matches!(self.state.validator.tracking, TrackingState::Candidate { .. }) => {
                track.moved_to(*pose, xy_m, yaw_rad).with_lean_forgotten(&model)
            }
            Some(track) => track.moved_to(*pose, xy_m, yaw_rad),
            None => SlowStateFilter::around(*pose, xy_m, yaw_rad, &model),
        };
        let prediction = self.prediction_by(&track, moment)?.with_lens_known();
        self.refiner.refine(&seen.image, &prediction.prior, &[Vector6::zeros()])
    }
}

/// Candidates that are being refined, over several frames where time is short: the pose believed so far, and what was found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CandidateRefinement {
    left: VecDeque<Pose2>,
    believed: Option<Pose2>,
    fits: Vec<ScoredPose>,
}

impl Physical for CandidateRefinement {
    fn is_possible(&self) -> bool {
        let is_fit = |fit: &ScoredPose| fit.pose.is_possible() && fit.worth.is_finite() && fit.explained.is_finite();
        self.left.iter().all(Physical::is_possible) && self.believed.is_possible() && self.fits.iter().all(is_fit)
    }
}

impl CandidateRefinement {
    pub(super) fn of(believed: Option<Pose2>, found: &[Candidate]) -> Self {
        let left = believed.into_iter().chain(found.iter().map(|candidate| candidate.pose)).collect();
        Self { left, believed, fits: Vec::new() }
    }

    fn is_under_way(&self) -> bool {
        !self.left.is_empty()
    }

    /// The poses that were refined, the best first.
    pub(super) fn tried(&self) -> Vec<TriedPose> {
        let tried = self.fits.iter().map(|fit| {
            let ScoredPose { pose: Pose2 { x, y, yaw }, worth, fitting, explained, .. } = *fit;
            TriedPose { x, y, yaw_deg: yaw.to_degrees(), worth, fitting, explained }
        });
        tried.collect()
    }

    /// The robot has walked since the last frame.
    pub(super) fn carry_on(&mut self, walked: &Pose2) {
        let poses = self.left.iter_mut().chain(&mut self.believed).chain(self.fits.iter_mut().map(|fit| &mut fit.pose));
        poses.for_each(|pose| *pose = pose.compose(walked));
    }
}

/// A pose and what speaks for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct ScoredPose {
    worth: f64,
    pose: Pose2,
    /// Line places.
    fitting: usize,
    /// Share of the line seen.
    explained: f64,
    convinces: bool,
    /// Hardly a line is missing, whatever it leaves unexplained.
    is_whole: bool,
}

/// The best one, unless another place explains the frame nearly as well.
fn only_best(fits: &[ScoredPose]) -> Option<Pose2> {
    let best = fits.first()?;
    let rivals = |other: &ScoredPose| {
        other.worth > RIVALS * best.worth && !is_near(&other.pose, &best.pose, ELSEWHERE_M, ELSEWHERE_RAD)
    };
    (!fits.iter().any(rivals)).then_some(best.pose)
}

fn is_at(one: &Pose2, other: &Pose2, within_m: f64, within_rad: f64) -> bool {
    one.distance(other) <= within_m && wrap_angle(one.yaw - other.yaw).abs() <= within_rad
}

/// Up to the mirror: on the halfway line a pose and its mirror pose are neighbours.
fn is_near(one: &Pose2, other: &Pose2, within_m: f64, within_rad: f64) -> bool {
    is_at(one, other, within_m, within_rad) || is_at(one, &other.mirrored(), within_m, within_rad)
}
