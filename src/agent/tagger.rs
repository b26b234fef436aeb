//! From what a frame shows to its tag: the filter, and whether to believe it.

use serde::{Deserialize, Serialize};

use crate::config::{Formula, Model, Settings};
use crate::geometry::{Field, Isometry, Pose2};
use crate::localization::observation::default_alpha;
use crate::localization::{Estimate, Filter, FilterSettings, FilterState, Observation, Spread, Support, global};
use crate::ros2::messages::{FrameTag, Stamp};
use crate::sensors::scene::{header, pose};
use crate::sensors::synchroniser::{InitialPose, RobotAt};
use crate::vision::Seen;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TaggerState {
    pub filter: FilterState,
    /// Exposure and odometry of the last frame.
    pub last: Option<(i64, Option<Pose2>)>,
    pub confidence: Confidence,
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
    /// Confirmed; frames since the lines last agreed.
    Tracking(u32),
}

#[derive(Clone, Debug)]
pub struct Tagger {
    field: Field,
    filter: Filter,
    state: TaggerState,
    model: Model,
    formula: Formula,
    map_frame: String,
    camera_frame: String,
    initial: Spread,
    valid_share: f64,
    valid_points: f64,
    valid_spread_m: f64,
    random_walk: bool,
}

/// Frames with good lines that a pose found by search or kept over a restart needs.
const CONFIRMATIONS: u32 = 3;
/// Frames without good lines after which the field is searched again.
const LOST_AFTER: u32 = 30;
/// While lost, only every so many frames pay for a search.
const SEARCH_EVERY: u64 = 5;
/// A pose a little off the carpet is possible.
const SEARCH_MARGIN_M: f64 = 0.3;
/// A restarted robot may have been carried: the cloud is widened by this.
const RESTART: Spread = Spread { xy_m: 0.3, yaw_rad: 0.3 };
/// Longer gaps say nothing more about where the robot went.
const LONGEST_STEP_S: f64 = 5.0;
/// Standard deviations of what the filter does not estimate: height (m), roll and pitch (rad).
const HEIGHT_SIGMA_M: f64 = 0.01;
const TILT_SIGMA_RAD: f64 = 0.012;
/// Floor of the covariance in x, y (m) and yaw (rad): what the unknown tilt does to a pose.
const POSITION_FLOOR_M: f64 = 0.025;
const YAW_FLOOR_RAD: f64 = 0.008;

impl Tagger {
    pub fn new(settings: &Settings, field: Field, state: TaggerState) -> Self {
        let f = &settings.filter;
        let alpha = f.alpha.unwrap_or_else(|| default_alpha(f.formula));
        let observation = Observation::new(&field, f.line_points, f.formula, alpha, f.simd);
        let filter_settings = FilterSettings {
            particles: f.particles,
            iterations: f.iterations,
            motion: settings.motion,
            jitter: Spread { xy_m: f.jitter_xy_m, yaw_rad: f.jitter_yaw_deg.to_radians() },
            jitter_shrink: f.jitter_shrink,
            seed: f.seed,
        };
        Self {
            field,
            filter: Filter::new(filter_settings, observation, state.filter.clone()),
            state,
            model: f.model,
            formula: f.formula,
            map_frame: settings.frames.map.clone(),
            camera_frame: settings.frames.camera_link.clone(),
            initial: Spread { xy_m: f.initial_xy_m, yaw_rad: f.initial_yaw_deg.to_radians() },
            valid_share: f.valid_share,
            valid_points: f.valid_points,
            valid_spread_m: f.valid_spread_m,
            random_walk: settings.filter.motion == crate::config::MotionSource::RandomWalk,
        }
    }

    /// What a checkpoint keeps.
    pub fn state(&self) -> TaggerState {
        TaggerState { filter: self.filter.state().clone(), ..self.state.clone() }
    }

    /// After a restart: the pose is kept, but the robot may have been carried, and odometry counts anew.
    pub fn resume(&mut self) {
        if self.state.confidence != Confidence::Nowhere {
            self.filter.widen(RESTART);
            self.state.confidence = Confidence::Unconfirmed(CONFIRMATIONS);
        }
        self.state.last = None;
    }

