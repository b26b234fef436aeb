//! Localization from frame to frame.
//!
//! Particles find the basin of attraction, refinement finds the pose in it, and both must agree with the lines before the pose is believed.

mod evidence;
mod frame;
mod motion;
mod refining;
mod relocalization;
mod state;

pub use evidence::{Evidence, TriedPose};
pub use frame::{Fix, FrameSensors};
pub(crate) use motion::SWAYS_RAD_PER_S;
pub use relocalization::CandidateRefinement;
pub use state::LocalizerState;

use super::estimate::Estimate;
use super::fall_detection::FallState;
use super::filter::{Effort, Filter, FilterSettings, FilterState, TimeCheck};
use super::global_search::GlobalSearch;
use super::last_known_pose::LastKnownPose;
use super::line_distance_map::LineDistanceMap;
use super::observation::{Observation, Support};
use super::particles::Spread;
use super::refinement::Refiner;
use super::refinement::miscalibration::Miscalibration;
use super::rejection::Rejection;
use super::slow_states::{SlowStateFilter, SlowStateModel, Step};
use super::validation::{Rules, TrackingState, Validity, is_contradicted, is_lost};
use realitysim_geometry::{Field, Lens, Physical, Pose2, wrap_angle};
use realitysim_vision::{ImageDefect, Observations};

/// Settings of a [`Localizer`].
#[derive(Clone, Debug, PartialEq)]
pub struct LocalizerSettings {
    /// Settings of the particle filter.
    pub filter: FilterSettings,
    /// Noise of the slow states and of the prediction that refinement starts from.
    pub track: SlowStateModel,
    /// Whether poses are refined; otherwise the best particle is the answer.
    pub refinement: bool,
    /// Whether there is no odometry, on purpose.
    pub random_walk: bool,
    /// Spread of the particles around a pose that was announced or found.
    pub initial: Spread,
    /// Limits that a pose must keep to be believed.
    pub valid: Validity,
}

/// Estimated differences of a lens from its calibration, each with its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensOff {
    /// Share by which the focal length is longer.
    pub stretch: (f64, f64),
    /// Shift of the optical centre along u, pixels.
    pub centre_u_px: (f64, f64),
    /// Shift of the optical centre along v, pixels.
    pub centre_v_px: (f64, f64),
}

/// Spread that is added to the particles at a restart, since the robot may have been carried.
const RESTART_SPREAD: Spread = Spread { xy_m: 0.3, yaw_rad: 0.3 };
/// Longest absence of odometry, seconds, after which a pose kept over a restart still counts. In four seconds a robot walks a
/// metre, or is picked up, and may then be in either half of the field.
const ABSENCE_LIMIT_S: f64 = 4.0;
/// Distance (m) and turn (rad) between track and particles above which they follow different poses: the one that fits better wins.
const APART: f64 = 0.4;

/// The rejection of a picture in which nothing can be seen for a plain reason.
fn image_rejection(seen: &Observations) -> Option<Rejection> {
    seen.summary.defect().map(|defect| match defect {
        ImageDefect::TooDark => Rejection::TooDark,
        ImageDefect::Overexposed => Rejection::Overexposed,
    })
}

impl LocalizerSettings {
    fn rules<'a>(&'a self, field: &'a Field) -> Rules<'a> {
        Rules { valid: &self.valid, field, refinement: self.refinement, random_walk: self.random_walk }
    }
}

/// Localizes one camera on one field, frame by frame.
#[derive(Clone, Debug)]
pub struct Localizer {
    field: Field,
    refiner: Refiner,
    line_distances: LineDistanceMap,
    filter: Filter,
    search: GlobalSearch,
    settings: LocalizerSettings,
    /// The state without that of the filter, which `filter` holds.
    state: LocalizerState,
    /// Number of times that the state was not finite and was reset.
    begun_anew: u64,
}

