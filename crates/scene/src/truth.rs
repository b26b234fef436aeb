//! The true state of the robot at any time: poses, velocities and what its inertial sensors feel.

use glam::{DQuat, DVec3};

use super::Scene;
use super::effects::Sway;
use super::motion::Travel;
use realitysim_geometry::{Euler, Isometry, Pose2};

/// The true state of the robot at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Pose on the ground, without the sway of the gait.
    pub map_from_base_footprint: Pose2,
    /// Pose of the torso, with sway, lift and fall.
    pub map_from_base_link: Isometry,
    /// Pose of the camera, x along its viewing direction.
    pub map_from_camera_link: Isometry,
    /// Velocity of `base_footprint`, in its own coordinates.
    pub twist: Twist,
    /// Angular velocity of `base_link`, in its own coordinates, rad/s.
    pub angular_velocity: DVec3,
    /// Reading of an ideal accelerometer in `base_link`, gravity included, m/s^2.
    pub linear_acceleration: DVec3,
}

/// Velocity in the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Forwards, m/s.
    pub x: f64,
    /// To the left, m/s.
    pub y: f64,
    /// Turn to the left, rad/s.
    pub yaw: f64,
}

/// The static transforms of the robot when it stands upright.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// The torso above the ground.
    pub base_footprint_from_base_link: Isometry,
    /// The camera in the torso, with the head straight ahead.
    pub base_link_from_camera_link: Isometry,
    /// From optical axes (z forwards, x right, y down) to link axes (x forwards, y left, z up).
    pub camera_link_from_camera_optical_frame: Isometry,
}

/// Standard gravity, m/s^2.
const GRAVITY_M_S2: f64 = 9.806_65;
/// Step of the numerical derivatives of the sway, seconds. The sway is smooth: differences are exact to 1e-7 of its rates.
const DIFFERENCE_S: f64 = 1e-4;
/// Step of the numerical derivatives while the robot is carried or falls, seconds. That motion is ten times slower than the sway.
const INTERRUPTION_DIFFERENCE_S: f64 = 1e-3;

