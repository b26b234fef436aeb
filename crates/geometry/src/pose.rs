//! Rigid transforms, planar poses and the tag's Euler angles.

use core::f64::consts::{FRAC_PI_2, PI};
use core::ops::Mul;

use glam::{DAffine2, DMat2, DMat3, DQuat, DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::wrap_angle;

/// A rigid transform `a_from_b`: a point given in frame b, expressed in frame a.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Isometry {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Metres.
    pub translation: DVec3,
}

/// Yaw, pitch and roll in radians: R = Rz(yaw) Ry(pitch) Rx(roll), so pitch > 0 looks down (REP 103).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Euler {
    pub yaw: f64,
    pub pitch: f64,
    pub roll: f64,
}

/// A pose in the plane of the field: metres and radians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose2 {
    pub x: f64,
    pub y: f64,
    pub yaw: f64,
}

/// How fast a frame moves, along its own axes (`geometry_msgs/Twist`): metres and radians per second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    pub linear: DVec3,
    pub angular: DVec3,
}

impl Twist {
    pub const ZERO: Self = Self { linear: DVec3::ZERO, angular: DVec3::ZERO };

    /// Where the moving frame is some seconds after it was at `pose`.
    pub fn carries(&self, pose: &Isometry, seconds: f64) -> Isometry {
        Isometry::new(
            pose.rotation * DQuat::from_scaled_axis(self.angular * seconds),
            pose.transform_point(self.linear * seconds),
        )
    }

    /// How fast what stands still at `place` goes by, in the moving frame, metres per second.
    pub fn passing(&self, place: DVec3) -> DVec3 {
        -self.linear - self.angular.cross(place)
    }
}

impl Isometry {
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// The rotation is normalised; one without a direction (zero or not finite) becomes the identity.
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        let length = rotation.length();
        let rotation = if length.is_finite() && length > 1e-12 { rotation * (1.0 / length) } else { DQuat::IDENTITY };
        Self { rotation, translation }
    }

    pub fn from_euler(euler: Euler, translation: DVec3) -> Self {
        Self { rotation: euler.rotation(), translation }
    }

    /// `camera_link` from `camera_optical_frame` (REP 103): z forward, x right, y down becomes x forward, y left, z up.
    pub fn link_from_optical() -> Self {
        Self { rotation: DQuat::from_xyzw(0.5, -0.5, 0.5, -0.5), translation: DVec3::ZERO }
    }

    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self { rotation, translation: rotation * -self.translation }
    }

    pub fn transform_point(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    pub fn transform_vector(&self, vector: DVec3) -> DVec3 {
        self.rotation * vector
    }

    pub fn euler(&self) -> Euler {
        Euler::from_rotation(self.rotation)
    }

    /// The same pose seen from the other goal: turned by half a turn about the field's centre.
    pub fn mirrored(&self) -> Self {
        let half_turn = DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0);
        Self { rotation: half_turn * self.rotation, translation: half_turn * self.translation }
    }

    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite()
    }

    /// Between `self` (fraction 0) and `other` (fraction 1): positions linearly, rotations along the shorter arc.
    pub fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Self::new(
            interpolate_rotation(self.rotation, other.rotation, fraction),
            self.translation + (other.translation - self.translation) * fraction,
        )
    }
}

impl Mul for Isometry {
    type Output = Self;

    /// `a_from_c = a_from_b * b_from_c`. Renormalised, so that long chains stay rigid.
    fn mul(self, rhs: Self) -> Self {
        Self::new(self.rotation * rhs.rotation, self.transform_point(rhs.translation))
    }
}

/// Normalised linear interpolation along the shorter arc; the angle error against slerp is below
/// 1e-4 rad for steps under 0.3 rad, which sensor samples stay within.
fn interpolate_rotation(a: DQuat, b: DQuat, fraction: f64) -> DQuat {
    let b = if a.dot(b) < 0.0 { -b } else { b };
    a * (1.0 - fraction) + b * fraction
}

impl Euler {
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

    /// Looking straight up or down, where yaw and roll turn about the same axis, roll is 0.
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
        // Near there yaw is uncertain, but any will do: roll is what is left of the rotation after it.
        let (s, c) = libm::sincos(yaw);
        let roll = libm::atan2(s * m.z_axis.x - c * m.z_axis.y, c * m.y_axis.y - s * m.y_axis.x);
        Self { yaw, pitch, roll }
    }
}

impl Pose2 {
    pub fn new(x: f64, y: f64, yaw: f64) -> Self {
        Self { x, y, yaw }
    }

    /// The same pose seen from the other goal: the field's 180 degree symmetry.
    pub fn mirrored(&self) -> Self {
        Self { x: -self.x, y: -self.y, yaw: wrap_angle(self.yaw + PI) }
    }

    /// `a_from_c = a_from_b.compose(b_from_c)`.
    pub fn compose(&self, rhs: &Self) -> Self {
        let (s, c) = libm::sincos(self.yaw);
        Self {
            x: self.x + c * rhs.x - s * rhs.y,
            y: self.y + s * rhs.x + c * rhs.y,
            yaw: wrap_angle(self.yaw + rhs.yaw),
        }
    }

    pub fn inverse(&self) -> Self {
        let (s, c) = libm::sincos(self.yaw);
        Self { x: -c * self.x - s * self.y, y: s * self.x - c * self.y, yaw: wrap_angle(-self.yaw) }
    }

    /// For moving many points by it.
    pub fn to_affine(&self) -> DAffine2 {
        let (s, c) = libm::sincos(self.yaw);
        DAffine2 {
            matrix2: DMat2::from_cols(DVec2::new(c, s), DVec2::new(-s, c)),
            translation: DVec2::new(self.x, self.y),
        }
    }

    pub fn distance(&self, other: &Self) -> f64 {
        libm::hypot(self.x - other.x, self.y - other.y)
    }

    pub fn to_isometry(&self) -> Isometry {
        Isometry::from_euler(Euler { yaw: self.yaw, ..Euler::default() }, DVec3::new(self.x, self.y, 0.0))
    }

    /// Drops height and tilt.
    pub fn from_isometry(pose: &Isometry) -> Self {
        Self { x: pose.translation.x, y: pose.translation.y, yaw: pose.euler().yaw }
    }

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