impl Localizer {
    /// Makes a localizer that goes on from `state`.
    pub fn new(
        settings: LocalizerSettings,
        field: Field,
        lens: &Lens,
        observation: Observation,
        state: LocalizerState,
    ) -> Self {
        let search = GlobalSearch::new(&field, relocalization::SEARCH_MARGIN_M, &observation);
        let filter = Filter::new(settings.filter.clone(), observation, state.filter.clone());
        Self {
            refiner: Refiner::new(&field, lens),
            line_distances: LineDistanceMap::new(&field),
            field,
            filter,
            search,
            settings,
            state,
            begun_anew: 0,
        }
    }

    /// The state after the last frame, which a checkpoint keeps.
    pub fn state(&self) -> LocalizerState {
        LocalizerState { filter: self.filter.state().clone(), ..self.state.clone() }
    }

    /// The settings that the localizer was made with.
    pub fn settings(&self) -> &LocalizerSettings {
        &self.settings
    }

    /// The observation model that weighs particles.
    pub fn observation(&self) -> &Observation {
        self.filter.observation()
    }

    /// Number of weights of particles so far that were NaN or +inf. Any other number than 0 shows a fault of the program.
    pub fn unusable_weights(&self) -> u64 {
        self.filter.unusable_weights()
    }

    /// Number of frames so far after which the state was reset, since a number was not finite.
    pub fn begun_anew(&self) -> u64 {
        self.begun_anew
    }

    /// Estimated differences of the lens from its calibration; `None` before the first pose.
    pub fn lens_off(&self) -> Option<LensOff> {
        let track = self.state.track.as_ref()?;
        let (Miscalibration { stretch, shift, .. }, [of_stretch, of_u, of_v, _]) = (track.lens(), track.lens_sigmas());
        let width_px = f64::from(self.refiner.lens().width());
        Some(LensOff {
            stretch: (stretch, of_stretch),
            centre_u_px: (shift.x * width_px, of_u * width_px),
            centre_v_px: (shift.y * width_px, of_v * width_px),
        })
    }

    /// Resumes after a restart: the pose is kept, but the robot may have been carried, and odometry begins anew.
    pub fn resume(&mut self) {
        if self.state.validator.tracking != TrackingState::Lost {
            self.filter.widen(RESTART_SPREAD);
            self.state.track = self
                .state
                .track
                .as_ref()
                .map(|track| track.moved_to(track.pose(), RESTART_SPREAD.xy_m, RESTART_SPREAD.yaw_rad));
            self.state.validator.start_restored();
        }
        self.state.last = self.state.last.map(|(stamp_ns, _)| (stamp_ns, None));
    }

    /// Sets time and odometry that the next step is measured from.
    pub fn count_from(&mut self, stamp_ns: i64, odometry: Pose2) {
        let last = self.state.last.replace((stamp_ns, Some(odometry)));
        let (last_ns, heard) = last.unzip();
        if heard.flatten().is_none() && !self.state.validator.was_announced() {
            let away_s = last_ns.map_or(f64::INFINITY, |last_ns| stamp_ns.abs_diff(last_ns) as f64 * 1e-9);
            self.note_absence(away_s);
        }
    }

    /// Notes that no odometry was heard for so many seconds.
    fn note_absence(&mut self, seconds: f64) {
        if seconds > ABSENCE_LIMIT_S {
            self.state.validator.drop_restored();
            self.state.ambiguous |= self.state.validator.tracking != TrackingState::Lost;
            self.state.known.iter_mut().for_each(LastKnownPose::expire);
        } else {
            self.state.known.iter_mut().for_each(|known| known.note_absence(seconds));
        }
    }

    /// Starts over at a pose of `base_footprint` in `map` that somebody has announced.
    pub fn start_at(&mut self, pose: Pose2, spread: Spread) {
        self.restart_at(pose, spread);
        self.state.known = Some(LastKnownPose::announced(pose, spread.xy_m));
        self.state.validator.start_announced();
        self.state.ambiguous = false;
    }

