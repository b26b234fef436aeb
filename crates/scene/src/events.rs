//! The messages of the robot's sensors, in order of time.

use std::borrow::Cow;

use glam::{DQuat, DVec3};

use super::effects::{DeliveryOutcome, HeadMotion, ImuError, Joints, OdometryError};
use super::file::InitialPose;
use super::motion::Travel;
use super::per_frame::Changing;
use super::truth::{Truth, Twist};
use super::{START_STAMP_NS, Scene};
use realitysim_geometry::{Isometry, Pose2, wrap_angle};

/// One message of a sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneEvent {
    /// Time of the measurement, nanoseconds since 1970.
    pub stamp_ns: i64,
    /// Content of the message.
    pub kind: SceneEventKind,
    /// If present, the message arrives with one flipped bit, and this number selects the bit.
    pub corrupt: Option<u64>,
}

/// The content of a message.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneEventKind {
    /// Announced pose at the start.
    InitialPose(InitialPoseEstimate),
    /// Odometry message.
    Odometry(Odometry),
    /// IMU message.
    Imu(Imu),
    /// Measured joint angles of the head. They are sent only if the head moves.
    Joints(Joints),
    /// Camera image. [`Renderer::render`](super::Renderer::render) gives its pixels.
    Frame {
        /// Number of the frame, from 0.
        index: u64,
        /// True pose of the camera.
        map_from_camera_link: Isometry,
    },
}

/// An announced pose of the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InitialPoseEstimate {
    /// Announced pose on the ground.
    pub map_from_base_footprint: Pose2,
}

/// A measurement of the odometry. The coordinate frame `odom` is the pose at which the robot started.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odometry {
    /// Measured pose since the start.
    pub odom_from_base_footprint: Pose2,
    /// Measured velocity, in `base_footprint`.
    pub twist: Twist,
}

/// A measurement of the IMU, in `base_link`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    /// Orientation: roll and pitch against gravity, yaw from the odometry, as on a robot without a compass.
    pub orientation: DQuat,
    /// Angular velocity, rad/s.
    pub angular_velocity: DVec3,
    /// Acceleration with gravity included, m/s^2.
    pub linear_acceleration: DVec3,
}

/// Order of events with the same stamp. Images come last because their pose estimate needs the other measurements.
const ORDER: [Source; 5] = [Source::InitialPose, Source::Odometry, Source::Imu, Source::Joints, Source::Frame];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Source {
    InitialPose,
    Odometry,
    Imu,
    Joints,
    Frame,
}

/// Iterator over the events of a scene, in order of time.
#[derive(Clone, Debug)]
pub struct Events<'a> {
    scene: &'a Scene,
    clocks: [Option<Clock>; 5],
    odometer: Odometer,
    /// Index of the frame that was last due. All sensors use the values drawn for this frame.
    frame: u64,
    /// Effects with the values drawn for `frame`.
    now: Cow<'a, Changing>,
}

impl<'a> Events<'a> {
    pub(super) fn new(scene: &'a Scene) -> Self {
        let duration = scene.duration_s();
        let file = &scene.file;
        let announced = (file.scene.initial_pose != InitialPose::None).then(Clock::once);
        let clock = |rate: f64| Clock::new(rate, duration);
        Self {
            scene,
            clocks: [
                announced,
                file.odometry.map(|section| clock(section.rate_hz)),
                file.imu.map(|section| clock(section.rate_hz)),
                file.imu.filter(|_| scene.has_joints()).map(|section| clock(section.rate_hz)),
                Some(clock(file.camera.rate_hz)),
            ],
            odometer: Odometer { pose: Pose2::default(), time: 0.0, before: scene.travel(0.0) },
            frame: 0,
            now: scene.at_frame(0),
        }
    }
}

