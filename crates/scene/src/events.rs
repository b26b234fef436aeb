//! What the robot's sensors send, in time order.

use std::borrow::Cow;

use glam::{DQuat, DVec3};

use super::effects::{DeliveryOutcome, HeadMotion, ImuError, Joints, OdometryError};
use super::file::InitialPose;
use super::motion::Travel;
use super::per_frame::Changing;
use super::truth::{Truth, Twist};
use super::{START_STAMP_NS, Scene};
use realitysim_geometry::{Isometry, Pose2, wrap_angle};

#[derive(Clone, Debug, PartialEq)]
pub struct SceneEvent {
    /// Nanoseconds since 1970.
    pub stamp_ns: i64,
    pub kind: SceneEventKind,
    /// It arrives with one bit flipped; which one follows from this number.
    pub corrupt: Option<u64>,
}

#[derive(Clone, Debug, PartialEq)]
pub enum SceneEventKind {
    InitialPose(InitialPoseEstimate),
    Odometry(Odometry),
    Imu(Imu),
    /// Only if the head moves.
    Joints(Joints),
    /// The image itself comes from [`Renderer::render`](super::Renderer::render).
    Frame {
        index: u64,
        map_from_camera_link: Isometry,
    },
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InitialPoseEstimate {
    pub map_from_base_footprint: Pose2,
}

/// `odom` is where the robot started.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Odometry {
    pub odom_from_base_footprint: Pose2,
    /// In `base_footprint`.
    pub twist: Twist,
}

/// Of `base_link`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imu {
    /// Roll and pitch against gravity; the yaw is the odometry's, as on a robot without a compass.
    pub orientation: DQuat,
    /// rad/s
    pub angular_velocity: DVec3,
    /// Gravity included: m/s^2.
    pub linear_acceleration: DVec3,
}

/// In the order in which events of the same stamp come: an estimate needs the state before the image.
const ORDER: [Source; 5] = [Source::InitialPose, Source::Odometry, Source::Imu, Source::Joints, Source::Frame];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Source {
    InitialPose,
    Odometry,
    Imu,
    Joints,
    Frame,
}

#[derive(Clone, Debug)]
pub struct Events<'a> {
    scene: &'a Scene,
    clocks: [Option<Clock>; 5],
    odometer: Odometer,
    /// Of the frame that was last due: what sensors other than the camera draw for it, too.
    frame: u64,
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
            // The first of equals wins.
            let (which, offset_ns) = (0..ORDER.len())
                .filter_map(|which| due(&self.clocks[which]).map(|offset| (which, offset)))
                .min_by_key(|(_, offset)| *offset)?;
            let index = self.clocks[which].as_mut()?.tick();
            self.advance(seconds(offset_ns));
            if let Some(kind) = self.event(ORDER[which], seconds(offset_ns), index) {
                let corrupt = match self.fate(ORDER[which], index) {
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
    fn advance(&mut self, time: f64) {
        // Where nothing is drawn per frame there is nothing to ask for.
        if let Cow::Owned(_) = self.now {
            let frame = self.scene.frame_at(time);
            if frame != self.frame {
                (self.frame, self.now) = (frame, self.scene.at_frame(frame));
            }
        }
    }

    /// What the wire makes of it.
    fn fate(&self, source: Source, index: u64) -> DeliveryOutcome {
        let line = match source {
            Source::InitialPose | Source::Frame => return DeliveryOutcome::Whole,
            Source::Odometry => 1,
            Source::Imu => 2,
            Source::Joints => 3,
        };
        let seed = self.scene.file.scene.seed;
        self.now.serial_noise.as_ref().map_or(DeliveryOutcome::Whole, |noise| noise.fate(seed, line, index))
    }

    /// None where a sensor says nothing.
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
    let told = Imu { orientation: euler.rotation(), angular_velocity, linear_acceleration };
    now.imu_error.as_ref().map_or(told, |error| error.in_housing(told))
}

fn joints(scene: &Scene, now: &Changing, time: f64, index: u64) -> Joints {
    let told = |head: &HeadMotion| head.measured(time, scene.file.scene.seed, index);
    now.head.as_ref().map_or_else(Joints::default, told)
}

/// Adds up steps, because every step has its own error.
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
            // Not added up: without an error the truth itself.
            None => self.pose = now.start_from_base_footprint,
            Some(error) if error.is_frozen(time) => twist = Twist::default(),
            Some(error) => {
                let step = self.before.start_from_base_footprint.inverse().compose(&now.start_from_base_footprint);
                let walked = now.walked - self.before.walked;
                self.pose = self.pose.compose(&error.measured(&step, walked, scene.file.scene.seed, index));
                twist = Twist { x: twist.x * error.scale(), yaw: twist.yaw + error.yaw_drift() * twist.x, ..twist };
            }
        }
        if let Some(jump) = error.and_then(|error| error.jumped(self.time, time)) {
            self.pose = self.pose.compose(&jump);
        }
        self.time = time;
        self.before = now;
        Odometry { odom_from_base_footprint: self.pose, twist }
    }
}

/// Ticks at a fixed rate from the start to the end, both included. Stamps come from the index, so none drifts.
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

    pub(super) fn time(&self, index: u64) -> f64 {
        seconds(self.offset_ns(index))
    }

    /// The last tick by this time, or the first.
    pub(super) fn last_by(&self, time: f64) -> u64 {
        let mut index = (time * self.rate_hz).max(0.0) as u64 + 1;
        while index > 0 && self.time(index) > time {
            index -= 1;
        }
        index
    }

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
