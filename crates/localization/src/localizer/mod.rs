//! From frame to frame: particles find the basin, refinement finds the pose, and both must agree with the lines before
//! a pose is believed.

mod evidence;
mod relocalization;

pub use evidence::{Evidence, TriedPose};
use nalgebra::{Matrix6, Vector6};
pub use relocalization::CandidateRefinement;
use serde::{Deserialize, Serialize};

use super::estimate::Estimate;
use super::fall_detection::{FallDetector, FallState};
use super::filter::{Effort, Filter, FilterSettings, FilterState, MayGoOn};
use super::frozen_image::FrozenImageDetector;
use super::global_search::{GlobalSearch, SearchState};
use super::last_known_pose::LastKnownPose;
use super::line_distance_map::{ExplainedLines, LineDistanceMap};
use super::observation::{Observation, Support};
use super::particles::Spread;
use super::refinement::miscalibration::Miscalibration;
use super::refinement::{self, Agreement, OF_LENS, Prior, Refined, Refiner};
use super::rejection::Rejection;
use super::slow_states::{Prediction, SlowStateFilter, SlowStateModel, Step};
use super::validation::{PoseValidator, Rules, TrackingState, Validity, agrees, is_contradicted, is_lost, stands};
use realitysim_geometry::{Field, Isometry, Lens, Physical, Pose2, Twist, wrap_angle};
use realitysim_vision::{ImageDefect, Observations};

#[derive(Clone, Debug, PartialEq)]
pub struct LocalizerSettings {
    pub filter: FilterSettings,
    pub track: SlowStateModel,
    /// Whether poses are refined; without it the best particle is the answer.
    pub refinement: bool,
    /// There is no odometry, on purpose.
    pub random_walk: bool,
    /// Around a pose that was announced or found.
    pub initial: Spread,
    pub valid: Validity,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocalizerState {
    pub filter: FilterState,
    pub track: Option<SlowStateFilter>,
    /// Time and odometry of the last frame, or of what came after it that steps count from.
    pub last: Option<(i64, Option<Pose2>)>,
    pub validator: PoseValidator,
    pub posture: FallDetector,
    pub frozen: FrozenImageDetector,
    /// For how long nothing has said how far the robot walked, seconds.
    pub adrift_s: f64,
    pub known: Option<LastKnownPose>,
    pub search: SearchState,
    pub fitting: CandidateRefinement,
    /// The pose was found without being told which half of the field it is in.
    pub ambiguous: bool,
}

impl Physical for LocalizerState {
    fn is_possible(&self) -> bool {
        let Self { filter, track, last, validator, posture: _, frozen, adrift_s, known, search, fitting, ambiguous: _ } =
            self;
        let odometry = last.and_then(|(_, odometry)| odometry);
        (filter.particles.is_possible() && track.is_possible() && odometry.is_possible())
            && (validator.is_possible() && frozen.is_possible() && adrift_s.is_possible())
            && (known.is_possible() && search.is_possible() && fitting.is_possible())
    }
}

/// What else than the image is known of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSensors {
    pub stamp_ns: i64,
    pub odometry: Option<Pose2>,
    /// Since the frame before, by gyro.
    pub turned_rad: Option<f64>,
    /// How far the torso has rolled and pitched since then, to and fro, by gyro.
    pub swayed_rad: Option<f64>,
    /// How the camera moves, if something says so.
    pub camera_twist: Option<Twist>,
    /// It turns as a gyro has told.
    pub turn_is_felt: bool,
    /// By IMU, joints and mount.
    pub footprint_from_optical: Option<Isometry>,
    /// Something measures the torso's tilt; without it a walking torso sways unseen.
    pub tilt_is_measured: bool,
    /// Between the torso's axis and the vertical, if something measures it.
    pub lean_rad: Option<f64>,
    /// What was measured is too old to describe a moving robot.
    pub stale: bool,
}

/// How a lens differs from its calibration by what has been seen, each with its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensOff {
    /// Share by which the focal length is longer.
    pub stretch: (f64, f64),
    pub centre_u_px: (f64, f64),
    pub centre_v_px: (f64, f64),
}

