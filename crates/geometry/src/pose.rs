//! Rigid transformations, planar poses, twists and Euler angles.

use core::f64::consts::{FRAC_PI_2, PI};
use core::ops::Mul;

use glam::{DAffine2, DMat2, DMat3, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::wrap_angle;

/// A rigid transformation `a_from_b`: it turns coordinates of frame b into those of frame a. It is also the pose of b in a.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Isometry {
    /// Rotation part, a unit quaternion.
    pub rotation: DQuat,
    /// Origin of b in coordinates of a, metres.
    pub translation: DVec3,
}

/// Euler angles of the rotation R = Rz(yaw) Ry(pitch) Rx(roll), in radians (REP 103).
///
/// With x forward and z up, positive yaw turns left and positive pitch looks down.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Euler {
    /// Rotation about z, radians.
    pub yaw: f64,
    /// Rotation about y, radians.
    pub pitch: f64,
    /// Rotation about x, radians.
    pub roll: f64,
}

/// A pose in the plane of the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose2 {
    /// Position along x, metres.
    pub x: f64,
    /// Position along y, metres.
    pub y: f64,
    /// Heading, counter-clockwise from the x axis, radians.
    pub yaw: f64,
}

/// Velocity of a moving coordinate frame, in its own axes (`geometry_msgs/Twist`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Linear velocity, metres per second.
    pub linear: DVec3,
    /// Angular velocity, radians per second.
    pub angular: DVec3,
}

impl Twist {
    /// The twist of a frame that stands still.
    pub const ZERO: Self = Self { linear: DVec3::ZERO, angular: DVec3::ZERO };

    /// Predicts the pose of the moving frame `seconds` after it was at `pose`, the twist being constant (to first order in time).
    pub fn carries(&self, pose: &Isometry, seconds: f64) -> Isometry {
        Isometry::new(
            pose.rotation * DQuat::from_scaled_axis(self.angular * seconds),
            pose.transform_point(self.linear * seconds),
        )
    }

    /// Velocity relative to the moving frame of a point that is at rest in the world, metres per second.
    ///
    /// `place` is the point in coordinates of the moving frame.
    pub fn passing(&self, place: DVec3) -> DVec3 {
        -self.linear - self.angular.cross(place)
    }
}

impl Isometry {
    /// The transformation that changes nothing.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// Makes a transformation and normalises its rotation. A quaternion of length zero, or one that is not finite, becomes the identity.
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        let length = rotation.length();
        let rotation = if length.is_finite() && length > 1e-12 { rotation * (1.0 / length) } else { DQuat::IDENTITY };
        Self { rotation, translation }
    }

    /// Makes a transformation from Euler angles and a translation in metres.
    pub fn from_euler(euler: Euler, translation: DVec3) -> Self {
        Self { rotation: euler.rotation(), translation }
    }

    /// The transformation to `camera_link` (x forward, y left, z up) from `camera_optical_frame` (z forward, x right, y down), REP 103.
    pub fn link_from_optical() -> Self {
        Self { rotation: DQuat::from_xyzw(0.5, -0.5, 0.5, -0.5), translation: DVec3::ZERO }
    }

    /// The inverse transformation: `b_from_a` of `a_from_b`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { rotation, translation: rotation * -self.translation }
    }

    /// Turns the coordinates of a point in frame b into those in frame a.
    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// Rotates a direction or difference of points from frame b into frame a.
    pub fn transform_vector(&self, vector: DVec3) -> DVec3 {
        self.rotation * vector
    }

    /// Euler angles of the rotation, see [`Euler::from_rotation`].
    pub fn euler(&self) -> Euler {
        Euler::from_rotation(self.rotation)
    }

    /// The pose turned by 180 degrees about the field's centre, which looks the same on the lines of a field.
    pub fn mirrored(&self) -> Self {
        let half_turn = DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0);
        Self { rotation: half_turn * self.rotation, translation: half_turn * self.translation }
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite()
    }

    /// Interpolates between `self` (fraction 0) and `other` (fraction 1): positions linearly, rotations along the shorter arc.
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Self::new(
            interpolate_rotation(self.rotation, other.rotation, fraction),
            self.translation + (other.translation - self.translation) * fraction,
        )
    }
}