impl Iterator for Events<'_> {
    type Item = SceneEvent;

    fn next(&mut self) -> Option<SceneEvent> {
        loop {
            let due = |clock: &Option<Clock>| clock.as_ref().and_then(Clock::due_ns);
            // Of events with the same stamp, the first in `ORDER` comes first.
            let (which, offset_ns) = (0..ORDER.len())
                .filter_map(|which| due(&self.clocks[which]).map(|offset| (which, offset)))
                .min_by_key(|(_, offset)| *offset)?;
            let index = self.clocks[which].as_mut()?.tick();
            self.advance(seconds(offset_ns));
            if let Some(kind) = self.event(ORDER[which], seconds(offset_ns), index) {
                let corrupt = match self.delivery_outcome(ORDER[which], index) {
                    DeliveryOutcome::Whole => None,
                    DeliveryOutcome::Lost => continue,
                    DeliveryOutcome::Corrupt(which) => Some(which),
                };
                return Some(SceneEvent { stamp_ns: START_STAMP_NS + offset_ns, kind, corrupt });
            }
        }
    }
}

impl Events<'_> {
    /// Updates the per-frame effects to the frame that is due at `time`, seconds.
    fn advance(&mut self, time: f64) {
        // Borrowed effects have no values per frame and never change.
        if let Cow::Owned(_) = self.now {
            let frame = self.scene.frame_at(time);
            if frame != self.frame {
                (self.frame, self.now) = (frame, self.scene.at_frame(frame));
            }
        }
    }

    /// Whether the message arrives whole, arrives corrupt or is lost on the serial line.
    fn delivery_outcome(&self, source: Source, index: u64) -> DeliveryOutcome {
        let line = match source {
            Source::InitialPose | Source::Frame => return DeliveryOutcome::Whole,
            Source::Odometry => 1,
            Source::Imu => 2,
            Source::Joints => 3,
        };
        let seed = self.scene.file.scene.seed;
        self.now.serial_noise.as_ref().map_or(DeliveryOutcome::Whole, |noise| noise.delivery_outcome(seed, line, index))
    }

    /// Content of the message of `source`, or `None` if the sensor is silent at this time.
    fn event(&mut self, source: Source, time: f64, index: u64) -> Option<SceneEventKind> {
        let scene = self.scene;
        Some(match source {
            Source::InitialPose => SceneEventKind::InitialPose(initial_pose(scene)),
            Source::Odometry => {
                let odometry = self.odometer.sample(scene, self.now.odometry_error.as_ref(), time, index);
                if self.now.odometry_error.as_ref().is_some_and(|error| error.is_silent(time)) {
                    return None;
                }
                SceneEventKind::Odometry(odometry)
            }
            Source::Imu => SceneEventKind::Imu(imu(scene, &self.now, time, index)),
            Source::Joints => SceneEventKind::Joints(joints(scene, &self.now, time, index)),
            Source::Frame => {
                if scene.camera_fault.as_ref().is_some_and(|fault| fault.is_unplugged(time)) {
                    return None;
                }
                SceneEventKind::Frame { index, map_from_camera_link: scene.truth(time).map_from_camera_link }
            }
        })
    }
}

fn initial_pose(scene: &Scene) -> InitialPoseEstimate {
    let truth = scene.travel(0.0).map_from_base_footprint;
    let map_from_base_footprint = match scene.file.scene.initial_pose {
        InitialPose::Exact | InitialPose::None => truth,
        InitialPose::Off(error) => Pose2 {
            x: truth.x + error.x_m,
            y: truth.y + error.y_m,
            yaw: wrap_angle(truth.yaw + error.yaw_deg.to_radians()),
        },
    };
    InitialPoseEstimate { map_from_base_footprint }
}