impl Scene {
    /// The true static transforms of the robot.
    pub fn mount(&self) -> Mount {
        let camera = &self.file.camera;
        let tilt = Euler { pitch: camera.mount_pitch_deg.to_radians(), ..Euler::default() };
        Mount {
            base_footprint_from_base_link: Isometry::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, camera.torso_height_m)),
            base_link_from_camera_link: Isometry::from_euler(tilt, DVec3::from(camera.mount_xyz_m)),
            camera_link_from_camera_optical_frame: Isometry::link_from_optical(),
        }
    }

    /// The true state at `time`, seconds since the start. Before the start and after the end the robot stands.
    pub fn truth(&self, time: f64) -> Truth {
        let travel = self.travel(time);
        let sway = self.sway_at(time);
        let map_from_base_link = self.base_link_at(time);
        let (twist, linear_acceleration) = match &self.interruption {
            Some(interruption) if interruption.is_under_way(time) => self.interrupted_twist_and_acceleration(time),
            _ => {
                let (rate, acceleration) = self.sway_derivatives(time);
                // The footprint moves along a circle, and the torso sways sideways in that rotating coordinate frame.
                let (v, w) = (travel.speed, travel.turn);
                let in_footprint = DVec3::new(
                    -2.0 * w * rate.lateral,
                    v * w + acceleration.lateral - w * w * sway.lateral,
                    acceleration.vertical + GRAVITY_M_S2,
                );
                (Twist { x: v, y: 0.0, yaw: w }, sway.tilt().rotation().conjugate() * in_footprint)
            }
        };
        let (rate, _) = self.sway_derivatives(time);
        let angular_velocity = match &self.interruption {
            Some(interruption) if interruption.tumble_at(time).is_some() => self.falling_angular_velocity(time),
            _ => body_rates(&sway, &rate, twist.yaw),
        };
        Truth {
            map_from_base_footprint: travel.map_from_base_footprint,
            map_from_base_link,
            map_from_camera_link: map_from_base_link * self.base_link_from_camera_at(time),
            twist,
            angular_velocity,
            linear_acceleration,
        }
    }

    /// The footprint at `time` (seconds), with kidnapping or fall.
    pub(super) fn travel(&self, time: f64) -> Travel {
        match &self.interruption {
            None => self.motion.at(time),
            Some(interruption) => interruption.travel(time, self.motion.at(interruption.route_time(time))),
        }
    }

    /// `map_from_base_link` at `time`, seconds.
    fn base_link_at(&self, time: f64) -> Isometry {
        let mut displacement = self.sway_at(time).displacement();
        if let Some(interruption) = &self.interruption {
            displacement.translation.z += interruption.lift_at(time);
            if let Some(tumble) = interruption.tumble_at(time) {
                displacement = displacement * tumble;
            }
        }
        self.travel(time).map_from_base_footprint.to_isometry()
            * displacement
            * Isometry::new(
                self.sway_at(time).tilt().rotation(),
                self.mount().base_footprint_from_base_link.translation,
            )
    }

    /// `base_link_from_camera_link` at `time`, with the motion of the head.
    fn base_link_from_camera_at(&self, time: f64) -> Isometry {
        let mounted = self.mount().base_link_from_camera_link;
        let Some(head) = &self.changing.head else { return mounted };
        let pitch = self.file.camera.mount_pitch_deg.to_radians();
        Isometry::from_euler(head.at(time).camera(pitch), mounted.translation)
    }

    /// Twist of the footprint and accelerometer reading while the robot is carried or falls, by numerical differences.
    fn interrupted_twist_and_acceleration(&self, time: f64) -> (Twist, DVec3) {
        let h = INTERRUPTION_DIFFERENCE_S;
        let [before, after] = [-h, h].map(|step| self.travel(time + step).map_from_base_footprint);
        let moved = before.inverse().compose(&after);
        let twist = Twist { x: moved.x / (2.0 * h), y: moved.y / (2.0 * h), yaw: moved.yaw / (2.0 * h) };
        let [p0, p1, p2] = [-h, 0.0, h].map(|step| self.base_link_at(time + step));
        let in_map = (p2.translation - 2.0 * p1.translation + p0.translation) / (h * h);
        let with_gravity = in_map + DVec3::new(0.0, 0.0, GRAVITY_M_S2);
        (twist, p1.rotation.conjugate() * with_gravity)
    }

    /// Angular velocity of `base_link` during a fall, in its own coordinates, rad/s, by numerical differences.
    fn falling_angular_velocity(&self, time: f64) -> DVec3 {
        let h = INTERRUPTION_DIFFERENCE_S;
        let [before, after] = [-h, h].map(|step| self.base_link_at(time + step).rotation);
        let turned = before.conjugate() * after;
        // For a small rotation, twice the vector part of the quaternion is the angle about each axis.
        let side = if turned.w < 0.0 { -1.0 } else { 1.0 };
        DVec3::new(turned.x, turned.y, turned.z) * (2.0 * side / (2.0 * h))
    }

    /// Sway of the torso at `time`. A robot that is carried or has fallen does not walk, so its gait is frozen.
    fn sway_at(&self, time: f64) -> Sway {
        let time = self.interruption.as_ref().map_or(time, |interruption| interruption.route_time(time));
        self.sway.as_ref().map_or(Sway::default(), |model| model.at(time))
    }

    /// First and second derivative of the sway with respect to time.
    fn sway_derivatives(&self, time: f64) -> (Sway, Sway) {
        if self.sway.is_none() {
            return (Sway::default(), Sway::default());
        }
        let [before, now, after] = [-DIFFERENCE_S, 0.0, DIFFERENCE_S].map(|step| self.sway_at(time + step));
        let first = |pick: fn(&Sway) -> f64| (pick(&after) - pick(&before)) / (2.0 * DIFFERENCE_S);
        let second =
            |pick: fn(&Sway) -> f64| (pick(&after) - 2.0 * pick(&now) + pick(&before)) / (DIFFERENCE_S * DIFFERENCE_S);
        let all = |of: &dyn Fn(fn(&Sway) -> f64) -> f64| Sway {
            roll: of(|s| s.roll),
            pitch: of(|s| s.pitch),
            lateral: of(|s| s.lateral),
            vertical: of(|s| s.vertical),
        };
        (all(&first), all(&second))
    }
}

impl Sway {
    fn tilt(&self) -> Euler {
        Euler { yaw: 0.0, pitch: self.pitch, roll: self.roll }
    }

    fn displacement(&self) -> Isometry {
        Isometry::new(DQuat::IDENTITY, DVec3::new(0.0, self.lateral, self.vertical))
    }
}

/// Angular velocity in body coordinates, rad/s, of the rotation R = Rz(yaw) Ry(pitch) Rx(roll).
fn body_rates(angle: &Sway, rate: &Sway, yaw_rate: f64) -> DVec3 {
    let (sp, cp) = libm::sincos(angle.pitch);
    let (sr, cr) = libm::sincos(angle.roll);
    DVec3::new(rate.roll - yaw_rate * sp, rate.pitch * cr + yaw_rate * sr * cp, -rate.pitch * sr + yaw_rate * cr * cp)
}