impl Mul for Isometry {
    type Output = Self;

    /// Chains two transformations: `a_from_c = a_from_b * b_from_c`. The rotation is renormalised, so that long chains stay rigid.
    fn mul(self, rhs: Self) -> Self {
        Self::new(self.rotation * rhs.rotation, self.transform_point(rhs.translation))
    }
}

/// Interpolates linearly along the shorter arc; the caller normalises.
///
/// The angle error against slerp is below 1e-4 rad for steps under 0.3 rad, which sensor samples stay within.
fn interpolate_rotation(a: DQuat, b: DQuat, fraction: f64) -> DQuat {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    a * (1.0 - fraction) + b * fraction
}

impl Euler {
    /// The rotation Rz(yaw) Ry(pitch) Rx(roll) as a unit quaternion.
    pub fn rotation(&self) -> DQuat {
        let (sy, cy) = libm::sincos(self.yaw / 2.0);
        let (sp, cp) = libm::sincos(self.pitch / 2.0);
        let (sr, cr) = libm::sincos(self.roll / 2.0);
        DQuat::from_xyzw(
            cy * cp * sr - sy * sp * cr,
            cy * sp * cr + sy * cp * sr,
            sy * cp * cr - cy * sp * sr,
            cy * cp * cr + sy * sp * sr,
        )
    }

    /// The Euler angles of a rotation: yaw and roll in [-pi, pi], pitch in [-pi/2, pi/2].
    ///
    /// In gimbal lock (straight up or down), where yaw and roll turn about the same axis, roll is 0.
    pub fn from_rotation(rotation: DQuat) -> Self {
        let m = DMat3::from_quat(rotation);
        let sin_pitch = -m.x_axis.z;
        let cos_pitch = libm::hypot(m.x_axis.x, m.x_axis.y);
        let pitch = libm::atan2(sin_pitch, cos_pitch).clamp(-FRAC_PI_2, FRAC_PI_2);
        if cos_pitch < 1e-12 {
            return Self { yaw: libm::atan2(-m.y_axis.x, m.y_axis.y), pitch, roll: 0.0 };
        }
        let yaw = libm::atan2(m.x_axis.y, m.x_axis.x);
        if cos_pitch > 0.01 {
            return Self { yaw, pitch, roll: libm::atan2(m.y_axis.z, m.z_axis.z) };
        }
        // Near gimbal lock yaw is uncertain, but any yaw will do: roll is what is left of the rotation after it.
        let (s, c) = libm::sincos(yaw);
        let roll = libm::atan2(s * m.z_axis.x - c * m.z_axis.y, c * m.y_axis.y - s * m.y_axis.x);
        Self { yaw, pitch, roll }
    }
}

impl Pose2 {
    /// Makes a pose of x and y in metres and yaw in radians.
    pub fn new(x: f64, y: f64, yaw: f64) -> Self {
        Self { x, y, yaw }
    }

    /// The pose turned by 180 degrees about the field's centre, which looks the same on the lines of a field.
    pub fn mirrored(&self) -> Self {
        Self { x: -self.x, y: -self.y, yaw: wrap_angle(self.yaw + PI) }
    }

    /// Chains two poses: `a_from_c = a_from_b.compose(b_from_c)`.
    pub fn compose(&self, rhs: &Self) -> Self {
        let (s, c) = libm::sincos(self.yaw);
        Self {
            x: self.x + c * rhs.x - s * rhs.y,
            y: self.y + s * rhs.x + c * rhs.y,
            yaw: wrap_angle(self.yaw + rhs.yaw),
        }
    }

    /// The inverse pose: `b_from_a` of `a_from_b`.
    pub fn inverse(&self) -> Self {
        let (s, c) = libm::sincos(self.yaw);
        Self { x: -c * self.x - s * self.y, y: s * self.x - c * self.y, yaw: wrap_angle(-self.yaw) }
    }

    /// The same transformation as an affine matrix, which moves many points faster.
    pub fn to_affine(&self) -> DAffine2 {
        let (s, c) = libm::sincos(self.yaw);
        DAffine2 {
            matrix2: DMat2::from_cols(DVec2::new(c, s), DVec2::new(-s, c)),
            translation: DVec2::new(self.x, self.y),
        }
    }

