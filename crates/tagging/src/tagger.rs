//! From what a frame shows to its tag: localization's answer as the message that is written.

use realitysim_config::{MotionSource, Settings};
use realitysim_geometry::{Field, Isometry, Lens};
use realitysim_localization::filter::always;
use realitysim_localization::observation::default_alpha;
use realitysim_localization::{
    Evidence, FilterSettings, Fix, Formula, FrameSensors, LensOff, Localizer, LocalizerSettings, LocalizerState,
    MayGoOn, Model, Observation, Rejection, Sampling, SlowStateModel, Spread, Validity,
};
use realitysim_log_input::synchroniser::{InitialPose, OdometryOrigin, RobotState};
use realitysim_ros2::messages::{FrameTag, Header, Pose, Stamp};
use realitysim_vision::Observations;

#[derive(Clone, Debug)]
pub struct Tagger {
    localizer: Localizer,
    initial: Spread,
    model: Model,
    formula: Formula,
    map_frame: String,
    camera_frame: String,
}

impl Tagger {
    pub fn new(settings: &Settings, field: Field, lens: &Lens, state: LocalizerState) -> Self {
        let f = &settings.filter;
        let alpha = f.alpha.unwrap_or_else(|| default_alpha(f.formula));
        let observation = Observation::new(&field, f.line_points, f.formula, alpha, f.simd);
        let initial = Spread { xy_m: f.initial_xy_m, yaw_rad: f.initial_yaw_deg.to_radians() };
        let localizer_settings = LocalizerSettings {
            filter: FilterSettings {
                sampling: Sampling {
                    particles: f.particles,
                    iterations: f.iterations,
                    adaptive: f.adaptive,
                    fewest: f.particles_min,
                },
                motion: settings.motion,
                jitter: Spread { xy_m: f.jitter_xy_m, yaw_rad: f.jitter_yaw_deg.to_radians() },
                jitter_shrink: f.jitter_shrink,
                seed: f.seed,
            },
            track: SlowStateModel::default(),
            refinement: f.refinement,
            random_walk: f.motion == MotionSource::RandomWalk,
            initial,
            valid: Validity {
                share: f.valid_share,
                points: f.valid_points,
                spread_m: f.valid_spread_m,
                refined_m: f.valid_refined_m,
                explained: f.valid_explained,
            },
        };
        Self {
            localizer: Localizer::new(localizer_settings, field, lens, observation, state),
            initial,
            model: f.model,
            formula: f.formula,
            map_frame: settings.frames.map.clone(),
            camera_frame: settings.frames.camera_link.clone(),
        }
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> LocalizerState {
        self.localizer.state()
    }

    /// Weights of particles so far that were NaN or +inf: whoever sees any has found a fault.
    pub fn unusable_weights(&self) -> u64 {
        self.localizer.unusable_weights()
    }

    /// Frames so far after which everything was forgotten; see [`Localizer::begun_anew`].
    pub fn begun_anew(&self) -> u64 {
        self.localizer.begun_anew()
    }

    /// How the lens differs from its calibration.
    pub fn lens_off(&self) -> Option<LensOff> {
        self.localizer.lens_off()
    }

    /// After a restart: the pose is kept, but the robot may have been carried, and odometry counts anew.
    pub fn resume(&mut self) {
        self.localizer.resume();
    }

    /// Somebody says where the robot is.
    pub fn start_at(&mut self, initial: &InitialPose) {
        let spread = Spread {
            xy_m: initial.xy_m.unwrap_or(0.0).max(self.initial.xy_m),
            yaw_rad: initial.yaw_rad.unwrap_or(0.0).max(self.initial.yaw_rad),
        };
        self.localizer.start_at(initial.map_from_footprint, spread);
    }

    /// The tag of a frame of which something was seen. `sequence`, clocks and times are the caller's to fill in.
    /// `may_go_on` says when time is up.
    pub fn tag(&mut self, stamp_ns: i64, robot: &RobotState, seen: &Observations, may_go_on: &mut MayGoOn) -> FrameTag {
        self.begin_anew(robot);
        let fix = self.localizer.look(&moment(stamp_ns, robot), seen, may_go_on);
        self.compose(stamp_ns, robot, &fix)
    }

    /// As [`Self::tag`], with what speaks for and against it.
    pub fn explain(&mut self, stamp_ns: i64, robot: &RobotState, seen: &Observations) -> (FrameTag, Evidence) {
        self.begin_anew(robot);
        let moment = moment(stamp_ns, robot);
        let fix = self.localizer.look(&moment, seen, &mut always);
        let evidence = self.localizer.evidence(&moment, seen, &fix);
        (self.compose(stamp_ns, robot, &fix), evidence)
    }

    /// The tag of a frame of which nothing could be seen: where odometry puts the robot, marked invalid.
    pub fn tag_blind(&mut self, stamp_ns: i64, robot: &RobotState, reason: Rejection) -> FrameTag {
        self.begin_anew(robot);
        let fix = self.localizer.coast(&moment(stamp_ns, robot), reason);
        self.compose(stamp_ns, robot, &fix)
    }

    /// Of no frame: where odometry puts the camera at that time, marked invalid; see [`Localizer::foresee`]. `ahead` is what
    /// is remembered of that; it begins as [`state`](Self::state), and a frame may [go on from](Self::go_on_from) it.
    pub fn foresee(
        &mut self,
        stamp_ns: i64,
        robot: &RobotState,
        ahead: &mut LocalizerState,
        reason: Rejection,
    ) -> Option<FrameTag> {
        self.localizer.exchange(ahead);
        self.begin_anew(robot);
        let fix = self.localizer.foresee(&moment(stamp_ns, robot), reason);
        self.localizer.exchange(ahead);
        Some(self.compose(stamp_ns, robot, &fix?))
    }

    pub fn go_on_from(&mut self, mut state: LocalizerState) {
        self.localizer.exchange(&mut state);
    }

    /// Where somebody has said where the robot is, or nothing is known of the time before.
    fn begin_anew(&mut self, robot: &RobotState) {
        if let Some(initial) = &robot.initial_pose {
            self.start_at(initial);
        }
        if let Some(OdometryOrigin { stamp_ns, odometry, .. }) = robot.anchor {
            self.localizer.count_from(stamp_ns, odometry);
        }
    }

    fn compose(&self, stamp_ns: i64, robot: &RobotState, fix: &Fix) -> FrameTag {
        let Fix { estimate, support, .. } = fix;
        let place = robot.place.as_ref();
        let footprint_from_camera = place.map_or(Isometry::IDENTITY, |place| place.footprint_from_link);
        let optical_from_camera = place
            .map_or(Isometry::IDENTITY, |place| place.footprint_from_optical.inverse() * place.footprint_from_link);
        let map_from_camera = fix.map_from_optical * optical_from_camera;
        let best = estimate.best.to_isometry() * footprint_from_camera;
        let euler = map_from_camera.euler();
        let mut tag = FrameTag {
            header: Header::at(stamp_ns, &self.map_frame),
            child_frame_id: self.camera_frame.clone(),
            valid: fix.rejection.is_none(),
            reason: fix.rejection.map_or_else(String::new, |rejection| rejection.to_string()),
            model: match self.model {
                Model::Gauss => "gauss",
                Model::Distance => "distance",
            }
            .to_owned(),
            formula: match self.formula {
                Formula::Corrected => "corrected",
                Formula::Paper => "paper",
            }
            .to_owned(),
            particles: fix.effort.particles,
            iterations: fix.effort.iterations,
            weighed: fix.effort.weighed,
            capped: fix.effort.capped,
            line_points: support.points as u32,
            effective_sample_size: estimate.effective_sample_size,
            evidence: estimate.evidence / self.localizer.observation().point_count().max(1) as f64,
            spread_m: estimate.spread_m,
            spread_yaw_rad: estimate.spread_yaw_rad,
            ambiguous: fix.ambiguous,
            mirror_pose: Pose::from(map_from_camera.mirrored()),
            residual: support.share,
            best_particle: Pose::from(best),
            refined: fix.refined,
            lines_expected: fix.agreement.expected as u32,
            lines_fitting: fix.agreement.fitting as u32,
            lines_rms_px: fix.agreement.rms_px,
            lines_explained: fix.explained.share,
            yaw: euler.yaw,
            pitch: euler.pitch,
            roll: euler.roll,
            odometry_until: Stamp::from_nanoseconds(robot.odometry_until_ns.unwrap_or(0)),
            ..FrameTag::default()
        };
        tag.pose.pose = Pose::from(map_from_camera);
        for row in 0..6 {
            for column in 0..6 {
                tag.pose.covariance[6 * row + column] = fix.covariance[(row, column)];
            }
        }
        tag
    }
}

fn moment(stamp_ns: i64, robot: &RobotState) -> FrameSensors {
    FrameSensors {
        stamp_ns,
        odometry: robot.odometry,
        turned_rad: robot.turned_rad,
        swayed_rad: robot.swayed_rad,
        camera_twist: robot.camera_twist,
        turn_is_felt: robot.turn_is_felt,
        footprint_from_optical: robot.place.as_ref().ok().map(|place| place.footprint_from_optical),
        tilt_is_measured: robot.place.as_ref().is_ok_and(|place| place.tilt_is_measured),
        lean_rad: robot.place.as_ref().ok().and_then(|place| place.lean_rad),
        stale: robot.stale,
    }
}