    /// Localizes one frame whose image was looked at. `has_time` decides when time is up: see [`TimeCheck`].
    pub fn look(&mut self, moment: &FrameSensors, seen: &Observations, has_time: &mut TimeCheck) -> Fix {
        let fix = self.look_unchecked(moment, seen, has_time);
        self.reset_unless_finite(fix, moment)
    }

    /// Resets the state and rejects the frame if a number of either is not finite, so that it is not used again.
    fn reset_unless_finite(&mut self, fix: Fix, moment: &FrameSensors) -> Fix {
        let is_sound = self.state.is_possible() && self.filter.state().particles.is_possible();
        if is_sound && fix.is_possible() {
            return fix;
        }
        self.begun_anew += 1;
        let mut nothing = FilterState { steps: self.filter.state().steps, ..FilterState::default() };
        self.filter.exchange(&mut nothing);
        let last = self.state.last.map(|(stamp_ns, _)| (stamp_ns, None));
        self.state = LocalizerState { last, ..LocalizerState::default() };
        let mut fix = self.predicted_fix(moment, Estimate::unknown(), Support::default());
        fix.rejection = Some(Rejection::NumericalFault);
        fix
    }

    /// [`Self::look`] without the check for numbers that are not finite.
    fn look_unchecked(&mut self, moment: &FrameSensors, seen: &Observations, has_time: &mut TimeCheck) -> Fix {
        if self.detect_fall(moment) {
            return self.dead_reckon(moment, Rejection::Fallen);
        }
        if self.state.frozen.detect_freeze(moment, seen.summary.fingerprint) {
            return self.dead_reckon(moment, image_rejection(seen).unwrap_or(Rejection::ImageFrozen));
        }
        let mut effort = Effort::default();
        let mut step = self.measure_step(moment);
        let seconds = step.seconds;
        let mut walked = self.particle_step(&step);
        self.move_hypotheses(&step);
        if self.must_search() && self.search(moment, seen, walked, &mut effort, has_time) {
            // The pose was found in this image, so it needs no step.
            (step, walked) = (Step::none(), Some(Pose2::default()));
        }
        let estimate = self.filter.step(walked, step.seconds, &seen.table, &mut effort, has_time);
        let support = self.filter.observation().support(seen.lines(), &estimate.best);
        self.predict_track(&step);
        let mut fix = self.refine(moment, seen, estimate, support);
        self.reconcile(seen, &fix);
        fix.effort = effort;
        if let Some(place) = &moment.footprint_from_optical {
            fix.explained = self.line_distances.explained(seen.lines(), place, &fix.map_from_optical);
            // Only the confirmation of a candidate needs it.
            if matches!(self.state.validator.tracking, TrackingState::Candidate { .. }) {
                let (lens, pose) = (self.refiner.lens(), &fix.map_from_optical);
                fix.explained_in_view = self.line_distances.explained_in_view(seen, lens, place, pose);
            }
        }
        let at = self.state.track.as_ref().map_or(fix.estimate.best, SlowStateFilter::pose);
        fix.strays = self.state.known.is_some_and(|known| known.is_far_from(&at));
        let rules = self.settings.rules(&self.field);
        fix.rejection = self.state.validator.judge(&rules, moment, &fix, seconds);
        if matches!(fix.rejection, Some(Rejection::PoseUnknown | Rejection::FewLines | Rejection::LinesDisagree)) {
            fix.rejection = image_rejection(seen).or(fix.rejection);
        }
        let is_in_view = self.state.validator.is_in_view(&rules, moment, &fix);
        if let Some(known) = self.state.known.as_mut().filter(|_| is_in_view || fix.rejection.is_none()) {
            self.state.ambiguous |= known.may_be_mirrored();
            fix.ambiguous = self.state.ambiguous;
            known.confirm_by_lines();
        }
        if fix.rejection.is_none() {
            self.state.known = self.state.track.as_ref().map(|track| LastKnownPose::at(track.pose()));
        }
        fix
    }