    /// Somebody says where the robot is.
    pub fn start_at(&mut self, initial: &InitialPose) {
        let spread = Spread {
            xy_m: initial.xy_m.unwrap_or(0.0).max(self.initial.xy_m),
            yaw_rad: initial.yaw_rad.unwrap_or(0.0).max(self.initial.yaw_rad),
        };
        self.filter.restart(initial.map_from_footprint, spread);
        self.state.confidence = Confidence::Unconfirmed(1);
        self.state.ambiguous = false;
    }

    /// The tag of a frame of which something was seen. `sequence`, clocks and times are the caller's to fill in.
    pub fn tag(&mut self, stamp_ns: i64, robot: &RobotAt, seen: &Seen) -> FrameTag {
        if let Some(initial) = &robot.initial_pose {
            self.start_at(initial);
        }
        let (step, seconds) = self.step_to(stamp_ns, robot.odometry);
        if self.must_search() {
            self.search(seen);
        }
        let estimate = self.filter.step(step, seconds, &seen.table);
        let support = self.filter.observation().support(seen.lines(), &estimate.best);
        let reason = self.judge(robot, &estimate, &support);
        self.compose(stamp_ns, robot, &estimate, &support, reason)
    }

    /// The tag of a frame of which nothing could be seen: where odometry puts the robot, marked invalid.
    pub fn tag_blind(&mut self, stamp_ns: i64, robot: &RobotAt, reason: &str) -> FrameTag {
        if let Some(initial) = &robot.initial_pose {
            self.start_at(initial);
        }
        let (step, seconds) = self.step_to(stamp_ns, robot.odometry);
        let estimate = self.filter.coast(step, seconds);
        self.count_bad_frame();
        self.compose(stamp_ns, robot, &estimate, &Support::default(), Some(reason.to_owned()))
    }

    /// The robot's step since the last frame by odometry, and how long it took.
    fn step_to(&mut self, stamp_ns: i64, odometry: Option<Pose2>) -> (Option<Pose2>, f64) {
        let last = self.state.last.replace((stamp_ns, odometry));
        let Some((last_ns, last_odometry)) = last else {
            return (Some(Pose2::default()), 0.0);
        };
        let seconds = (stamp_ns.saturating_sub(last_ns) as f64 * 1e-9).clamp(0.0, LONGEST_STEP_S);
        match (last_odometry, odometry) {
            _ if self.random_walk => (None, seconds),
            (Some(before), Some(now)) => (Some(before.inverse().compose(&now)), seconds),
            _ => (None, seconds),
        }
    }

    fn must_search(&self) -> bool {
        let due = self.filter.state().steps.is_multiple_of(SEARCH_EVERY);
        match self.state.confidence {
            Confidence::Nowhere => due,
            Confidence::Unconfirmed(_) => self.filter.state().particles.is_empty(),
            Confidence::Tracking(bad) => bad >= LOST_AFTER && due,
        }
    }

    /// Tries the whole field. Of the two mirror poses the one nearer to the last known pose is taken.
    fn search(&mut self, seen: &Seen) {
        let known = self.filter.state().particles.poses.first().copied();
        let found = global::search(self.filter.observation(), &seen.table, &self.field, SEARCH_MARGIN_M, true, 1);
        let Some(candidate) = found.first() else { return };
        let mirrored = candidate.pose.mirrored();
        let nearer = known.is_some_and(|known| mirrored.distance(&known) < candidate.pose.distance(&known));
        self.filter.restart(if nearer { mirrored } else { candidate.pose }, self.initial);
        self.state.confidence = Confidence::Unconfirmed(CONFIRMATIONS);
        self.state.ambiguous = true;
    }

