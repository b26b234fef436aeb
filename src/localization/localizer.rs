//! From frame to frame: particles find the basin, refinement finds the pose, and both must agree with the lines before
//! a pose is believed.

use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

use super::estimate::Estimate;
use super::filter::{Filter, FilterSettings, FilterState};
use super::global;
use super::observation::{Observation, Support};
use super::particles::Spread;
use super::refinement::{self, Agreement, LinePoints, Prior, Refined};
use super::track::{Prediction, Track, TrackModel};
use crate::geometry::{Field, Isometry, Lens, Pose2, Projector, wrap_angle};
use crate::vision::Seen;

#[derive(Clone, Debug, PartialEq)]
pub struct LocalizerSettings {
    pub filter: FilterSettings,
    pub track: TrackModel,
    /// Whether poses are refined; without it the best particle is the answer.
    pub refinement: bool,
    /// There is no odometry, on purpose.
    pub random_walk: bool,
    /// Around a pose that was announced or found.
    pub initial: Spread,
    pub valid: Validity,
}

/// What a pose needs to be believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Validity {
    /// Share of the expected line contrast (particles) or of the expected line places (refinement) that is there.
    pub share: f64,
    /// Painted line in view in units of 10 cm, counted by its certainty.
    pub points: f64,
    /// Standard deviation of the position along its longer axis: of the particles, and of the refined pose.
    pub spread_m: f64,
    pub refined_m: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocalizerState {
    pub filter: FilterState,
    pub track: Option<Track>,
    /// Time and odometry of the last frame.
    pub last: Option<(i64, Option<Pose2>)>,
    pub confidence: Confidence,
    /// When lines last agreed with the pose.
    pub agreed_ns: Option<i64>,
    /// The pose was found without being told which half of the field it is in.
    pub ambiguous: bool,
}

/// How far the lines have confirmed the pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Confidence {
    /// Not known where the robot is: the whole field is searched.
    #[default]
    Nowhere,
    /// A pose that still needs this many frames with good lines.
    Unconfirmed(u32),
    /// Confirmed; frames in a row whose lines contradicted it.
    Tracking(u32),
}

/// What else than the image is known of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    pub stamp_ns: i64,
    pub odometry: Option<Pose2>,
    /// By IMU, joints and mount.
    pub footprint_from_optical: Option<Isometry>,
    /// Something measures the torso's tilt; without it a walking torso sways unseen.
    pub tilt_is_measured: bool,
    /// What was measured is too old to describe a moving robot.
    pub stale: bool,
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
    pub agreement: Agreement,
    /// The mirror pose is as likely.
    pub ambiguous: bool,
    /// Why the pose is not to be used; `None` when it is.
    pub doubt: Option<&'static str>,
}

/// Frames with good lines that a pose found by search or kept over a restart needs.
const CONFIRMATIONS: u32 = 3;
/// Frames in a row whose lines contradict the pose, after which the field is searched: 0.3 s at 10 Hz.
const LOST_AFTER: u32 = 3;
/// While lost, only every so many frames pay for a search.
const SEARCH_EVERY: u64 = 3;
/// A pose a little off the carpet is possible.
const SEARCH_MARGIN_M: f64 = 0.3;
const CANDIDATES: usize = 4;
/// A pose as uncertain as this along its longer axis is none.
const LOST_M: f64 = 0.6;
/// A restarted robot may have been carried: the cloud is widened by this.
const RESTART: Spread = Spread { xy_m: 0.3, yaw_rad: 0.3 };
/// Longer gaps say nothing more about where the robot went.
const LONGEST_STEP_S: f64 = 5.0;
/// No humanoid walks this fast: odometry that says so has jumped.
const FASTEST_M_PER_S: f64 = 3.0;
/// How far a walking torso that nothing measures leans from upright: 2.5 degrees.
const UNMEASURED_TILT_RAD: f64 = 0.044;
/// A best particle farther than this from the predicted pose is refined from as well.
const OTHER_BASIN_M: f64 = 0.12;
const OTHER_BASIN_RAD: f64 = 0.06;
/// Track and particles that differ by more are not about the same place: the one that fits better wins.
const APART_M: f64 = 0.4;
/// Squared deviation from the prediction, per unknown, above which the prediction is doubted.
const SURPRISE: f64 = 3.0;
/// Fewer line places than this say nothing for or against a pose.
const FEWEST_EXPECTED: usize = 12;
const FEWEST_FITTING: usize = 10;
/// What a frame needs to confirm a pose that was found by search or announced.
const FITTING_TO_CONFIRM: usize = 20;
const SHARE_TO_CONFIRM: f64 = 0.7;
/// A pose is believed for so long without lines that agree.
const LONGEST_COAST_NS: i64 = 700_000_000;
/// With less than this share of fitting places the lines contradict the pose.
const CONTRADICTED: f64 = 0.5;

