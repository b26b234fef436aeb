//! Where the robot really is.

use glam::{DQuat, DVec3};

use super::Scene;
use super::effects::Sway;
use crate::geometry::{Euler, Isometry, Pose2};

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
        let travel = self.motion.at(time);
        let mount = self.mount();
        let sway = self.sway_at(time);
        let map_from_base_link = travel.map_from_base_footprint.to_isometry()
            * sway.displacement()
            * Isometry::new(sway.tilt().rotation(), mount.base_footprint_from_base_link.translation);
        let (rate, acceleration) = self.sway_derivatives(time);
        // The footprint goes round a circle; the torso moves sideways on this turntable.
        let (v, w) = (travel.speed, travel.turn);
        let in_footprint = DVec3::new(
            -2.0 * w * rate.lateral,
            v * w + acceleration.lateral - w * w * sway.lateral,
            acceleration.vertical + GRAVITY_M_S2,
        );
        Truth {
            map_from_base_footprint: travel.map_from_base_footprint,
            map_from_base_link,
            map_from_camera_link: map_from_base_link * mount.base_link_from_camera_link,
            twist: Twist { x: v, y: 0.0, yaw: w },
            angular_velocity: body_rates(&sway, &rate, w),
            linear_acceleration: sway.tilt().rotation().conjugate() * in_footprint,
        }
    }

    fn sway_at(&self, time: f64) -> Sway {
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
