//! Fisheye models, whose distance from the principal point is a function of the angle off the axis alone.

use core::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::{LensError, half_fov};
use crate::polynomial;

/// A radially symmetric lens, and the largest angle that it draws.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Radial {
    profile: Profile,
    /// Largest angle off the axis, radians.
    max_angle: f64,
    /// Radius at `max_angle`, in focal lengths.
    max_radius: f64,
}

/// Radius as a function of the angle.
#[derive(Clone, Debug, PartialEq)]
enum Profile {
    /// Coefficients k1 to k4.
    KannalaBrandt([f64; 4]),
    Equisolid,
}

/// Largest number of steps of one inversion. If every Newton step fell back to bisection, 64 steps would exhaust an f64.
const MAX_STEPS: usize = 80;

impl Radial {
    /// Makes a Kannala-Brandt lens.
    ///
    /// `reach` is the distance of the image's farthest corner from the principal point, in focal lengths.
    pub(super) fn kannala_brandt(k: [f64; 4], reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        for (name, value) in ["k1", "k2", "k3", "k4"].into_iter().zip(k) {
            if !value.is_finite() {
                return Err(LensError::NotFinite { name, value });
            }
        }
        let stated = half_fov(fov_deg, 360.0)?;
        let limit = stated.unwrap_or(PI);
        // d r / d theta as a polynomial in theta^2.
        let slope = [1.0, 3.0 * k[0], 5.0 * k[1], 7.0 * k[2], 9.0 * k[3]];
        let turn = polynomial::first_non_positive(&slope, limit * limit).map(libm::sqrt);
        if let (Some(at), Some(fov_deg)) = (turn, fov_deg) {
            return Err(LensError::NotMonotonic { at_deg: at.to_degrees(), fov_deg });
        }
        // Ends just short of the turning point, where the inverse would be infinitely steep.
        let limit = turn.map_or(limit, |at| at * (1.0 - 1e-6));
        Ok(Self::clipped_to_image(Profile::KannalaBrandt(k), limit, reach))
    }

    /// Makes an equisolid lens; `reach` as in [`Self::kannala_brandt`].
    pub(super) fn equisolid(reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        // The radius has its maximum at 180 deg off the axis, the largest angle that exists.
        let limit = half_fov(fov_deg, 360.0)?.unwrap_or(PI);
        Ok(Self::clipped_to_image(Profile::Equisolid, limit, reach))
    }

    /// Clips the largest angle to what the image can show.
    fn clipped_to_image(profile: Profile, limit: f64, reach: f64) -> Self {
        let full = Self { max_angle: limit, max_radius: radius(&profile, limit), profile };
        match full.angle(reach) {
            Some(max_angle) => Self { max_angle, max_radius: reach, ..full },
            None => full,
        }
    }

    /// The largest angle off the axis, radians.
    pub(super) fn max_angle(&self) -> f64 {
        self.max_angle
    }

    /// Distance from the principal point of a ray at this angle in radians, in focal lengths.
    pub(super) fn radius(&self, angle: f64) -> f64 {
        radius(&self.profile, angle)
    }

    /// Projects a ray to a point in focal lengths from the principal point.
    pub(super) fn project(&self, ray: DVec3) -> Option<DVec2> {
        let off_axis = libm::hypot(ray.x, ray.y);
        let angle = libm::atan2(off_axis, ray.z);
        // A ray that is not finite, or zero, has no direction. The margin allows for the rounding of a ray at the rim.
        if !ray.is_finite() || angle > self.max_angle + 1e-12 || ray == DVec3::ZERO {
            return None;
        }
        if off_axis == 0.0 {
            return (ray.z > 0.0).then_some(DVec2::ZERO);
        }
        let scale = radius(&self.profile, angle) / off_axis;
        Some(DVec2::new(ray.x * scale, ray.y * scale))
    }

    /// Finds the unit ray of a point in focal lengths.
    pub(super) fn unproject(&self, point: DVec2) -> Option<DVec3> {
        let r = libm::hypot(point.x, point.y);
        if r == 0.0 {
            return Some(DVec3::Z);
        }
        let (sin, cos) = libm::sincos(self.angle(r)?);
        Some(DVec3::new(point.x / r * sin, point.y / r * sin, cos))
    }

    /// Inverts the profile: the angle that is drawn at radius `r`, by Newton's method that never leaves its bracket.
    fn angle(&self, r: f64) -> Option<f64> {
        if r.is_nan() || r > self.max_radius * (1.0 + 1e-12) {
            return None;
        }
        match &self.profile {
            Profile::Equisolid => Some((2.0 * libm::asin((r / 2.0).min(1.0))).min(self.max_angle)),
            Profile::KannalaBrandt(k) => {
                let (mut low, mut high) = (0.0, self.max_angle);
                let mut angle = r.min(high);
                for _ in 0..MAX_STEPS {
                    let (value, slope) = kannala_brandt(k, angle);
                    let miss = value - r;
                    if miss > 0.0 {
                        high = angle
                    } else {
                        low = angle
                    }
                    let newton = angle - miss / slope;
                    let next = if newton > low && newton < high { newton } else { low + (high - low) / 2.0 };
                    let moved = (next - angle).abs();
                    angle = next;
                    if moved <= f64::EPSILON * angle.max(1e-3) {
                        break;
                    }
                }
                Some(angle)
            }
        }
    }
}

/// Evaluates a profile: the radius in focal lengths at an angle in radians.
fn radius(profile: &Profile, angle: f64) -> f64 {
    match profile {
        Profile::KannalaBrandt(k) => kannala_brandt(k, angle).0,
        Profile::Equisolid => 2.0 * libm::sin(angle / 2.0),
    }
}

/// The radius of the Kannala-Brandt polynomial, and its derivative by the angle.
fn kannala_brandt(k: &[f64; 4], angle: f64) -> (f64, f64) {
    let s = angle * angle;
    let value = angle * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
    let slope = 1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])));
    (value, slope)
}