fn imu(scene: &Scene, now: &Changing, time: f64, index: u64) -> Imu {
    let Truth { map_from_base_link, angular_velocity, linear_acceleration, .. } = scene.truth(time);
    let travel = scene.travel(time);
    let drift = now.odometry_error.as_ref().map_or(0.0, OdometryError::yaw_drift);
    let mut euler = map_from_base_link.euler();
    euler.yaw = wrap_angle(travel.turned + drift * travel.walked);
    let measured = |error: &ImuError| error.measured(euler, angular_velocity, scene.file.scene.seed, index);
    let (euler, angular_velocity) = now.imu_error.as_ref().map_or((euler, angular_velocity), measured);
    let imu = Imu { orientation: euler.rotation(), angular_velocity, linear_acceleration };
    now.imu_error.as_ref().map_or(imu, |error| error.in_housing(imu))
}

fn joints(scene: &Scene, now: &Changing, time: f64, index: u64) -> Joints {
    let measured = |head: &HeadMotion| head.measured(time, scene.file.scene.seed, index);
    now.head.as_ref().map_or_else(Joints::default, measured)
}

/// An odometry that adds up steps, because every step has its own error.
#[derive(Clone, Debug)]
struct Odometer {
    pose: Pose2,
    time: f64,
    before: Travel,
}

impl Odometer {
    fn sample(&mut self, scene: &Scene, error: Option<&OdometryError>, time: f64, index: u64) -> Odometry {
        let now = scene.travel(time);
        let mut twist = Twist { x: now.speed, y: 0.0, yaw: now.turn };
        match error {
            // Without an error the true pose is taken, so that no rounding adds up.
            None => self.pose = now.start_from_base_footprint,
            Some(error) if error.is_frozen(time) => twist = Twist::default(),
            Some(error) => {
                let step = self.before.start_from_base_footprint.inverse().compose(&now.start_from_base_footprint);
                let walked = now.walked - self.before.walked;
                self.pose = self.pose.compose(&error.measured(&step, walked, scene.file.scene.seed, index));
                twist = Twist { x: twist.x * error.scale(), yaw: twist.yaw + error.yaw_drift() * twist.x, ..twist };
            }
        }
        if let Some(jump) = error.and_then(|error| error.jump_between(self.time, time)) {
            self.pose = self.pose.compose(&jump);
        }
        self.time = time;
        self.before = now;
        Odometry { odom_from_base_footprint: self.pose, twist }
    }
}

/// A clock that ticks at a fixed rate from the start to the end of the scene, both included.
///
/// Times are computed from the index of the tick, so they do not drift.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    rate_hz: f64,
    end_ns: i64,
    next: u64,
}

impl Clock {
    pub(super) fn new(rate_hz: f64, duration_s: f64) -> Self {
        Self { rate_hz, end_ns: libm::floor(duration_s * 1e9) as i64, next: 0 }
    }

    fn once() -> Self {
        Self { rate_hz: 1.0, end_ns: 0, next: 0 }
    }

    fn offset_ns(&self, index: u64) -> i64 {
        libm::round(index as f64 * 1e9 / self.rate_hz) as i64
    }

    /// Time of a tick, seconds since the start.
    pub(super) fn time(&self, index: u64) -> f64 {
        seconds(self.offset_ns(index))
    }

    /// Index of the last tick at or before `time` (seconds), or 0 before the first tick.
    pub(super) fn last_by(&self, time: f64) -> u64 {
        let mut index = (time * self.rate_hz).max(0.0) as u64 + 1;
        while index > 0 && self.time(index) > time {
            index -= 1;
        }
        index
    }

    /// Number of ticks from start to end.
    pub(super) fn count(&self) -> u64 {
        let mut count = (self.end_ns as f64 * 1e-9 * self.rate_hz) as u64;
        while self.offset_ns(count) <= self.end_ns {
            count += 1;
        }
        count
    }

    fn due_ns(&self) -> Option<i64> {
        let offset = self.offset_ns(self.next);
        (offset <= self.end_ns).then_some(offset)
    }

    fn tick(&mut self) -> u64 {
        self.next += 1;
        self.next - 1
    }
}

fn seconds(offset_ns: i64) -> f64 {
    offset_ns as f64 / 1e9
}
