//! Localization from frame to frame.
//!
//! Particles find the basin of attraction, refinement finds the pose in it, and both must agree with the lines before the pose is believed.

mod evidence;
mod relocalization;

pub use evidence::{Evidence, TriedPose};
use nalgebra::{Matrix6, Vector6};
pub use relocalization::CandidateRefinement;
use serde::{Deserialize, Serialize};

use super::estimate::Estimate;
use super::fall_detection::{FallDetector, FallState};
use super::filter::{Effort, Filter, FilterSettings, FilterState, TimeCheck};
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

/// Everything that the next frame depends on; a checkpoint keeps it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocalizerState {
    /// State of the particle filter.
    pub filter: FilterState,
    /// Pose and slow states that refinement follows, called the track; `None` before the first pose.
    pub track: Option<SlowStateFilter>,
    /// Time (ns) and odometry that the next step is measured from: those of the last frame, or later ones.
    pub last: Option<(i64, Option<Pose2>)>,
    /// What the frames so far say about the pose.
    pub validator: PoseValidator,
    /// Follows the robot through falls.
    pub posture: FallDetector,
    /// Recognises a camera that repeats its picture.
    pub frozen: FrozenImageDetector,
    /// Time for which nothing has measured how far the robot walked, seconds.
    pub odometry_gap_s: f64,
    /// The last pose that was known, carried on since then.
    pub known: Option<LastKnownPose>,
    /// Search of the field under way.
    pub search: SearchState,
    /// Candidates of the last search that are being refined.
    pub fitting: CandidateRefinement,
    /// Whether the mirror pose is as likely: the pose was found without knowing which half of the field the robot is in.
    pub ambiguous: bool,
}

impl Physical for LocalizerState {
    fn is_possible(&self) -> bool {
        let Self {
            filter,
            track,
            last,
            validator,
            posture: _,
            frozen,
            odometry_gap_s,
            known,
            search,
            fitting,
            ambiguous: _,
        } = self;
        let odometry = last.and_then(|(_, odometry)| odometry);
        (filter.particles.is_possible() && track.is_possible() && odometry.is_possible())
            && (validator.is_possible() && frozen.is_possible() && odometry_gap_s.is_possible())
            && (known.is_possible() && search.is_possible() && fitting.is_possible())
    }
}

/// What sensors other than the camera say at the time of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameSensors {
    /// Time of the frame, nanoseconds.
    pub stamp_ns: i64,
    /// Pose of `base_footprint` by odometry, if known.
    pub odometry: Option<Pose2>,
    /// Turn of the robot since the last frame by gyro, radians.
    pub turned_rad: Option<f64>,
    /// Sum of the torso's roll and pitch, to and fro, since the last frame by gyro, radians.
    pub swayed_rad: Option<f64>,
    /// Motion of the camera, if something measures it.
    pub camera_twist: Option<Twist>,
    /// Whether a gyro has measured the rotation in `camera_twist`.
    pub turn_is_measured: bool,
    /// Pose of the camera in `base_footprint`, by IMU, joints and mount.
    pub footprint_from_optical: Option<Isometry>,
    /// Whether the torso's tilt is measured; otherwise a walking torso sways unseen.
    pub tilt_is_measured: bool,
    /// Angle between the torso's axis and the vertical, if measured, radians.
    pub lean_rad: Option<f64>,
    /// Whether a measurement is too old to describe a moving robot.
    pub stale: bool,
    /// Standard deviation of the times of odometry and gyro, seconds, beyond what the motion model allows for; 0 if they are stamped
    /// by the sensor. A robot that moves is elsewhere at another time.
    pub stamp_sigma_s: f64,
    /// Standard deviation of the torso's roll and pitch in this frame, radians, beyond what the motion model allows for; 0 if the
    /// sensor states and stamps its attitude.
    pub tilt_sigma_rad: f64,
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

