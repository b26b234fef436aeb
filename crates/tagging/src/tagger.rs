//! Turns what a frame shows into its tag: runs the localizer and writes its answer as a message.

use realitysim_config::{MotionSource, Settings};
use realitysim_geometry::{Field, Isometry, Lens};
use realitysim_localization::filter::always;
use realitysim_localization::observation::default_alpha;
use realitysim_localization::{
    Evidence, FilterSettings, Fix, Formula, FrameSensors, LensOff, Localizer, LocalizerSettings, LocalizerState, Model,
    Observation, Rejection, Sampling, SlowStateModel, Spread, TimeCheck, Validity,
};
use realitysim_log_input::synchroniser::{InitialPose, OdometryOrigin, RobotState};
use realitysim_ros2::messages::{FrameTag, Header, Pose, Stamp};
use realitysim_vision::Observations;

/// A localizer together with the settings and names that its tags need.
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
    /// A tagger that continues from `state`; the default state knows nothing.
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

    /// A copy of the localizer's state, as a checkpoint stores it.
    pub fn state(&self) -> LocalizerState {
        self.localizer.state()
    }

    /// Number of particle weights so far that were NaN or +inf. More than 0 is a fault of this program.
    pub fn unusable_weights(&self) -> u64 {
        self.localizer.unusable_weights()
    }

    /// Number of frames so far after which the localizer started from nothing; see [`Localizer::begun_anew`].
    pub fn begun_anew(&self) -> u64 {
        self.localizer.begun_anew()
    }

    /// How the lens differs from its calibration, by what has been seen; `None` before there is a track.
    pub fn lens_off(&self) -> Option<LensOff> {
        self.localizer.lens_off()
    }

    /// Prepares for going on after a restart: the pose is kept with a larger uncertainty, because the robot may have been
    /// carried, and odometry starts at a new origin.
    pub fn resume(&mut self) {
        self.localizer.resume();
    }

    /// Starts over at an announced pose. Its spread is at least that of the settings.
    pub fn start_at(&mut self, initial: &InitialPose) {
        let spread = Spread {
            xy_m: initial.xy_m.unwrap_or(0.0).max(self.initial.xy_m),
            yaw_rad: initial.yaw_rad.unwrap_or(0.0).max(self.initial.yaw_rad),
        };
        self.localizer.start_at(initial.map_from_footprint, spread);
    }

    /// Tags a frame whose image could be used. The caller fills in `sequence`, clocks and times.
    ///
    /// `has_time` gets the number of poses weighed so far and says whether there is time for more.
    pub fn tag(
        &mut self,
        stamp_ns: i64,
        robot: &RobotState,
        seen: &Observations,
        has_time: &mut TimeCheck,
    ) -> FrameTag {
        self.apply_new_start(robot);
        let fix = self.localizer.look(&sensors_at(stamp_ns, robot), seen, has_time);
        self.compose(stamp_ns, robot, &fix)
    }

    /// Like [`Self::tag`] without a time limit, and returns the evidence for and against the tag.
    pub fn explain(&mut self, stamp_ns: i64, robot: &RobotState, seen: &Observations) -> (FrameTag, Evidence) {
        self.apply_new_start(robot);
        let sensors = sensors_at(stamp_ns, robot);
        let fix = self.localizer.look(&sensors, seen, &mut always);
        let evidence = self.localizer.evidence(&sensors, seen, &fix);
        (self.compose(stamp_ns, robot, &fix), evidence)
    }

    /// Tags a frame whose image could not be used: an invalid tag at the pose that odometry predicts.
    pub fn tag_blind(&mut self, stamp_ns: i64, robot: &RobotState, reason: Rejection) -> FrameTag {
        self.apply_new_start(robot);
        let fix = self.localizer.coast(&sensors_at(stamp_ns, robot), reason);
        self.compose(stamp_ns, robot, &fix)
    }

    /// Predicts the camera's pose at a time without a frame, as an invalid tag; see [`Localizer::predict_ahead`].
    ///
    /// `ahead` is the state that the prediction propagates, in place of the tagger's own. It begins as a copy of
    /// [`state`](Self::state), and a frame may [go on from](Self::go_on_from) it. `None` if the pose is not known well
    /// enough.
    pub fn predict_ahead(
        &mut self,
        stamp_ns: i64,
        robot: &RobotState,
        ahead: &mut LocalizerState,
        reason: Rejection,
    ) -> Option<FrameTag> {
        self.localizer.exchange(ahead);
        self.apply_new_start(robot);
        let fix = self.localizer.predict_ahead(&sensors_at(stamp_ns, robot), reason);
        self.localizer.exchange(ahead);
        Some(self.compose(stamp_ns, robot, &fix?))
    }

    /// Replaces the localizer's state.
    pub fn go_on_from(&mut self, mut state: LocalizerState) {
        self.localizer.exchange(&mut state);
    }

    /// Applies an announced pose and a new origin of odometry, if the frame brings them.
    fn apply_new_start(&mut self, robot: &RobotState) {
        if let Some(initial) = &robot.initial_pose {
            self.start_at(initial);
        }
        if let Some(OdometryOrigin { stamp_ns, odometry, .. }) = robot.anchor {
            self.localizer.count_from(stamp_ns, odometry);
        }
    }

    /// The message for a fix: the localizer's optical frame becomes `camera_link`.
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

/// The robot's state in the form that the localizer takes.
fn sensors_at(stamp_ns: i64, robot: &RobotState) -> FrameSensors {
    FrameSensors {
        stamp_ns,
        odometry: robot.odometry,
        turned_rad: robot.turned_rad,
        swayed_rad: robot.swayed_rad,
        camera_twist: robot.camera_twist,
        turn_is_measured: robot.turn_is_measured,
        footprint_from_optical: robot.place.as_ref().ok().map(|place| place.footprint_from_optical),
        tilt_is_measured: robot.place.as_ref().is_ok_and(|place| place.tilt_is_measured),
        lean_rad: robot.place.as_ref().ok().and_then(|place| place.lean_rad),
        stale: robot.stale,
        stamp_sigma_s: robot.stamp_sigma_s,
        tilt_sigma_rad: robot.tilt_sigma_rad,
    }
}
