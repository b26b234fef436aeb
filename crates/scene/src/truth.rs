//! Where the robot really is.

use glam::{DQuat, DVec3};

use super::Scene;
use super::effects::Sway;
use super::motion::Travel;
use realitysim_geometry::{Euler, Isometry, Pose2};

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// On the ground, without the gait's sway.
    pub map_from_base_footprint: Pose2,
    pub map_from_base_link: Isometry,
    pub map_from_camera_link: Isometry,
    /// Of `base_footprint`, in `base_footprint`.
    pub twist: Twist,
    /// Of `base_link`, in `base_link`: rad/s.
    pub angular_velocity: DVec3,
    /// What an accelerometer in `base_link` measures, gravity included: m/s^2.
    pub linear_acceleration: DVec3,
}

/// m/s forwards and to the left, rad/s to the left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    pub x: f64,
    pub y: f64,
    pub yaw: f64,
}

/// The robot's static transforms, upright.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    pub base_footprint_from_base_link: Isometry,
    pub base_link_from_camera_link: Isometry,
    pub camera_link_from_camera_optical_frame: Isometry,
}

const GRAVITY_M_S2: f64 = 9.806_65;
/// Sway is smooth: differences over this time are exact to 1e-7 of its rates.
const DIFFERENCE_S: f64 = 1e-4;
/// So is being carried, at a tenth of the pace.
const CARRIED_DIFFERENCE_S: f64 = 1e-3;

impl Scene {
    pub fn mount(&self) -> Mount {
        let camera = &self.file.camera;
        let tilt = Euler { pitch: camera.mount_pitch_deg.to_radians(), ..Euler::default() };
        Mount {
            base_footprint_from_base_link: Isometry::new(DQuat::IDENTITY, DVec3::new(0.0, 0.0, camera.torso_height_m)),
            base_link_from_camera_link: Isometry::from_euler(tilt, DVec3::from(camera.mount_xyz_m)),
            camera_link_from_camera_optical_frame: Isometry::link_from_optical(),
        }
    }

    /// At a time in seconds since the start; before it and after the end the robot stands.
    pub fn truth(&self, time: f64) -> Truth {
        let travel = self.travel(time);
        let sway = self.sway_at(time);
        let map_from_base_link = self.base_link_at(time);
        let (twist, linear_acceleration) = match &self.carrying {
            Some(carrying) if carrying.is_under_way(time) => self.felt_in_the_air(time),
            _ => {
                let (rate, acceleration) = self.sway_derivatives(time);
                // The footprint goes round a circle; the torso moves sideways on this turntable.
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
        let angular_velocity = match &self.carrying {
            Some(carrying) if carrying.tumble_at(time).is_some() => self.turned_in_falling(time),
            _ => body_rates(&sway, &rate, twist.yaw),
        };
        Truth {
            map_from_base_footprint: travel.map_from_base_footprint,
            map_from_base_link,
            map_from_camera_link: map_from_base_link * self.camera_at(time),
            twist,
            angular_velocity,
            linear_acceleration,
        }
    }

    pub(super) fn travel(&self, time: f64) -> Travel {
        match &self.carrying {
            None => self.motion.at(time),
            Some(carrying) => carrying.travel(time, self.motion.at(carrying.route_time(time))),
        }
    }

    fn base_link_at(&self, time: f64) -> Isometry {
        let mut displacement = self.sway_at(time).displacement();
        if let Some(carrying) = &self.carrying {
            displacement.translation.z += carrying.lift_at(time);
            if let Some(tumble) = carrying.tumble_at(time) {
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

    /// `base_link_from_camera_link` as the head holds it.
    fn camera_at(&self, time: f64) -> Isometry {
        let mounted = self.mount().base_link_from_camera_link;
        let Some(head) = &self.changing.head else { return mounted };
        let pitch = self.file.camera.mount_pitch_deg.to_radians();
        Isometry::from_euler(head.at(time).camera(pitch), mounted.translation)
    }

    /// By differences: whoever carries the robot follows no formula of ours.
    fn felt_in_the_air(&self, time: f64) -> (Twist, DVec3) {
        let h = CARRIED_DIFFERENCE_S;
        let [before, after] = [-h, h].map(|step| self.travel(time + step).map_from_base_footprint);
        let moved = before.inverse().compose(&after);
        let twist = Twist { x: moved.x / (2.0 * h), y: moved.y / (2.0 * h), yaw: moved.yaw / (2.0 * h) };
        let [p0, p1, p2] = [-h, 0.0, h].map(|step| self.base_link_at(time + step));
        let in_map = (p2.translation - 2.0 * p1.translation + p0.translation) / (h * h);
        let with_gravity = in_map + DVec3::new(0.0, 0.0, GRAVITY_M_S2);
        (twist, p1.rotation.conjugate() * with_gravity)
    }

    /// rad/s, in `base_link`, by differences.
    fn turned_in_falling(&self, time: f64) -> DVec3 {
        let h = CARRIED_DIFFERENCE_S;
        let [before, after] = [-h, h].map(|step| self.base_link_at(time + step).rotation);
        let turned = before.conjugate() * after;
        // A small rotation: twice the vector part is the angle about each axis.
        let side = if turned.w < 0.0 { -1.0 } else { 1.0 };
        DVec3::new(turned.x, turned.y, turned.z) * (2.0 * side / (2.0 * h))
    }

    /// Whoever is carried does not walk: the gait stands still in its step.
    fn sway_at(&self, time: f64) -> Sway {
        let time = self.carrying.as_ref().map_or(time, |carrying| carrying.route_time(time));
        self.sway.as_ref().map_or(Sway::default(), |model| model.at(time))
    }

    /// First and second derivative.
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

/// The gyro's rates of R = Rz(yaw) Ry(pitch) Rx(roll).
fn body_rates(angle: &Sway, rate: &Sway, yaw_rate: f64) -> DVec3 {
    let (sp, cp) = libm::sincos(angle.pitch);
    let (sr, cr) = libm::sincos(angle.roll);
    DVec3::new(rate.roll - yaw_rate * sp, rate.pitch * cr + yaw_rate * sr * cp, -rate.pitch * sr + yaw_rate * cr * cp)
}