/// The answer for one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Fix {
    /// Estimate of the particles: `base_footprint` in `map`.
    pub estimate: Estimate,
    /// How much of the line that the best particle predicts is seen.
    pub support: Support,
    /// Pose of the camera: refined, or predicted when nothing could be refined.
    pub map_from_optical: Isometry,
    /// Covariance of that pose: x, y, z (m) and rotation about x, y, z (rad) of `map`.
    pub covariance: Matrix6<f64>,
    /// Whether the pose was refined by lines of this frame.
    pub refined: bool,
    /// Whether lines put the camera farther from where odometry and IMU have it than their errors admit.
    pub contradicts_prediction: bool,
    /// Whether the pose is farther from where the robot was last known to be than it can have come.
    pub strays: bool,
    /// Whether nothing has measured how far the robot walked since the last frame.
    pub lacks_odometry: bool,
    /// Whether the lines of a candidate fit better through another lens, or from a camera where no mount puts it.
    pub misfits: bool,
    /// How well the expected lines are where the pose has them.
    pub agreement: Agreement,
    /// How much of the seen line near the robot the pose explains.
    pub explained: ExplainedLines,
    /// Share of the lines in the picture, at any distance, that are painted where a candidate has them, 0 to 1; 1 if not computed.
    pub explained_in_view: f64,
    /// What the frame has cost.
    pub effort: Effort,
    /// Whether the mirror pose is as likely.
    pub ambiguous: bool,
    /// Why the pose is not to be used; `None` when it is.
    pub rejection: Option<Rejection>,
}