/// The answer for one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// Of the particles; poses of `base_footprint`.
    pub estimate: Estimate,
    pub support: Support,
    /// The refined pose, or where the track puts the camera when nothing could be refined.
    pub map_from_optical: Isometry,
    /// x, y, z, rotation about x, y, z of `map`.
    pub covariance: Matrix6<f64>,
    pub refined: bool,
    /// The lines say that the camera is not where odometry and IMU have it, by more than these admit.
    pub surprised: bool,
    /// The pose is farther from where the robot was last known to be than it can have come.
    pub strays: bool,
    /// Nothing says how far the robot has walked since the last frame.
    pub adrift: bool,
    /// Of a pose that is to be confirmed: its lines fit better through another lens, or from a camera that no mount puts there.
    pub misfits: bool,
    pub agreement: Agreement,
    pub explained: ExplainedLines,
    /// Of a pose that is to be confirmed: the share of the lines in the picture, however far, that are painted where it has them, 0 to 1.
    pub explained_in_view: f64,
    pub effort: Effort,
    /// The mirror pose is as likely.
    pub ambiguous: bool,
    /// Why the pose is not to be used; `None` when it is.
    pub rejection: Option<Rejection>,
}

/// A restarted robot may have been carried: the cloud is widened by this.
const RESTART: Spread = Spread { xy_m: 0.3, yaw_rad: 0.3 };
/// After as long as this a place that was kept over a restart is one among many, in either half of the field: in four seconds a
/// robot walks a metre, or is picked up.
const LONGEST_AWAY_S: f64 = 4.0;
/// Longer gaps say nothing more about where the robot went.
const LONGEST_STEP_S: f64 = 5.0;
/// No humanoid walks this fast: odometry that says so has jumped.
const FASTEST_M_PER_S: f64 = 3.0;
/// A torso that rolls and pitches faster than this on average walks, or marches on the spot: 5 degrees a second.
pub(super) const SWAYS_RAD_PER_S: f64 = 0.09;
/// Who walks goes on walking: for so long steps of which nothing is known add up as if they were one.
const LONGEST_ADRIFT_S: f64 = 0.5;
/// A gyro that says more is broken or counts in degrees.
const FASTEST_RAD_PER_S: f64 = 10.0;
/// How far a walking torso that nothing measures leans from upright: 2.5 degrees.
const UNMEASURED_TILT_RAD: f64 = 0.044;
/// A best particle farther than this from the predicted pose is refined from as well.
const OTHER_BASIN_M: f64 = 0.12;
const OTHER_BASIN_RAD: f64 = 0.06;
/// Track and particles that differ by more are not about the same place: the one that fits better wins.
const APART_M: f64 = 0.4;
/// A lens whose focal length is off by more was not calibrated.
const MOST_STRETCH: f64 = 0.03;
/// Squared deviation from the prediction, per unknown, above which the prediction is doubted.
const SURPRISE: f64 = 3.0;