#[derive(Clone, Debug)]
pub struct Localizer {
    field: Field,
    projector: Projector,
    points: LinePoints,
    filter: Filter,
    settings: LocalizerSettings,
    state: LocalizerState,
}

impl Localizer {
    pub fn new(
        settings: LocalizerSettings,
        field: Field,
        lens: &Lens,
        observation: Observation,
        state: LocalizerState,
    ) -> Self {
        let filter = Filter::new(settings.filter.clone(), observation, state.filter.clone());
        Self { points: LinePoints::new(&field), projector: Projector::new(lens), field, filter, settings, state }
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

    /// After a restart: the pose is kept, but the robot may have been carried, and odometry counts anew.
    pub fn resume(&mut self) {
        if self.state.confidence != Confidence::Nowhere {
            self.filter.widen(RESTART);
            self.state.track =
                self.state.track.as_ref().map(|track| track.moved_to(track.pose(), RESTART.xy_m, RESTART.yaw_rad));
            self.state.confidence = Confidence::Unconfirmed(CONFIRMATIONS);
        }
        self.state.last = None;
    }

    /// Somebody says where the robot is.
    pub fn start_at(&mut self, pose: Pose2, spread: Spread) {
        self.place(pose, spread);
        self.state.confidence = Confidence::Unconfirmed(1);
        self.state.ambiguous = false;
    }

    /// One frame of which something was seen.
    pub fn look(&mut self, moment: &Moment, seen: &Seen) -> Fix {
        let (step, seconds) = self.step_to(moment);
        if self.must_search() {
            self.search(moment, seen);
        }
        let estimate = self.filter.step(step, seconds, &seen.table);
        let support = self.filter.observation().support(seen.lines(), &estimate.best);
        self.predict(step, seconds);
        let fix = self.refine(moment, seen, estimate, support);
        self.reconcile(seen, &fix);
        self.judge(moment, fix)
    }

    /// One frame of which nothing could be seen: where odometry puts the robot.
    pub fn coast(&mut self, moment: &Moment, reason: &'static str) -> Fix {
        let (step, seconds) = self.step_to(moment);
        let estimate = self.filter.coast(step, seconds);
        self.predict(step, seconds);
        let mut fix = self.predicted(moment, estimate, Support::default());
        fix.doubt = Some(reason);
        fix
    }

    /// The robot's step since the last frame by odometry, and how long it took.
    fn step_to(&mut self, moment: &Moment) -> (Option<Pose2>, f64) {
        let odometry = moment.odometry.filter(Pose2::is_finite);
        let last = self.state.last.replace((moment.stamp_ns, odometry));
        let Some((last_ns, last_odometry)) = last else {
            return (Some(Pose2::default()), 0.0);
        };
        let seconds = (moment.stamp_ns.saturating_sub(last_ns) as f64 * 1e-9).clamp(0.0, LONGEST_STEP_S);
        if self.settings.random_walk {
            return (None, seconds);
        }
        let step = last_odometry.zip(odometry).map(|(before, now)| before.inverse().compose(&now));
        let possible = |step: &Pose2| libm::hypot(step.x, step.y) <= FASTEST_M_PER_S * seconds.max(0.1);
        (step.filter(possible), seconds)
    }

    fn predict(&mut self, step: Option<Pose2>, seconds: f64) {
        let LocalizerSettings { track: model, filter, .. } = &self.settings;
        let reach_m = filter.motion.walk_m_per_s * seconds;
        let reach_rad = filter.motion.turn_rad_per_s * seconds;
        if let Some(track) = &mut self.state.track {
            track.predict(step, seconds, model, reach_m, reach_rad);
        }
    }

    fn place(&mut self, pose: Pose2, spread: Spread) {
        self.filter.restart(pose, spread);
        let Spread { xy_m, yaw_rad } = spread;
        self.state.track = Some(match &self.state.track {
            Some(track) => track.moved_to(pose, xy_m, yaw_rad),
            None => Track::around(pose, xy_m, yaw_rad, &self.settings.track),
        });
    }

    fn must_search(&self) -> bool {
        match self.state.confidence {
            Confidence::Nowhere => self.filter.state().steps.is_multiple_of(SEARCH_EVERY),
            Confidence::Unconfirmed(_) => self.filter.state().particles.is_empty(),
            Confidence::Tracking(contradicted) => contradicted >= LOST_AFTER,
        }
    }

    /// Tries the whole field. Of the two mirror poses the one nearer to the last known pose is taken.
    fn search(&mut self, moment: &Moment, seen: &Seen) {
        self.state.confidence = Confidence::Nowhere;
        let known = self.state.track.as_ref().map(Track::pose);
        let found =
            global::search(self.filter.observation(), &seen.table, &self.field, SEARCH_MARGIN_M, true, CANDIDATES);
        let best = if self.settings.refinement {
            let refined = found.iter().filter_map(|candidate| {
                // A picture without lines fits everywhere, best where none are to be seen: no reason to go there.
                let refined = self.refine_candidate(moment, seen, &candidate.pose)?;
                let surplus = refined.lines.fitting as f64 - refined.lines.expected as f64 * CONTRADICTED;
                agrees(&refined.lines).then_some((candidate.pose, surplus))
            });
            refined.max_by(|a, b| a.1.total_cmp(&b.1)).map(|(pose, _)| pose)
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
        self.state.confidence = Confidence::Unconfirmed(CONFIRMATIONS);
        self.state.ambiguous = true;
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

    fn refine(&mut self, moment: &Moment, seen: &Seen, estimate: Estimate, support: Support) -> Fix {
        let prediction = self.prediction(moment);
        let (Some(prediction), true) = (prediction, self.settings.refinement) else {
            return self.predicted(moment, estimate, support);
        };
        let mut starts = vec![Vector6::zeros()];
        let track_pose = self.state.track.as_ref().map_or(estimate.best, Track::pose);
        let turned = wrap_angle(estimate.best.yaw - track_pose.yaw).abs();
        if estimate.best.distance(&track_pose) > OTHER_BASIN_M || turned > OTHER_BASIN_RAD {
            starts.extend(moment.footprint_from_optical.map(|place| {
                let seen_from = estimate.best.to_isometry() * place;
                refinement::error_between(&prediction.prior.map_from_optical, &seen_from)
            }));
        }
        let refine = |prior: &Prior| refinement::refine(&self.points, &seen.image, &self.projector, prior, &starts);
        let Some(mut refined) = refine(&prediction.prior) else {
            return self.predicted(moment, estimate, support);
        };
        let mut prediction = prediction;
        let surprise = surprise(&prediction.prior, &refined.moved);
        if surprise > SURPRISE && agrees(&refined.lines) {
            // Lines agree with each other but not with the prediction: odometry or IMU were wronger than they claim.
            if let Some(track) = &mut self.state.track {
                track.doubt(&refined.moved);
            }
            if let Some(doubted) = self.prediction(moment).map(|prediction| prediction.doubted(&refined.moved))
                && let Some(again) = refine(&doubted.prior)
            {
                (prediction, refined) = (doubted, again);
            }
        }
        let agrees = agrees(&refined.lines);
        if agrees {
            self.state.agreed_ns = Some(moment.stamp_ns);
        }
        if agrees && let Some(track) = &mut self.state.track {
            track.update(&prediction, &refined);
        }
        if !agrees && !self.is_contradicted(&refined.lines) {
            // Too little in view to move the pose.
            let mut fix = self.predicted(moment, estimate, support);
            fix.agreement = refined.lines;
            return fix;
        }
        Fix {
            estimate,
            support,
            map_from_optical: refined.map_from_optical,
            covariance: refined.covariance,
            refined: true,
            agreement: refined.lines,
            ambiguous: self.state.ambiguous,
            doubt: None,
        }
    }

    fn prediction(&self, moment: &Moment) -> Option<Prediction> {
        let track = self.state.track.as_ref()?;
        Some(track.prior(&moment.footprint_from_optical?, &self.model(moment)))
    }

    fn model(&self, moment: &Moment) -> TrackModel {
        let model = self.settings.track;
        if moment.tilt_is_measured { model } else { TrackModel { tilt_noise_rad: UNMEASURED_TILT_RAD, ..model } }
    }

    /// Without refinement: the best particle's camera; or where the track puts it.
    fn predicted(&self, moment: &Moment, estimate: Estimate, support: Support) -> Fix {
        let place = moment.footprint_from_optical.unwrap_or(Isometry::IDENTITY);
        let (map_from_optical, covariance) = match self.prediction(moment).filter(|_| self.settings.refinement) {
            Some(prediction) => (prediction.prior.map_from_optical, prediction.prior.covariance),
            None => (estimate.best.to_isometry() * place, estimate.pose_covariance()),
        };
        Fix {
            estimate,
            support,
            map_from_optical,
            covariance,
            refined: false,
            agreement: Agreement::default(),
            ambiguous: self.state.ambiguous,
            doubt: None,
        }
    }

    /// Particles and track follow one robot: where they part, the one that the lines support less starts over around
    /// the other.
    fn reconcile(&mut self, seen: &Seen, fix: &Fix) {
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
        } else if !fix.refined || self.is_contradicted(&fix.agreement) {
            self.state.track = Some(track.moved_to(best, spread.xy_m, spread.yaw_rad));
        }
    }

    fn agreed_lately(&self, moment: &Moment) -> bool {
        self.state.agreed_ns.is_some_and(|then| moment.stamp_ns.saturating_sub(then) <= LONGEST_COAST_NS)
    }

    fn is_contradicted(&self, lines: &Agreement) -> bool {
        lines.expected >= FEWEST_EXPECTED && lines.share() < CONTRADICTED
    }

    fn judge(&mut self, moment: &Moment, mut fix: Fix) -> Fix {
        fix.doubt = self.complaint(moment, &fix);
        let contradicted = matches!(fix.doubt, Some("lines_disagree" | "off_field"));
        let confirms = !self.settings.refinement
            || (fix.agreement.fitting >= FITTING_TO_CONFIRM && fix.agreement.share() >= SHARE_TO_CONFIRM);
        if self.settings.refinement && longest_axis(&fix.covariance) > LOST_M {
            self.state.confidence = Confidence::Nowhere;
        }
        self.state.confidence = match (self.state.confidence, fix.doubt) {
            (Confidence::Tracking(bad), Some(_)) if contradicted => Confidence::Tracking(bad.saturating_add(1)),
            (Confidence::Unconfirmed(_), Some(_)) if contradicted => Confidence::Nowhere,
            (other, Some(_)) => other,
            (Confidence::Unconfirmed(needed), None) if !confirms => Confidence::Unconfirmed(needed),
            (Confidence::Unconfirmed(needed), None) if needed > 1 => Confidence::Unconfirmed(needed - 1),
            (_, None) => Confidence::Tracking(0),
        };
        let confirmed = matches!(self.state.confidence, Confidence::Tracking(_));
        fix.doubt = fix.doubt.or((!confirmed).then_some("unconfirmed"));
        fix
    }

    fn complaint(&self, moment: &Moment, fix: &Fix) -> Option<&'static str> {
        let Validity { share, points, spread_m, refined_m } = self.settings.valid;
        let half = self.field.carpet_half_extent();
        let at = fix.map_from_optical.translation;
        let off_field = at.x.abs() > half.x + 1.0 || at.y.abs() > half.y + 1.0;
        let held = |wanted: bool, complaint: &'static str| (!wanted).then_some(complaint);
        held(self.state.confidence != Confidence::Nowhere, "pose_unknown")
            .or_else(|| held(!moment.stale || self.settings.random_walk, "sensors_stale"))
            .or_else(|| held(moment.odometry.is_some() || self.settings.random_walk, "no_odometry"))
            .or_else(|| held(!fix.estimate.degenerate, "degenerate_weights"))
            .or_else(|| held(!off_field, "off_field"))
            .or_else(|| {
                if !self.settings.refinement {
                    return held(fix.support.weight >= points, "few_lines")
                        .or_else(|| held(fix.support.share >= share, "lines_disagree"))
                        .or_else(|| held(fix.estimate.spread_m <= spread_m, "spread"));
                }
                let sigma = longest_axis(&fix.covariance);
                held(!self.is_contradicted(&fix.agreement), "lines_disagree")
                    .or_else(|| held(fix.refined || self.agreed_lately(moment), "few_lines"))
                    .or_else(|| held(sigma <= refined_m, "spread"))
            })
    }
}

/// Enough lines are where the pose has them.
fn agrees(lines: &Agreement) -> bool {
    lines.fitting >= FEWEST_FITTING && lines.share() > CONTRADICTED
}

/// Standard deviation of x, y along the longer axis.
fn longest_axis(covariance: &Matrix6<f64>) -> f64 {
    let (xx, xy, yy) = (covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]);
    libm::sqrt((0.5 * (xx + yy) + libm::hypot(0.5 * (xx - yy), xy)).max(0.0))
}

/// Squared deviation from the prior per unknown, in its own units: 1 is expected.
fn surprise(prior: &Prior, moved: &Vector6<f64>) -> f64 {
    prior.covariance.cholesky().map_or(0.0, |factor| moved.dot(&factor.solve(moved)) / 6.0)
}