/// Spread that is added to the particles at a restart, since the robot may have been carried.
const RESTART_SPREAD: Spread = Spread { xy_m: 0.3, yaw_rad: 0.3 };
/// Longest absence of odometry, seconds, after which a pose kept over a restart still counts. In four seconds a robot walks a
/// metre, or is picked up, and may then be in either half of the field.
const ABSENCE_LIMIT_S: f64 = 4.0;
/// Longest step between frames, seconds: a longer gap says nothing more about where the robot went.
const MAX_STEP_S: f64 = 5.0;
/// Highest speed, metres per second: no humanoid walks this fast, so odometry that says so has jumped.
const SPEED_LIMIT_M_PER_S: f64 = 3.0;
/// A torso that rolls and pitches faster than this on average walks, or marches on the spot: 5 degrees a second.
pub(super) const SWAYS_RAD_PER_S: f64 = 0.09;
/// Longest time without odometry, seconds, for which unknown steps add up in one direction: a walking robot goes on walking.
const ODOMETRY_GAP_LIMIT_S: f64 = 0.5;
/// Highest turning rate, radians per second: a gyro that shows more is broken or counts in degrees.
const TURN_RATE_LIMIT_RAD_PER_S: f64 = 10.0;
/// Standard deviation of a walking torso's tilt where nothing measures it: 2.5 degrees.
const UNMEASURED_TILT_RAD: f64 = 0.044;
/// Distance of the best particle from the predicted pose above which refinement starts from both, metres.
const OTHER_BASIN_M: f64 = 0.12;
/// The same for the heading, radians.
const OTHER_BASIN_RAD: f64 = 0.06;
/// Distance (m) and turn (rad) between track and particles above which they follow different poses: the one that fits better wins.
const APART: f64 = 0.4;
/// Largest deviation of the focal length, as a share, of a lens that was calibrated.
const STRETCH_LIMIT: f64 = 0.03;
/// Squared deviation from the prediction, per unknown, above which the prediction is doubted.
const INNOVATION_THRESHOLD: f64 = 3.0;

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

    /// The robot's step since the last frame, as far as sensors can be trusted. The next step is measured from this frame.
    fn measure_step(&mut self, moment: &FrameSensors) -> Step {
        let odometry = moment.odometry.filter(Physical::is_possible);
        let last = self.state.last.replace((moment.stamp_ns, odometry));
        let Some((last_ns, last_odometry)) = last else {
            return Step::none();
        };
        let seconds = (moment.stamp_ns.saturating_sub(last_ns) as f64 * 1e-9).clamp(0.0, MAX_STEP_S);
        if self.settings.random_walk {
            return Step { odometry: None, turned_rad: None, seconds, stamp_sigma_s: 0.0 };
        }
        // Odometry that is the same to the last bit counts only if the torso is known to stand still too.
        let stands = moment.swayed_rad.is_some_and(|swayed| swayed <= SWAYS_RAD_PER_S * seconds);
        let odometry = last_odometry.zip(odometry).filter(|(before, now)| before != now || stands);
        let odometry = odometry.map(|(before, now)| before.inverse().compose(&now));
        let possible = |step: &Pose2| libm::hypot(step.x, step.y) <= SPEED_LIMIT_M_PER_S * seconds.max(0.1);
        let turned_rad = moment.turned_rad.filter(|turned| turned.abs() <= TURN_RATE_LIMIT_RAD_PER_S * seconds);
        Step { odometry: odometry.filter(possible), turned_rad, seconds, stamp_sigma_s: moment.stamp_sigma_s }
    }

    /// The step for the particles: odometry, whose turn is replaced by that of the gyro if there is one.
    fn particle_step(&self, step: &Step) -> Option<Pose2> {
        let turned = self.gyro_turn(step);
        step.odometry.map(|odometry| Pose2 { yaw: turned.unwrap_or(odometry.yaw), ..odometry })
    }

    /// The robot's turn by gyro, corrected for its bias, radians.
    fn gyro_turn(&self, step: &Step) -> Option<f64> {
        step.turned_rad.and_then(|turned| Some(self.state.track.as_ref()?.turned(turned, step.seconds)))
    }

    /// Moves the last known pose and the search's candidates by the step. Without odometry they turn by gyro: a robot that falls or is
    /// carried turns although odometry does not show it.
    fn move_hypotheses(&mut self, step: &Step) {
        let turned = self.gyro_turn(step);
        let walked = step.odometry.unwrap_or_default();
        let walked = Pose2 { yaw: turned.unwrap_or(walked.yaw), ..walked };
        self.state.known.iter_mut().for_each(|known| known.move_by(&walked, step.seconds, turned.is_some()));
        self.state.search.move_by(&walked);
        self.state.fitting.move_by(&walked);
    }

    /// Predicts the track. Where odometry is missing, its uncertainty grows by how far the robot can walk.
    fn predict_track(&mut self, step: &Step) {
        let LocalizerSettings { track: model, filter, random_walk, .. } = &self.settings;
        let before_s = self.state.odometry_gap_s;
        let unheard = step.odometry.is_none() && !random_walk;
        self.state.odometry_gap_s = if unheard { (before_s + step.seconds).min(ODOMETRY_GAP_LIMIT_S) } else { 0.0 };
        let reach_m = filter.motion.walk_m_per_s * libm::sqrt(step.seconds * (step.seconds + 2.0 * before_s));
        let reach_rad = filter.motion.turn_rad_per_s * step.seconds;
        if let Some(track) = &mut self.state.track {
            track.predict(step, model, reach_m, reach_rad);
        }
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

    /// Refines the predicted pose by the lines of the frame, and updates the track with the result.
    fn refine(&mut self, moment: &FrameSensors, seen: &Observations, estimate: Estimate, support: Support) -> Fix {
        let prediction = self.prediction(moment);
        let (Some(prediction), true) = (prediction, self.settings.refinement) else {
            return self.predicted_fix(moment, estimate, support);
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
            return self.predicted_fix(moment, estimate, support);
        };
        if self.state.validator.has_lost_lines(&refined.lines)
            && let Some(nearby) = self.refiner.refine_nearby(&seen.image, &prediction.prior)
            && nearby.cost < refined.cost
        {
            refined = nearby;
        }
        let mut prediction = prediction;
        let agree = agrees(&refined.lines);
        let slips = agree && self.state.track.as_mut().is_some_and(|track| track.slips(&prediction.prior, &refined));
        let contradicts_prediction = (slips
            || normalized_innovation_squared(&prediction.prior, &refined.pose_moved()) > INNOVATION_THRESHOLD)
            && agree;
        if contradicts_prediction {
            // Lines agree with each other but not with the prediction: errors of odometry or IMU are larger than assumed.
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
            self.state.validator.note_agreement(moment.stamp_ns);
        }
        if agrees && let Some(track) = &mut self.state.track {
            track.update(&prediction, &refined);
        }
        if !agrees && !is_contradicted(&refined.lines) {
            // Too little is in view to correct the pose.
            let mut fix = self.predicted_fix(moment, estimate, support);
            fix.agreement = refined.lines;
            return fix;
        }
        let misfits = matches!(self.state.validator.tracking, TrackingState::Candidate { .. })
            && self.fits_better_unbound(moment, seen, &prediction.prior, &refined);
        Fix {
            estimate,
            support,
            map_from_optical: refined.map_from_optical,
            covariance: refined.pose_covariance(),
            refined: true,
            contradicts_prediction,
            strays: false,
            lacks_odometry: self.state.odometry_gap_s > 0.0,
            misfits,
            agreement: refined.lines,
            explained: ExplainedLines::default(),
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: self.state.ambiguous,
            rejection: None,
        }
    }

    /// Whether a refinement that leaves lens and mount free contradicts one of them.
    ///
    /// If one is not what it is said to be, some pose in the neighbourhood of the right one has most lines, each beside where it should be.
    fn fits_better_unbound(
        &mut self,
        moment: &FrameSensors,
        seen: &Observations,
        prior: &Prior,
        refined: &Refined,
    ) -> bool {
        let Some(unbound) = self.refiner.refine_unbound(&seen.image, prior, refined) else { return false };
        let stretch = prior.lens.stretch + unbound.moved[OF_LENS];
        let sigma = libm::sqrt(unbound.covariance[(OF_LENS, OF_LENS)]);
        let is_better = agrees(&unbound.lines)
            && unbound.lines.share * unbound.lines.foremost >= refined.lines.share * refined.lines.foremost;
        stretch.abs() > STRETCH_LIMIT.max(2.0 * sigma) || (is_better && !stands(moment, &unbound.map_from_optical))
    }

    /// The prediction of the camera's pose by the track; the lens counts as known until the pose is confirmed.
    fn prediction(&self, moment: &FrameSensors) -> Option<Prediction> {
        let prediction = self.prediction_of(self.state.track.as_ref()?, moment)?;
        Some(if self.state.validator.is_tracking() { prediction } else { prediction.with_lens_known() })
    }

    /// The prediction of the camera's pose by a given track.
    fn prediction_of(&self, track: &SlowStateFilter, moment: &FrameSensors) -> Option<Prediction> {
        let mut prediction = track.prior(&moment.footprint_from_optical?, &self.model(moment));
        prediction.prior.twist = moment.camera_twist.unwrap_or_default();
        prediction.prior.turn_is_measured = moment.turn_is_measured;
        Some(prediction)
    }

    /// The noise of the slow states for this frame.
    fn model(&self, moment: &FrameSensors) -> SlowStateModel {
        let model = self.settings.track;
        if !moment.tilt_is_measured {
            return SlowStateModel { tilt_noise_rad: UNMEASURED_TILT_RAD, ..model };
        }
        if moment.tilt_sigma_rad == 0.0 {
            return model;
        }
        // A tilt that is measured badly is never worth less than one that is not measured.
        let tilt_noise_rad = libm::hypot(model.tilt_noise_rad, moment.tilt_sigma_rad).min(UNMEASURED_TILT_RAD);
        SlowStateModel { tilt_noise_rad, ..model }
    }

    /// The answer without refinement by lines: the track's prediction, or the camera of the best particle if poses are not refined.
    fn predicted_fix(&self, moment: &FrameSensors, estimate: Estimate, support: Support) -> Fix {
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
            contradicts_prediction: false,
            strays: false,
            lacks_odometry: self.state.odometry_gap_s > 0.0,
            misfits: false,
            agreement: Agreement::default(),
            explained: ExplainedLines::default(),
            explained_in_view: 1.0,
            effort: Effort::default(),
            ambiguous: self.state.ambiguous,
            rejection: None,
        }
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

/// Squared Mahalanobis distance of a correction from the prior, per unknown: 1 is expected.
fn normalized_innovation_squared(prior: &Prior, moved: &Vector6<f64>) -> f64 {
    prior.pose_covariance().cholesky().map_or(0.0, |factor| moved.dot(&factor.solve(moved)) / 6.0)
}