/// Why nothing can be seen in the picture, if that is plain.
fn defect(seen: &Observations) -> Option<Rejection> {
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

#[derive(Clone, Debug)]
pub struct Localizer {
    field: Field,
    refiner: Refiner,
    painted: LineDistanceMap,
    filter: Filter,
    search: GlobalSearch,
    settings: LocalizerSettings,
    state: LocalizerState,
    /// How often the state was no state of a robot, and was begun anew.
    begun_anew: u64,
}

impl Localizer {
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
            painted: LineDistanceMap::new(&field),
            field,
            filter,
            search,
            settings,
            state,
            begun_anew: 0,
        }
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> LocalizerState {
        LocalizerState { filter: self.filter.state().clone(), ..self.state.clone() }
    }

    pub fn settings(&self) -> &LocalizerSettings {
        &self.settings
    }

    pub fn observation(&self) -> &Observation {
        self.filter.observation()
    }

    /// Weights of particles so far that were NaN or +inf: whoever sees any has found a fault.
    pub fn unusable_weights(&self) -> u64 {
        self.filter.unusable_weights()
    }

    /// Frames so far after which everything was forgotten, since numbers had become none.
    pub fn begun_anew(&self) -> u64 {
        self.begun_anew
    }

    /// How the lens differs from its calibration.
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

    /// After a restart: the pose is kept, but the robot may have been carried, and odometry counts anew.
    pub fn resume(&mut self) {
        if self.state.validator.tracking != TrackingState::Lost {
            self.filter.widen(RESTART);
            self.state.track =
                self.state.track.as_ref().map(|track| track.moved_to(track.pose(), RESTART.xy_m, RESTART.yaw_rad));
            self.state.validator.restored();
        }
        self.state.last = self.state.last.map(|(stamp_ns, _)| (stamp_ns, None));
    }

    /// The next step is from where odometry had the robot at that time.
    pub fn count_from(&mut self, stamp_ns: i64, odometry: Pose2) {
        let last = self.state.last.replace((stamp_ns, Some(odometry)));
        let (last_ns, heard) = last.unzip();
        if heard.flatten().is_none() && !self.state.validator.was_announced() {
            let away_s = last_ns.map_or(f64::INFINITY, |last_ns| stamp_ns.abs_diff(last_ns) as f64 * 1e-9);
            self.was_away(away_s);
        }
    }

    /// For so long nobody has counted the robot's steps.
    fn was_away(&mut self, seconds: f64) {
        if seconds > LONGEST_AWAY_S {
            self.state.validator.odometry_lost();
            self.state.ambiguous |= self.state.validator.tracking != TrackingState::Lost;
            self.state.known.iter_mut().for_each(LastKnownPose::is_past);
        } else {
            self.state.known.iter_mut().for_each(|known| known.was_away(seconds));
        }
    }

    /// Somebody says where the robot is.
    pub fn start_at(&mut self, pose: Pose2, spread: Spread) {
        self.place(pose, spread);
        self.state.known = Some(LastKnownPose::told(pose, spread.xy_m));
        self.state.validator.announced();
        self.state.ambiguous = false;
    }

    /// One frame of which something was seen. `may_go_on` says when time is up: see [`MayGoOn`].
    pub fn look(&mut self, moment: &FrameSensors, seen: &Observations, may_go_on: &mut MayGoOn) -> Fix {
        let fix = self.look_unchecked(moment, seen, may_go_on);
        self.checked(fix, moment)
    }

    /// What is not finite leaves with its frame: neither its pose nor what was remembered of it is used again.
    fn checked(&mut self, fix: Fix, moment: &FrameSensors) -> Fix {
        let is_sound = self.state.is_possible() && self.filter.state().particles.is_possible();
        if is_sound && fix.is_possible() {
            return fix;
        }
        self.begun_anew += 1;
        let mut nothing = FilterState { steps: self.filter.state().steps, ..FilterState::default() };
        self.filter.exchange(&mut nothing);
        let last = self.state.last.map(|(stamp_ns, _)| (stamp_ns, None));
        self.state = LocalizerState { last, ..LocalizerState::default() };
        let mut fix = self.predicted(moment, Estimate::unknown(), Support::default());
        fix.rejection = Some(Rejection::NumericalFault);
        fix
    }

    fn look_unchecked(&mut self, moment: &FrameSensors, seen: &Observations, may_go_on: &mut MayGoOn) -> Fix {
        if self.lies(moment) {
            return self.drift(moment, Rejection::Fallen);
        }
        if self.state.frozen.judge(moment, seen.summary.fingerprint) {
            return self.drift(moment, defect(seen).unwrap_or(Rejection::ImageFrozen));
        }
        let mut effort = Effort::default();
        let mut step = self.step_to(moment);
        let seconds = step.seconds;
        let mut walked = self.walked(&step);
        self.carry_on(&step);
        if self.must_search() && self.search(moment, seen, walked, &mut effort, may_go_on) {
            // What was found in this image is where the robot is now.
            (step, walked) = (Step::none(), Some(Pose2::default()));
        }
        let estimate = self.filter.step(walked, step.seconds, &seen.table, &mut effort, may_go_on);
        let support = self.filter.observation().support(seen.lines(), &estimate.best);
        self.predict(&step);
        let mut fix = self.refine(moment, seen, estimate, support);
        self.reconcile(seen, &fix);
        fix.effort = effort;
        if let Some(place) = &moment.footprint_from_optical {
            fix.explained = self.painted.explained(seen.lines(), place, &fix.map_from_optical);
            // Nothing else than confirming a pose asks for it.
            if matches!(self.state.validator.tracking, TrackingState::Candidate { .. }) {
                let (lens, pose) = (self.refiner.lens(), &fix.map_from_optical);
                fix.explained_in_view = self.painted.explained_in_view(seen, lens, place, pose);
            }
        }
        let at = self.state.track.as_ref().map_or(fix.estimate.best, SlowStateFilter::pose);
        fix.strays = self.state.known.is_some_and(|known| known.is_far_from(&at));
        let rules = self.settings.rules(&self.field);
        fix.rejection = self.state.validator.judge(&rules, moment, &fix, seconds);
        if matches!(fix.rejection, Some(Rejection::PoseUnknown | Rejection::FewLines | Rejection::LinesDisagree)) {
            fix.rejection = defect(seen).or(fix.rejection);
        }
        let is_in_view = self.state.validator.is_in_view(&rules, moment, &fix);
        if let Some(known) = self.state.known.as_mut().filter(|_| is_in_view || fix.rejection.is_none()) {
            self.state.ambiguous |= known.may_be_mirrored();
            fix.ambiguous = self.state.ambiguous;
            known.is_seen();
        }
        if fix.rejection.is_none() {
            self.state.known = self.state.track.as_ref().map(|track| LastKnownPose::at(track.pose()));
        }
        fix
    }

    /// One frame of which nothing could be seen: where odometry puts the robot.
    pub fn coast(&mut self, moment: &FrameSensors, reason: Rejection) -> Fix {
        let reason = if self.lies(moment) { Rejection::Fallen } else { reason };
        let fix = self.drift(moment, reason);
        self.checked(fix, moment)
    }

    /// Where odometry puts the robot at a time of which there is no frame. `None` where the place was not known, or is not
    /// any more.
    pub fn foresee(&mut self, moment: &FrameSensors, reason: Rejection) -> Option<Fix> {
        let fix = self.coast(moment, reason);
        (fix.rejection != Some(Rejection::NumericalFault)
            && self.state.validator.is_known()
            && !is_lost(&fix.covariance))
        .then_some(fix)
    }

    /// Goes on from another state, and hands out its own.
    pub fn exchange(&mut self, state: &mut LocalizerState) {
        self.filter.exchange(&mut self.state.filter);
        core::mem::swap(&mut self.state, state);
        self.filter.exchange(&mut self.state.filter);
    }

    /// On the floor, or on its way there or up again. Whoever has got up may be somewhere else.
    fn lies(&mut self, moment: &FrameSensors) -> bool {
        let stand = self.state.posture.judge(moment.stamp_ns, moment.lean_rad);
        if stand == FallState::HasRisen {
            self.state.validator.tracking = TrackingState::Lost;
        }
        let is_down = stand == FallState::Fallen;
        if is_down {
            self.state.known.iter_mut().for_each(LastKnownPose::fell);
        }
        is_down
    }

    fn drift(&mut self, moment: &FrameSensors, reason: Rejection) -> Fix {
        let step = self.step_to(moment);
        let walked = self.walked(&step);
        self.carry_on(&step);
        let estimate = self.filter.coast(walked, step.seconds);
        self.predict(&step);
        let mut fix = self.predicted(moment, estimate, Support::default());
        fix.effort.particles = self.filter.state().particles.len() as u32;
        fix.rejection = Some(reason);
        fix
    }

    /// What the sensors say of the robot's step since the last frame.
    fn step_to(&mut self, moment: &FrameSensors) -> Step {
        let odometry = moment.odometry.filter(Physical::is_possible);
        let last = self.state.last.replace((moment.stamp_ns, odometry));
        let Some((last_ns, last_odometry)) = last else {
            return Step::none();
        };
        let seconds = (moment.stamp_ns.saturating_sub(last_ns) as f64 * 1e-9).clamp(0.0, LONGEST_STEP_S);
        if self.settings.random_walk {
            return Step { odometry: None, turned_rad: None, seconds };
        }
        // Odometry that stands still to the last bit says something only if the body is known to stand still too.
        let stands = moment.swayed_rad.is_some_and(|swayed| swayed <= SWAYS_RAD_PER_S * seconds);
        let odometry = last_odometry.zip(odometry).filter(|(before, now)| before != now || stands);
        let odometry = odometry.map(|(before, now)| before.inverse().compose(&now));
        let possible = |step: &Pose2| libm::hypot(step.x, step.y) <= FASTEST_M_PER_S * seconds.max(0.1);
        let turned_rad = moment.turned_rad.filter(|turned| turned.abs() <= FASTEST_RAD_PER_S * seconds);
        Step { odometry: odometry.filter(possible), turned_rad, seconds }
    }

    /// The same for the particles, which follow no gyro of their own.
    fn walked(&self, step: &Step) -> Option<Pose2> {
        let turned = self.turned(step);
        step.odometry.map(|odometry| Pose2 { yaw: turned.unwrap_or(odometry.yaw), ..odometry })
    }

    /// By gyro.
    fn turned(&self, step: &Step) -> Option<f64> {
        step.turned_rad.and_then(|turned| Some(self.state.track.as_ref()?.turned(turned, step.seconds)))
    }

    /// Who falls or is carried turns although no odometry says so.
    fn carry_on(&mut self, step: &Step) {
        let turned = self.turned(step);
        let walked = step.odometry.unwrap_or_default();
        let walked = Pose2 { yaw: turned.unwrap_or(walked.yaw), ..walked };
        self.state.known.iter_mut().for_each(|known| known.carry_on(&walked, step.seconds, turned.is_some()));
        self.state.search.carry_on(&walked);
        self.state.fitting.carry_on(&walked);
    }

    fn predict(&mut self, step: &Step) {
        let LocalizerSettings { track: model, filter, random_walk, .. } = &self.settings;
        let before_s = self.state.adrift_s;
        let unheard = step.odometry.is_none() && !random_walk;
        self.state.adrift_s = if unheard { (before_s + step.seconds).min(LONGEST_ADRIFT_S) } else { 0.0 };
        let reach_m = filter.motion.walk_m_per_s * libm::sqrt(step.seconds * (step.seconds + 2.0 * before_s));
        let reach_rad = filter.motion.turn_rad_per_s * step.seconds;
        if let Some(track) = &mut self.state.track {
            track.predict(step, model, reach_m, reach_rad);
        }
    }

    fn place(&mut self, pose: Pose2, spread: Spread) {
        (self.state.search, self.state.fitting) = Default::default();
        self.filter.restart(pose, spread);
        let Spread { xy_m, yaw_rad } = spread;
        self.state.track = Some(match &self.state.track {
            Some(track) => track.moved_to(pose, xy_m, yaw_rad).with_lens_doubted(&self.settings.track),
            None => SlowStateFilter::around(pose, xy_m, yaw_rad, &self.settings.track),
        });
    }

    fn refine(&mut self, moment: &FrameSensors, seen: &Observations, estimate: Estimate, support: Support) -> Fix {
        let prediction = self.prediction(moment);
        let (Some(prediction), true) = (prediction, self.settings.refinement) else {
            return self.predicted(moment, estimate, support);
        };
        let track_pose = self.state.track.as_ref().map_or(estimate.best, SlowStateFilter::pose);
        let turned = wrap_angle(estimate.best.yaw - track_pose.yaw).abs();
        let is_elsewhere = estimate.best.distance(&track_pose) > OTHER_BASIN_M || turned > OTHER_BASIN_RAD;
        let other = moment.footprint_from_optical.filter(|_| is_elsewhere).map(|place| {
            let seen_from = estimate.best.to_isometry() * place;
            refinement::error_between(&prediction.prior.map_from_optical, &seen_from)
        });
        let starts = [Vector6::zeros(), other.unwrap_or_default()];
        let starts = &starts[..1 + usize::from(other.is_some())];
        let Some(mut refined) = self.refiner.refine(&seen.image, &prediction.prior, starts) else {
            return self.predicted(moment, estimate, support);
        };
        if self.state.validator.falls_short(&refined.lines)
            && let Some(nearby) = self.refiner.refine_nearby(&seen.image, &prediction.prior)
            && nearby.cost < refined.cost
        {
            refined = nearby;
        }
        let mut prediction = prediction;
        let agree = agrees(&refined.lines);
        let slips = agree && self.state.track.as_mut().is_some_and(|track| track.slips(&prediction.prior, &refined));
        let surprised = (slips || surprise(&prediction.prior, &refined.pose_moved()) > SURPRISE) && agree;
        if surprised {
            // Lines agree with each other but not with the prediction: odometry or IMU were wronger than they claim.
            if let Some(track) = &mut self.state.track {
                track.doubt(&refined.moved);
            }
            if let Some(doubted) = self.prediction(moment).map(|prediction| prediction.doubted(&refined.moved))
                && let Some(again) = self.refiner.refine(&seen.image, &doubted.prior, starts)
            {
                (prediction, refined) = (doubted, again);
            }
        }
        let agrees = agrees(&refined.lines);
        if agrees {
            self.state.validator.agreed(moment.stamp_ns);
        }
        if agrees && let Some(track) = &mut self.state.track {
            track.update(&prediction, &refined);
        }
        if !agrees && !is_contradicted(&refined.lines) {
            // Too little in view to move the pose.
            let mut fix = self.predicted(moment, estimate, support);
            fix.agreement = refined.lines;
            return fix;
        }
        let misfits = matches!(self.state.validator.tracking, TrackingState::Candidate { .. })
            && self.misfits(moment, seen, &prediction.prior, &refined);
        Fix {
            estimate,
            support,
            map_from_optical: refined.map_from_optical,
            covariance: refined.pose_covariance(),
            refined: true,
            surprised,
            strays: false,
            adrift: self.state.adrift_s > 0.0,
            misfits,
            agreement: refined.lines,
            explained: ExplainedLines::default(),
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: self.state.ambiguous,
            rejection: None,
        }
    }

    /// Whether the lines, with lens and mount let go, say that one of them is not what it is said to be: then some pose in the neighbourhood of
    /// the right one has most lines, each beside where it should be.
    fn misfits(&mut self, moment: &FrameSensors, seen: &Observations, prior: &Prior, refined: &Refined) -> bool {
        let Some(unbound) = self.refiner.refine_unbound(&seen.image, prior, refined) else { return false };
        let stretch = prior.lens.stretch + unbound.moved[OF_LENS];
        let sigma = libm::sqrt(unbound.covariance[(OF_LENS, OF_LENS)]);
        let is_better = agrees(&unbound.lines)
            && unbound.lines.share * unbound.lines.foremost >= refined.lines.share * refined.lines.foremost;
        stretch.abs() > MOST_STRETCH.max(2.0 * sigma) || (is_better && !stands(moment, &unbound.map_from_optical))
    }

    fn prediction(&self, moment: &FrameSensors) -> Option<Prediction> {
        let prediction = self.prediction_by(self.state.track.as_ref()?, moment)?;
        Some(if self.state.validator.is_tracking() { prediction } else { prediction.with_lens_known() })
    }

    fn prediction_by(&self, track: &SlowStateFilter, moment: &FrameSensors) -> Option<Prediction> {
        let mut prediction = track.prior(&moment.footprint_from_optical?, &self.model(moment));
        prediction.prior.twist = moment.camera_twist.unwrap_or_default();
        prediction.prior.turn_is_felt = moment.turn_is_felt;
        Some(prediction)
    }

    fn model(&self, moment: &FrameSensors) -> SlowStateModel {
        let model = self.settings.track;
        if moment.tilt_is_measured { model } else { SlowStateModel { tilt_noise_rad: UNMEASURED_TILT_RAD, ..model } }
    }

    /// Without refinement: the best particle's camera; or where the track puts it.
    fn predicted(&self, moment: &FrameSensors, estimate: Estimate, support: Support) -> Fix {
        let place = moment.footprint_from_optical.unwrap_or(Isometry::IDENTITY);
        let (map_from_optical, covariance) = match self.prediction(moment).filter(|_| self.settings.refinement) {
            Some(prediction) => (prediction.prior.map_from_optical, prediction.prior.pose_covariance()),
            None => (estimate.best.to_isometry() * place, estimate.pose_covariance()),
        };
        Fix {
            estimate,
            support,
            map_from_optical,
            covariance,
            refined: false,
            surprised: false,
            strays: false,
            adrift: self.state.adrift_s > 0.0,
            misfits: false,
            agreement: Agreement::default(),
            explained: ExplainedLines::default(),
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: self.state.ambiguous,
            rejection: None,
        }
    }

    /// Particles and track follow one robot: where they part, the one that the lines support less starts over around
    /// the other.
    fn reconcile(&mut self, seen: &Observations, fix: &Fix) {
        let Some(track) = self.state.track.as_ref().filter(|_| self.settings.refinement) else { return };
        let (pose, best) = (track.pose(), fix.estimate.best);
        if pose.distance(&best) < APART_M && wrap_angle(pose.yaw - best.yaw).abs() < APART_M {
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

impl Physical for Fix {
    fn is_possible(&self) -> bool {
        let Estimate { best, covariance, spread_m, spread_yaw_rad, effective_sample_size, evidence, .. } =
            &self.estimate;
        self.map_from_optical.is_possible()
            && self.covariance.iter().chain(covariance).all(|value| value.is_finite())
            && best.is_possible()
            && [spread_m, spread_yaw_rad, effective_sample_size, evidence].iter().all(|value| value.is_finite())
            && [self.agreement.rms_px, self.explained.share, self.support.share].iter().all(|value| value.is_finite())
    }
}

/// Squared deviation from the prior per unknown, in its own units: 1 is expected.
fn surprise(prior: &Prior, moved: &Vector6<f64>) -> f64 {
    prior.pose_covariance().cholesky().map_or(0.0, |factor| moved.dot(&factor.solve(moved)) / 6.0)
}
