//! Brings frames and measurements together on the time of the exposure.
//!
//! The stamps in the headers count, not when or in which order messages were logged. A frame waits until odometry,
//! attitude and joints are known up to its exposure, or until waiting longer would be too late.

mod robot_state;
mod state;

pub use robot_state::{GONE_NS, LOG_TIME_SIGMA_S, RobotState, STALE_NS};
pub use state::{InitialPose, OdometryOrigin, StepOrigin, SynchroniserState};

use std::collections::VecDeque;

use glam::{DQuat, DVec3};

use super::history::Pushed;
use super::measurement::{Measurement, MovingFrame, StampClock, StampedTransform, StatedDeviations, TorsoState};
use super::transforms::ChainError;
use realitysim_config::FrameNames;
use realitysim_geometry::{Isometry, Physical, Pose2};
use realitysim_ros2::mcap_read::LogMessage;

/// A frame with what is known about the robot at its exposure.
#[derive(Clone, Debug)]
pub struct Frame {
    /// The message with the image, not decoded.
    pub message: LogMessage,
    /// Time of the exposure, nanoseconds.
    pub stamp_ns: i64,
    /// State of the robot at the exposure.
    pub robot: RobotState,
    /// Time from which the robot's step up to this frame counts.
    pub since: Option<StepOrigin>,
}

/// Log time for which a frame waits for measurements, nanoseconds.
const MAX_WAIT_NS: i64 = 300_000_000;
/// Largest number of frames that wait. With more, the oldest goes on with what there is.
const MAX_WAITING: usize = 64;
/// Largest size of the frames that wait, bytes. With more, the oldest goes on with what there is.
const MAX_WAITING_BYTES: usize = 256 << 20;

/// Collects measurements and frames, and gives out each frame with the robot's state at its exposure.
///
/// [`push`](Self::push) every message, [`pop`](Self::pop) frames until there is none, [`finish`](Self::finish) at the end.
#[derive(Clone, Debug)]
pub struct Synchroniser {
    names: FrameNames,
    state: SynchroniserState,
    waiting: VecDeque<(LogMessage, i64)>,
    waiting_bytes: usize,
    newest_log_ns: i64,
    finished: bool,
    expected: Expected,
    too_late: u64,
    impossible: u64,
}

/// The sensors that a log has messages of. A frame waits for the first message of such a sensor, too.
#[derive(Clone, Copy, Debug, Default)]
pub struct Expected {
    /// Whether there are messages of the inertial measurement unit.
    pub imu: bool,
    /// Whether there are joint angles.
    pub joints: bool,
}

impl Synchroniser {
    /// Creates a synchroniser that goes on from `state`; `names` are those of the coordinate frames.
    pub fn new(names: FrameNames, state: SynchroniserState) -> Self {
        Self {
            names,
            state,
            waiting: VecDeque::new(),
            waiting_bytes: 0,
            newest_log_ns: i64::MIN,
            finished: false,
            expected: Expected::default(),
            too_late: 0,
            impossible: 0,
        }
    }

    /// States which sensors will be heard of.
    pub fn expect(&mut self, expected: Expected) {
        self.expected = expected;
    }

    /// Returns the part that a checkpoint stores.
    pub fn state(&self) -> &SynchroniserState {
        &self.state
    }

    /// Returns the number of measurements that came too late to be used.
    pub fn too_late(&self) -> u64 {
        self.too_late
    }

    /// Returns the number of measurements whose numbers no robot can have measured: see [`Physical`].
    pub fn impossible(&self) -> u64 {
        self.impossible
    }

    /// Returns the time from which the robot's step to the next frame counts; `None` before the first frame or odometry.
    pub fn since(&self) -> Option<StepOrigin> {
        let of_anchor = |anchor: OdometryOrigin| {
            let OdometryOrigin { stamp_ns, log_time_ns, begun, .. } = anchor;
            StepOrigin { stamp_ns, log_time_ns, interval_ns: 0, begun }
        };
        self.state.anchor.map(of_anchor).or(self.state.last_frame)
    }

    /// Returns the time up to which the robot's walk is known, nanoseconds: by odometry, and by a gyro that is still heard.
    pub fn walked_until_ns(&self) -> Option<i64> {
        let walked_ns = self.state.odometry().settled_ns()?;
        let turned_ns = self.state.turn_rate.settled_ns();
        let is_heard = |turned_ns: &i64| walked_ns.saturating_sub(*turned_ns) <= STALE_NS;
        Some(turned_ns.filter(is_heard).map_or(walked_ns, |turned_ns| turned_ns.min(walked_ns)))
    }