    /// Distance between the positions, metres.
    pub fn distance(&self, other: &Self) -> f64 {
        libm::hypot(self.x - other.x, self.y - other.y)
    }

    /// The same pose in space, at height 0 and without tilt.
    pub fn to_isometry(&self) -> Isometry {
        Isometry::from_euler(Euler { yaw: self.yaw, ..Euler::default() }, DVec3::new(self.x, self.y, 0.0))
    }

    /// The planar part of a pose in space: height and tilt are dropped.
    pub fn from_isometry(pose: &Isometry) -> Self {
        Self { x: pose.translation.x, y: pose.translation.y, yaw: pose.euler().yaw }
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.yaw.is_finite()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn angle_between(a: DQuat, b: DQuat) -> f64 {
        let d = a.conjugate() * b;
        2.0 * libm::atan2(d.xyz().length(), d.w.abs())
    }

    #[test]
    fn pitch_looks_down() {
        let pose = Isometry::from_euler(Euler { pitch: 0.5, ..Euler::default() }, DVec3::ZERO);
        assert!(pose.transform_vector(DVec3::X).z < -0.4);
    }

    #[test]
    fn optical_axes_are_right_down_forward() {
        let link_from_optical = Isometry::link_from_optical();
        assert!((link_from_optical.transform_vector(DVec3::Z) - DVec3::X).length() < 1e-15);
        assert!((link_from_optical.transform_vector(DVec3::X) + DVec3::Y).length() < 1e-15);
        assert!((link_from_optical.transform_vector(DVec3::Y) + DVec3::Z).length() < 1e-15);
    }

    #[test]
    fn a_zero_quaternion_is_no_rotation() {
        let pose = Isometry::new(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), DVec3::ONE);
        assert_eq!(pose.rotation, DQuat::IDENTITY);
    }

    proptest! {
        #[test]
        fn euler_angles_give_the_rotation_back(yaw in -3.2..3.2f64, pitch in -FRAC_PI_2 + 1e-7..FRAC_PI_2 - 1e-7, roll in -3.2..3.2f64) {
            let rotation = Euler { yaw, pitch, roll }.rotation();
            prop_assert!(angle_between(rotation, Euler::from_rotation(rotation).rotation()) < 1e-11);
        }

        #[test]
        fn straight_up_and_down_keep_the_rotation(yaw in -3.2..3.2f64, roll in -3.2..3.2f64, down in any::<bool>()) {
            let pitch = if down { FRAC_PI_2 } else { -FRAC_PI_2 };
            let rotation = Euler { yaw, pitch, roll }.rotation();
            let euler = Euler::from_rotation(rotation);
            prop_assert!(angle_between(rotation, euler.rotation()) < 1e-11);
        }

        #[test]
        fn inverse_undoes(yaw in -3.2..3.2f64, pitch in -1.5..1.5f64, x in -9.0..9.0f64, z in -9.0..9.0f64) {
            let pose = Isometry::from_euler(Euler { yaw, pitch, roll: 0.3 }, DVec3::new(x, 1.0, z));
            let round = pose * pose.inverse();
            prop_assert!(round.translation.length() < 1e-13);
            prop_assert!(angle_between(round.rotation, DQuat::IDENTITY) < 1e-13);
        }

        #[test]
        fn planar_composition_is_the_isometry_s(x in -9.0..9.0f64, y in -9.0..9.0f64, yaw in -3.1..3.1f64, turn in -3.1..3.1f64) {
            let (a, b) = (Pose2::new(x, y, yaw), Pose2::new(y, -x, turn));
            let planar = a.compose(&b);
            let spatial = Pose2::from_isometry(&(a.to_isometry() * b.to_isometry()));
            prop_assert!(planar.distance(&spatial) < 1e-12);
            prop_assert!(wrap_angle(planar.yaw - spatial.yaw).abs() < 1e-12);
            let back = planar.compose(&planar.inverse());
            prop_assert!(libm::hypot(back.x, back.y) < 1e-12 && back.yaw.abs() < 1e-12);
        }
    }
}