    /// Localizes one frame in which nothing could be seen: by odometry alone. The frame is rejected for `reason`, or for a fall.
    pub fn coast(&mut self, moment: &FrameSensors, reason: Rejection) -> Fix {
        let reason = if self.detect_fall(moment) { Rejection::Fallen } else { reason };
        let fix = self.dead_reckon(moment, reason);
        self.reset_unless_finite(fix, moment)
    }

    /// Where odometry puts the robot at a time without a frame. `None` if the pose was not known, or has become too uncertain.
    pub fn predict_ahead(&mut self, moment: &FrameSensors, reason: Rejection) -> Option<Fix> {
        let fix = self.coast(moment, reason);
        (fix.rejection != Some(Rejection::NumericalFault)
            && self.state.validator.is_known()
            && !is_lost(&fix.covariance))
        .then_some(fix)
    }

    /// Swaps the localizer's state with `state`.
    pub fn exchange(&mut self, state: &mut LocalizerState) {
        self.filter.exchange(&mut self.state.filter);
        core::mem::swap(&mut self.state, state);
        self.filter.exchange(&mut self.state.filter);
    }

    /// Whether the robot is falling, lies on the floor or is getting up. After that its pose counts as lost, since it may have moved.
    fn detect_fall(&mut self, moment: &FrameSensors) -> bool {
        let stand = self.state.posture.update(moment.stamp_ns, moment.lean_rad);
        if stand == FallState::HasRisen {
            self.state.validator.tracking = TrackingState::Lost;
        }
        let is_down = stand == FallState::Fallen;
        if is_down {
            self.state.known.iter_mut().for_each(LastKnownPose::note_fall);
        }
        is_down
    }

    /// Carries the pose on by odometry and gyro alone.
    fn dead_reckon(&mut self, moment: &FrameSensors, reason: Rejection) -> Fix {
        let step = self.measure_step(moment);
        let walked = self.particle_step(&step);
        self.move_hypotheses(&step);
        let estimate = self.filter.coast(walked, step.seconds);
        self.predict_track(&step);
        let mut fix = self.predicted_fix(moment, estimate, Support::default());
        fix.effort.particles = self.filter.state().particles.len() as u32;
        fix.rejection = Some(reason);
        fix
    }

    /// Starts particles and track over around a pose.
    fn restart_at(&mut self, pose: Pose2, spread: Spread) {
        (self.state.search, self.state.fitting) = Default::default();
        self.filter.restart(pose, spread);
        let Spread { xy_m, yaw_rad } = spread;
        self.state.track = Some(match &self.state.track {
            Some(track) => track.moved_to(pose, xy_m, yaw_rad).with_lens_doubted(&self.settings.track),
            None => SlowStateFilter::around(pose, xy_m, yaw_rad, &self.settings.track),
        });
    }

    /// Brings particles and track together: if they follow different poses, the one that lines support less starts over at the other.
    fn reconcile(&mut self, seen: &Observations, fix: &Fix) {
        let Some(track) = self.state.track.as_ref().filter(|_| self.settings.refinement) else { return };
        let (pose, best) = (track.pose(), fix.estimate.best);
        if pose.distance(&best) < APART && wrap_angle(pose.yaw - best.yaw).abs() < APART {
            return;
        }
        let own = self.filter.observation().support(seen.lines(), &pose);
        let spread = self.settings.initial;
        if own.share * own.weight >= fix.support.share * fix.support.weight {
            let (xy_m, yaw_rad) = track.spread();
            let spread = Spread { xy_m: xy_m.max(spread.xy_m / 2.0), yaw_rad: yaw_rad.max(spread.yaw_rad / 2.0) };
            self.filter.restart(pose, spread);
        } else if !fix.refined || is_contradicted(&fix.agreement) {
            self.state.track = Some(track.moved_to(best, spread.xy_m, spread.yaw_rad));
        }
    }
}
