//! Lost: the whole field is tried, and what fits the frame best, refined, is where the robot starts over.

use glam::DVec2;
use nalgebra::Vector6;

use super::{Localizer, Moment};
use crate::geometry::Pose2;
use crate::localization::filter::{Effort, MayGoOn};
use crate::localization::global::Candidate;
use crate::localization::particles::Spread;
use crate::localization::refinement::{self, Refined};
use crate::localization::track::Track;
use crate::localization::verdict::{CONFIRMATIONS, CONTRADICTED, Confidence, agrees};
use crate::vision::Seen;

/// While lost, only every so many frames pay for a search.
const SEARCH_EVERY: u64 = 3;
/// A pose a little off the carpet is possible.
pub(super) const SEARCH_MARGIN_M: f64 = 0.3;
const CANDIDATES: usize = 12;
/// Of these, how many are refined whatever the clock says: the first that fits is not always the right one.
const FEWEST_FITTED: usize = 4;
/// A place so far from the best one that explains so much of what that does: the frame does not say which it is.
const ELSEWHERE_M: f64 = 0.5;
const RIVALS: f64 = 0.9;

impl Localizer {
    pub(super) fn must_search(&self) -> bool {
        match self.state.standing.confidence {
            Confidence::Nowhere => {
                self.state.search.is_under_way() || self.filter.state().steps.is_multiple_of(SEARCH_EVERY)
            }
            Confidence::Unconfirmed(_) => self.filter.state().particles.is_empty(),
            Confidence::Tracking(_) => self.state.standing.is_lost(),
        }
    }

    /// Tries the whole field. Of the two mirror poses the one nearer to the last known pose is taken.
    pub(super) fn search(&mut self, moment: &Moment, seen: &Seen, effort: &mut Effort, may_go_on: &mut MayGoOn) {
        self.state.standing.confidence = Confidence::Nowhere;
        let known = self.state.known;
        let state = &mut self.state.search;
        let found = self.search.run(self.filter.observation(), &seen.table, CANDIDATES, state, effort, may_go_on);
        let best = if self.settings.refinement {
            self.best_fit(moment, seen, &found, effort, may_go_on)
        } else {
            let valid = &self.settings.valid;
            found.first().map(|candidate| candidate.pose).filter(|pose| {
                let support = self.filter.observation().support(seen.lines(), pose);
                support.share >= valid.share && support.weight >= valid.points
            })
        };
        let Some(pose) = best else { return };
        let mirrored = pose.mirrored();
        let nearer = known.is_some_and(|known| mirrored.distance(&known) < pose.distance(&known));
        self.place(if nearer { mirrored } else { pose }, self.settings.initial);
        self.state.standing.unconfirmed(CONFIRMATIONS);
        self.state.ambiguous = true;
    }

    /// The candidate whose lines fit best, once refined; none if another place explains the frame nearly as well.
    fn best_fit(
        &self,
        moment: &Moment,
        seen: &Seen,
        found: &[Candidate],
        effort: &mut Effort,
        may_go_on: &mut MayGoOn,
    ) -> Option<Pose2> {
        struct Fit {
            worth: f64,
            camera: DVec2,
            pose: Pose2,
        }
        let mut fits: Vec<Fit> = Vec::new();
        for (index, Candidate { pose, .. }) in found.iter().enumerate() {
            if index >= FEWEST_FITTED && !may_go_on(effort.weighed) {
                effort.capped = true;
                break;
            }
            // Every question to the clock has a number of its own.
            effort.weighed += 1;
            let Some(Refined { lines, map_from_optical, .. }) = self.refine_candidate(moment, seen, pose) else {
                continue;
            };
            // A picture without lines fits everywhere, best where none are to be seen: no reason to go there.
            if agrees(&lines) {
                let worth = lines.fitting as f64 - lines.expected as f64 * CONTRADICTED;
                fits.push(Fit { worth, camera: map_from_optical.translation.truncate(), pose: *pose });
            }
        }
        fits.sort_by(|a, b| b.worth.total_cmp(&a.worth));
        let best = fits.first()?;
        let rivals =
            |other: &Fit| other.worth > RIVALS * best.worth && other.camera.distance(best.camera) > ELSEWHERE_M;
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
