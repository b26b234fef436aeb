//! Lost: the whole field is tried, and what fits the frame best, refined, is where the robot starts over.

use nalgebra::Vector6;

use super::{Localizer, Moment};
use crate::geometry::{Pose2, wrap_angle};
use crate::localization::filter::{Effort, MayGoOn};
use crate::localization::global::Candidate;
use crate::localization::particles::Spread;
use crate::localization::refinement::{self, Refined};
use crate::localization::track::Track;
use crate::localization::verdict::{CONTRADICTED, Confidence, agrees};
use crate::vision::Seen;

/// While lost, only every so many frames pay for a search.
const SEARCH_EVERY: u64 = 3;
/// A pose a little off the carpet is possible.
pub(super) const SEARCH_MARGIN_M: f64 = 0.3;
const CANDIDATES: usize = 16;
/// Of these, how many are refined whatever the clock says: the first that fits is not always the right one.
const FEWEST_FITTED: usize = 4;
/// A pose so far from the best one, and from its mirror pose, that explains so much of what that does: the frame does not
/// say which it is.
const ELSEWHERE_M: f64 = 0.5;
const ELSEWHERE_RAD: f64 = 0.5;
const RIVALS: f64 = 0.9;
/// As near to the pose believed so far its own refinement would have come.
const AGAIN_M: f64 = 0.15;
const AGAIN_RAD: f64 = 0.1;

impl Localizer {
    pub(super) fn must_search(&self) -> bool {
        let is_turn = self.state.search.is_under_way() || self.filter.state().steps.is_multiple_of(SEARCH_EVERY);
        match self.state.standing.confidence {
            Confidence::Nowhere => is_turn,
            Confidence::Unconfirmed(_) => {
                self.filter.state().particles.is_empty() || (self.state.standing.is_unconvincing() && is_turn)
            }
            Confidence::Tracking(_) => self.state.standing.is_lost(),
        }
    }

    /// Tries the whole field. Of the two mirror poses the one nearer to the last known pose is taken.
    pub(super) fn search(&mut self, moment: &Moment, seen: &Seen, effort: &mut Effort, may_go_on: &mut MayGoOn) {
        let has_pose = matches!(self.state.standing.confidence, Confidence::Unconfirmed(_))
            && !self.filter.state().particles.is_empty();
        if !has_pose {
            self.state.standing.confidence = Confidence::Nowhere;
        }
        let state = &mut self.state.search;
        let found = self.search.run(self.filter.observation(), &seen.table, CANDIDATES, state, effort, may_go_on);
        if self.state.search.is_under_way() {
            return;
        }
        let believed = self.state.track.as_ref().map(Track::pose).filter(|_| has_pose);
        let best = if self.settings.refinement {
            self.best_fit(moment, seen, &found, believed, effort, may_go_on)
        } else {
            let valid = &self.settings.valid;
            found.first().map(|candidate| candidate.pose).filter(|pose| {
                let support = self.filter.observation().support(seen.lines(), pose);
                support.share >= valid.share && support.weight >= valid.points
            })
        };
        if let Some(believed) = believed {
            let found_again = best.is_some_and(|best| is_near(&best, &believed, AGAIN_M, AGAIN_RAD));
            self.state.standing.looked_again(believed, found_again);
            if found_again {
                return;
            }
        }
        let Some(pose) = best else { return };
        let mirrored = pose.mirrored();
        let nearer = self.state.known.is_some_and(|known| apart(&mirrored, &known) < apart(&pose, &known));
        self.place(if nearer { mirrored } else { pose }, self.settings.initial);
        self.state.standing.found();
        self.state.ambiguous = true;
    }

    /// The candidate, or the pose believed so far, whose lines fit best, once refined; none if another place explains the
    /// frame nearly as well.
    fn best_fit(
        &self,
        moment: &Moment,
        seen: &Seen,
        found: &[Candidate],
        believed: Option<Pose2>,
        effort: &mut Effort,
        may_go_on: &mut MayGoOn,
    ) -> Option<Pose2> {
        struct Fit {
            worth: f64,
            pose: Pose2,
        }
        let place = moment.footprint_from_optical?;
        let mut fits: Vec<Fit> = Vec::new();
        for (index, pose) in believed.into_iter().chain(found.iter().map(|candidate| candidate.pose)).enumerate() {
            if index >= FEWEST_FITTED && !may_go_on(effort.weighed) {
                effort.capped = true;
                break;
            }
            // Every question to the clock has a number of its own.
            effort.weighed += 1;
            let Some(Refined { lines, map_from_optical, .. }) = self.refine_candidate(moment, seen, &pose) else {
                continue;
            };
            // A picture without lines fits everywhere, best where none are to be seen: no reason to go there.
            if agrees(&lines) {
                let explained = self.painted.explained(seen.lines(), &place, &map_from_optical).share;
                let worth = (lines.fitting as f64 - lines.expected as f64 * CONTRADICTED) * explained;
                fits.push(Fit { worth, pose: Pose2::from_isometry(&(map_from_optical * place.inverse())) });
            }
        }
        fits.sort_by(|a, b| b.worth.total_cmp(&a.worth));
        let best = fits.first()?;
        let rivals = |other: &Fit| {
            other.worth > RIVALS * best.worth && !is_near(&other.pose, &best.pose, ELSEWHERE_M, ELSEWHERE_RAD)
        };
        (!fits.iter().any(rivals)).then_some(best.pose)
    }

    fn refine_candidate(&self, moment: &Moment, seen: &Seen, pose: &Pose2) -> Option<Refined> {
        let model = &self.model(moment);
        let Spread { xy_m, yaw_rad } = self.settings.initial;
        let track = match &self.state.track {
            Some(track) => track.moved_to(*pose, xy_m, yaw_rad),
            None => Track::around(*pose, xy_m, yaw_rad, model),
        };
        let prediction = track.prior(&moment.footprint_from_optical?, model);
        refinement::refine(&self.points, &seen.image, &self.projector, &prediction.prior, &[Vector6::zeros()])
    }
}

/// Up to the mirror: on the halfway line a pose and its mirror pose are neighbours.
fn is_near(one: &Pose2, other: &Pose2, within_m: f64, within_rad: f64) -> bool {
    let near = |other: &Pose2| one.distance(other) <= within_m && wrap_angle(one.yaw - other.yaw).abs() <= within_rad;
    near(other) || near(&other.mirrored())
}

/// Metres, a radian counting as one.
fn apart(one: &Pose2, other: &Pose2) -> f64 {
    one.distance(other) + wrap_angle(one.yaw - other.yaw).abs()
}