    /// Why the tag is not to be used; `None` when it is.
    fn judge(&mut self, robot: &RobotAt, estimate: &Estimate, support: &Support) -> Option<String> {
        let half = self.field.carpet_half_extent();
        let off_field = estimate.best.x.abs() > half.x + 1.0 || estimate.best.y.abs() > half.y + 1.0;
        let complaint = if self.state.confidence == Confidence::Nowhere {
            Some("pose_unknown")
        } else if robot.stale && !self.random_walk {
            Some("sensors_stale")
        } else if robot.odometry.is_none() && !self.random_walk {
            Some("no_odometry")
        } else if estimate.degenerate {
            Some("degenerate_weights")
        } else if off_field {
            Some("off_field")
        } else if support.weight < self.valid_points {
            Some("few_lines")
        } else if support.share < self.valid_share {
            Some("lines_disagree")
        } else if estimate.spread_m > self.valid_spread_m {
            Some("spread")
        } else {
            None
        };
        if let Some(complaint) = complaint {
            self.count_bad_frame();
            return Some(complaint.to_owned());
        }
        self.state.confidence = match self.state.confidence {
            Confidence::Unconfirmed(needed) if needed > 1 => Confidence::Unconfirmed(needed - 1),
            _ => Confidence::Tracking(0),
        };
        let confirmed = matches!(self.state.confidence, Confidence::Tracking(_));
        (!confirmed).then(|| "unconfirmed".to_owned())
    }

    fn count_bad_frame(&mut self) {
        self.state.confidence = match self.state.confidence {
            Confidence::Tracking(bad) => Confidence::Tracking(bad.saturating_add(1)),
            other => other,
        };
    }

    fn compose(
        &self,
        stamp_ns: i64,
        robot: &RobotAt,
        estimate: &Estimate,
        support: &Support,
        reason: Option<String>,
    ) -> FrameTag {
        let footprint_from_camera = robot.place.as_ref().map_or(Isometry::IDENTITY, |place| place.footprint_from_link);
        let map_from_camera = estimate.best.to_isometry() * footprint_from_camera;
        let mirror = estimate.best.mirrored().to_isometry() * footprint_from_camera;
        let euler = map_from_camera.euler();
        let settings = self.filter.settings();
        let mut tag = FrameTag {
            header: header(stamp_ns, &self.map_frame),
            child_frame_id: self.camera_frame.clone(),
            valid: reason.is_none(),
            reason: reason.unwrap_or_default(),
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
            particles: settings.particles as u32,
            iterations: settings.iterations as u32,
            line_points: support.points as u32,
            effective_sample_size: estimate.effective_sample_size,
            evidence: estimate.evidence / self.filter.observation().point_count().max(1) as f64,
            spread_m: estimate.spread_m,
            spread_yaw_rad: estimate.spread_yaw_rad,
            ambiguous: self.state.ambiguous,
            mirror_pose: pose(&mirror),
            residual: support.share,
            best_particle: pose(&map_from_camera),
            refined: false,
            yaw: euler.yaw,
            pitch: euler.pitch,
            roll: euler.roll,
            odometry_until: Stamp::from_nanoseconds(robot.odometry_until_ns.unwrap_or(0)),
            ..FrameTag::default()
        };
        tag.pose.pose = pose(&map_from_camera);
        tag.pose.covariance = covariance(estimate);
        tag
    }
}

/// Order x, y, z, rotation about x, y, z, as ROS; the fixed parts are what the filter does not estimate.
fn covariance(estimate: &Estimate) -> [f64; 36] {
    let mut result = [0.0; 36];
    let from = [0, 1, 5];
    for (i, row) in from.into_iter().enumerate() {
        for (j, column) in from.into_iter().enumerate() {
            result[6 * row + column] = estimate.covariance[(i, j)];
        }
    }
    for (index, sigma) in [
        (0, POSITION_FLOOR_M),
        (1, POSITION_FLOOR_M),
        (2, HEIGHT_SIGMA_M),
        (3, TILT_SIGMA_RAD),
        (4, TILT_SIGMA_RAD),
        (5, YAW_FLOOR_RAD),
    ] {
        result[7 * index] += sigma * sigma;
    }
    result
}