    /// Returns whether there has been any attitude.
    pub fn knows_attitude(&self) -> bool {
        !self.state.attitude.is_empty()
    }

    /// Returns whether the attitude is made of raw turn rates and accelerations, since no sensor states one.
    pub fn makes_attitude(&self) -> bool {
        self.knows_attitude() && !self.state.attitude_is_stated
    }

    /// Returns whether constants connect a coordinate frame to the torso's.
    pub fn is_mounted_on_torso(&self, frame: &str) -> bool {
        self.state.tree.is_mounted_on(frame, &self.names.base_link)
    }

    /// Checks the mount with the names of coordinate frames that the frames so far have used.
    ///
    /// The error says why the mount can never be right. `more_may_come` says that the transforms may be incomplete.
    pub fn check_mount(&self, more_may_come: bool) -> Result<(), ChainError> {
        self.state.tree.check_constants(&self.names, more_may_come)
    }

    /// Tells that the log has come to this time, by a message that is not pushed yet.
    pub fn advance(&mut self, log_time_ns: i64) {
        self.newest_log_ns = self.newest_log_ns.max(log_time_ns);
    }

    /// Returns whether no frame is waiting.
    pub fn is_idle(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Takes one message with the measurement that was decoded from it.
    pub fn push(&mut self, message: &LogMessage, input: Measurement) {
        self.advance(message.log_time_ns);
        match input {
            // One message is enough to know that the sensor exists, even if it lacks what is needed.
            Measurement::Imu { .. } => self.expected.imu = false,
            Measurement::Joints { .. } => self.expected.joints = false,
            Measurement::LowState { .. } => self.expected = Expected::default(),
            _ => {}
        }
        match input {
            Measurement::Frame { stamp_ns, frame_id } => {
                // If the log has no coordinate frame of the configured name, the frame's own name is used.
                if !self.state.tree.knows(&self.names.camera_optical) && self.state.tree.knows(&frame_id) {
                    self.names.camera_optical = frame_id;
                }
                self.waiting_bytes += message.data.len();
                self.waiting.push_back((message.clone(), stamp_ns));
            }
            Measurement::Odometry { stamp_ns, odom_from_footprint, moving, clock } => {
                let odometry = moving.and_then(|moving| self.footprint_below(stamp_ns, &moving));
                self.state.odometry_by_log_time = clock == StampClock::Log;
                self.take_odometry(stamp_ns, odometry.unwrap_or(odom_from_footprint), message.log_time_ns);
            }
            Measurement::Velocity { stamp_ns, velocity } => {
                let odometry = self.state.velocity.push(stamp_ns, velocity);
                match odometry {
                    Some(odometry) => self.take_odometry(stamp_ns, odometry, message.log_time_ns),
                    None => self.count(Pushed::Known),
                }
            }
            Measurement::Imu { stamp_ns, orientation, turn_rate, acceleration, frame_id } => {
                let imu_from_base = self.state.tree.fixed_rotation(&frame_id, &self.names.base_link);
                self.state.attitude_by_log_time = false;
                self.take_inertial(stamp_ns, imu_from_base, orientation, turn_rate, acceleration);
            }
            Measurement::LowState { stamp_ns, inertial, head } => {
                if let Some(TorsoState { orientation, turn_rate, acceleration }) = inertial {
                    self.state.attitude_by_log_time = true;
                    let (turn_rate, acceleration) = (Some(turn_rate), Some(acceleration));
                    self.take_inertial(stamp_ns, DQuat::IDENTITY, orientation, turn_rate, acceleration);
                }
                let pan = head.map(|(pan, _)| self.state.pan.push(stamp_ns, pan));
                let tilt = head.map(|(_, tilt)| self.state.tilt.push(stamp_ns, tilt));
                self.count_message([pan, tilt]);
            }
            Measurement::Joints { stamp_ns, pan, tilt } => {
                let pan = pan.map(|pan| self.state.pan.push(stamp_ns, pan));
                let tilt = tilt.map(|tilt| self.state.tilt.push(stamp_ns, tilt));
                self.count_message([pan, tilt]);
            }
            Measurement::Transforms { latched, transforms } => {
                self.take_transforms(latched, transforms, message.log_time_ns);
            }
            Measurement::InitialPose { map_from_footprint, deviations, .. } => {
                let (xy_m, yaw_rad) = match deviations {
                    StatedDeviations::Of { xy_m, yaw_rad } => (Some(xy_m), Some(yaw_rad)),
                    StatedDeviations::None => (None, None),
                    // The pose is believed as if it came without deviations.
                    StatedDeviations::Impossible => {
                        self.count(Pushed::Impossible);
                        (None, None)
                    }
                };
                self.state.initial_pose = Some(InitialPose { map_from_footprint, xy_m, yaw_rad });
                let anchor = |(stamp_ns, odometry)| OdometryOrigin::new(stamp_ns, odometry, message.log_time_ns);
                self.state.anchor = self.state.odometry().newest().map(anchor);
            }
            Measurement::Impossible => self.count(Pushed::Impossible),
            Measurement::CameraInfo(_) | Measurement::Other => {}
        }
    }

    /// Takes the pose of the footprint in `odom`.
    fn take_odometry(&mut self, stamp_ns: i64, odom_from_footprint: Pose2, log_time_ns: i64) {
        // From the first message on the odometry in `/tf` is ignored; it may have another origin.
        let is_first = self.state.odometry.is_empty();
        let before = self.state.odometry().newest().map(|(_, odometry)| odometry);
        let pushed = self.state.odometry.push(stamp_ns, odom_from_footprint);
        let now = OdometryOrigin::new(stamp_ns, odom_from_footprint, log_time_ns);
        self.update_anchor(now, before, is_first, pushed);
        self.count(pushed);
    }

    /// Returns the footprint's pose in `odom` where the odometry is that of the torso, and the transforms have the footprint below it.
    fn footprint_below(&self, stamp_ns: i64, moving: &MovingFrame) -> Option<Pose2> {
        let of_torso = moving.name == self.names.base_link;
        let base_from_footprint =
            of_torso.then(|| self.state.tree.base_from_footprint(stamp_ns, &self.names)).flatten()?;
        let odom_from_footprint: Isometry = moving.odom_from_frame * base_from_footprint;
        odom_from_footprint.is_possible().then(|| Pose2::from_isometry(&odom_from_footprint))
    }

    /// Takes what an inertial sensor measures along the axes of its housing, which `imu_from_base` turns the torso's into.
    fn take_inertial(
        &mut self,
        stamp_ns: i64,
        imu_from_base: DQuat,
        stated: Option<DQuat>,
        turn_rate: Option<DVec3>,
        acceleration: Option<DVec3>,
    ) {
        let state = &mut self.state;
        state.attitude_is_stated |= stated.is_some();
        let orientation = match (stated, turn_rate, acceleration) {
            (None, Some(rate), Some(acceleration)) if !state.attitude_is_stated => {
                state.attitude_filter.push(stamp_ns, rate, acceleration)
            }
            _ => stated,
        };
        // Without an attitude the torso is taken to be upright.
        let upright = orientation.unwrap_or_else(|| imu_from_base.conjugate());
        let turn = turn_rate.map(|rate| {
            if !rate.is_possible() || !upright.is_possible() {
                return Pushed::Impossible;
            }
            state.torso_rate.push(stamp_ns, imu_from_base.conjugate() * rate);
            let rate = upright * rate;
            state.sway_rate.push(stamp_ns, libm::hypot(rate.x, rate.y));
            state.turn_rate.push(stamp_ns, rate.z)
        });
        let tilt = orientation.map(|orientation| state.attitude.push(stamp_ns, orientation * imu_from_base));
        self.count_message([tilt, turn]);
    }

    /// Tells that the log has ended and no frame needs to wait any longer.
    pub fn finish(&mut self) {
        self.finished = true;
    }

    /// Returns the next frame, in the order in which frames came, once all is known that will be known in time.
    pub fn pop(&mut self) -> Option<Frame> {
        let (message, stamp_ns) = self.waiting.front()?;
        let late = self.newest_log_ns.saturating_sub(message.log_time_ns) > MAX_WAIT_NS;
        let crowded = self.waiting.len() > MAX_WAITING || self.waiting_bytes > MAX_WAITING_BYTES;
        if !(self.finished || late || crowded || self.is_known_until(*stamp_ns)) {
            return None;
        }
        let (message, stamp_ns) = self.waiting.pop_front()?;
        self.waiting_bytes -= message.data.len();
        let (robot, since) = (self.robot_next(stamp_ns), self.since());
        self.begin_step(stamp_ns, message.log_time_ns);
        Some(Frame { robot, message, stamp_ns, since })
    }

    /// Lets the next step begin at the frame that has just been given out.
    fn begin_step(&mut self, stamp_ns: i64, log_time_ns: i64) {
        let state = &mut self.state;
        let interval_ns = state.last_frame.map_or(0, |last| stamp_ns.saturating_sub(last.stamp_ns));
        state.last_frame = Some(StepOrigin { stamp_ns, log_time_ns, interval_ns, begun: 0 });
        (state.initial_pose, state.anchor) = (None, None);
    }

    /// Takes transforms into the tree; that from `odom` to `base_footprint` is odometry.
    fn take_transforms(&mut self, latched: bool, transforms: Vec<StampedTransform>, log_time_ns: i64) {
        for t in transforms {
            let is_footprint = t.child == self.names.base_footprint;
            // A footprint that hangs on the torso has the torso's odometry.
            let of_torso =
                (!is_footprint && t.parent == self.names.odom && t.parent_from_child.is_possible()).then(|| {
                    let moving = MovingFrame { name: t.child.clone(), odom_from_frame: t.parent_from_child };
                    self.footprint_below(t.stamp_ns, &moving)
                });
            let of_torso = of_torso.flatten();
            if of_torso.is_some() || (is_footprint && t.parent == self.names.odom) {
                let odometry = of_torso.unwrap_or_else(|| Pose2::from_isometry(&t.parent_from_child));
                let before = self.state.odometry_in_tf.newest().map(|(_, odometry)| odometry);
                let pushed = self.state.odometry_in_tf.push(t.stamp_ns, odometry);
                if self.state.odometry.is_empty() {
                    self.update_anchor(OdometryOrigin::new(t.stamp_ns, odometry, log_time_ns), before, false, pushed);
                }
                self.count(pushed);
            } else if latched {
                self.state.tree.set_static(&t.parent, &t.child, t.parent_from_child);
            } else {
                let pushed = self.state.tree.push(t.stamp_ns, &t.parent, &t.child, t.parent_from_child);
                self.count(pushed);
            }
        }
    }

    /// Makes new odometry the anchor if one is missing: nothing was heard before, or a pose was announced before odometry.
    ///
    /// Where odometry begins anew, with another clock or origin, the anchor is moved so that the way walked so far stays;
    /// `before` was the last odometry until then.
    fn update_anchor(&mut self, now: OdometryOrigin, before: Option<Pose2>, begins_anew: bool, pushed: Pushed) {
        let state = &mut self.state;
        let begins_anew = begins_anew || pushed == Pushed::ClockSetBack;
        match (state.anchor, before) {
            _ if pushed == Pushed::Impossible => {}
            (None, _) if state.last_frame.is_none() || state.initial_pose.is_some() => state.anchor = Some(now),
            (Some(anchor), Some(before)) if begins_anew => {
                let walked = anchor.odometry.inverse().compose(&before);
                let since_ns = now.log_time_ns.saturating_sub(anchor.log_time_ns);
                state.anchor = Some(OdometryOrigin {
                    stamp_ns: now.stamp_ns.saturating_sub(since_ns),
                    odometry: now.odometry.compose(&walked.inverse()),
                    log_time_ns: anchor.log_time_ns,
                    begun: anchor.begun.wrapping_add(1),
                });
            }
            _ => {}
        }
    }

    /// Counts what became of a message of two parts once.
    fn count_message(&mut self, parts: [Option<Pushed>; 2]) {
        let is_impossible = parts.contains(&Some(Pushed::Impossible));
        let pushed = if is_impossible { Some(Pushed::Impossible) } else { parts.into_iter().flatten().next() };
        pushed.into_iter().for_each(|pushed| self.count(pushed));
    }

    /// Counts what became of a measurement.
    fn count(&mut self, pushed: Pushed) {
        match pushed {
            Pushed::TooLate => self.too_late += 1,
            // The sample before was counted as too late, and is valid after all.
            Pushed::ClockSetBack => self.too_late = self.too_late.saturating_sub(1),
            Pushed::Impossible => self.impossible += 1,
            Pushed::Taken | Pushed::Known => {}
        }
    }
}
