//! Fisheye models, whose distance from the principal point is a function of the angle off the axis alone.

use core::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::{LensError, check_coefficients, half_fov};
use crate::monotonic::find_root;
use crate::polynomial;

/// A radially symmetric lens, and the largest angle that it draws.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Radial {
    profile: Profile,
    /// Largest angle off the axis, radians.
    max_angle: f64,
    /// Radius at `max_angle`, in focal lengths.
    max_radius: f64,
    /// What a point's row adds to its column, both in focal lengths: pixels whose axes are not perpendicular.
    skew: f64,
}

/// Radius as a function of the angle.
#[derive(Clone, Debug, PartialEq)]
enum Profile {
    /// Coefficients k1 to k4.
    KannalaBrandt([f64; 4]),
    Equisolid,
    /// Offset xi and blend alpha of Usenko et al. 2018.
    DoubleSphere {
        xi: f64,
        alpha: f64,
    },
    /// Blend alpha and shape beta of Khomutenko et al. 2016.
    Eucm {
        alpha: f64,
        beta: f64,
    },
    /// Coefficients c2 to c6, and the radius where the lens ends.
    Scaramuzza {
        c: [f64; 5],
        end: f64,
    },
}

/// Largest magnitude of xi. At 1 the spheres touch, and all of the half space behind falls on one ray.
const MAX_XI: f64 = 1.0 - 1e-6;
/// Largest magnitude of a skew. Calibrations have some thousandths.
const MAX_SKEW: f64 = 0.1;
/// Range of beta. Calibrations have 0.1 to 10; sums of a smaller or larger one lose digits.
const BETA: core::ops::RangeInclusive<f64> = 1e-6..=1e6;

impl Radial {
    /// Makes a Kannala-Brandt lens.
    ///
    /// `reach` is the distance of the image's farthest corner from the principal point, in focal lengths.
    pub(super) fn kannala_brandt(k: [f64; 4], reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        check_coefficients(["k1", "k2", "k3", "k4"].into_iter().zip(&k))?;
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

    /// Makes a double sphere lens; `reach` as in [`Self::kannala_brandt`].
    pub(super) fn double_sphere(xi: f64, alpha: f64, reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        check("xi", xi, -MAX_XI..=MAX_XI, "above -1 and below 1, within 1e-6")?;
        check("alpha", alpha, 0.0..=1.0, "0 to 1")?;
        let phi = last_sphere_angle(alpha);
        Self::of_spheres(Profile::DoubleSphere { xi, alpha }, phi + libm::asin(xi * libm::sin(phi)), reach, fov_deg)
    }

    /// Makes a lens of the enhanced unified camera model; `reach` as in [`Self::kannala_brandt`].
    pub(super) fn eucm(alpha: f64, beta: f64, reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        check("alpha", alpha, 0.0..=1.0, "0 to 1")?;
        check("beta", beta, BETA, "1e-6 to 1e6")?;
        let (sin, cos) = libm::sincos(last_sphere_angle(alpha));
        let last = libm::atan2(sin / libm::sqrt(beta), cos);
        Self::of_spheres(Profile::Eucm { alpha, beta }, last, reach, fov_deg)
    }

    /// Makes a lens that is monotonic up to `last`, radians.
    fn of_spheres(profile: Profile, last: f64, reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        let stated = half_fov(fov_deg, 360.0)?;
        // Ends just short of where the radius turns back or becomes infinite.
        let last = last * (1.0 - 1e-6);
        match (stated, fov_deg) {
            (Some(half), Some(fov_deg)) if half > last => {
                Err(LensError::NotMonotonic { at_deg: last.to_degrees(), fov_deg })
            }
            _ => Ok(Self::clipped_to_image(profile, stated.unwrap_or(last), reach)),
        }
    }

    /// Makes a lens of Scaramuzza's polynomial c2 to c6; `reach` as in [`Self::kannala_brandt`].
    pub(super) fn scaramuzza(c: [f64; 5], skew: f64, reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        check_coefficients(["c2", "c3", "c4", "c5", "c6"].into_iter().zip(&c))?;
        check("skew", skew, -MAX_SKEW..=MAX_SKEW, "within -0.1 and 0.1")?;
        let stated = half_fov(fov_deg, 360.0)?;
        // With g = 1 + c2 r^2 + ..., d theta / d r has the sign of g - r g'.
        let [c2, c3, c4, c5, c6] = c;
        let slope = [1.0, 0.0, -c2, -2.0 * c3, -3.0 * c4, -4.0 * c5, -5.0 * c6];
        let corner = reach * (1.0 + skew.abs());
        let turn = polynomial::first_non_positive(&slope, corner);
        let end = turn.map_or(corner, |at| at * (1.0 - 1e-6));
        let seen = scaramuzza_angle(&c, end);
        if let (Some(_), Some(half), Some(fov_deg)) = (turn, stated, fov_deg)
            && half > seen
        {
            return Err(LensError::NotMonotonic { at_deg: seen.to_degrees(), fov_deg });
        }
        let profile = Profile::Scaramuzza { c, end };
        let max_angle = stated.map_or(seen, |half| half.min(seen));
        let max_radius = radius(&profile, max_angle);
        Ok(Self { profile, max_angle, max_radius, skew })
    }

    /// What a point's row adds to its column, both in focal lengths.
    pub(super) fn skew(&self) -> f64 {
        self.skew
    }

    /// Clips the largest angle to what the image can show.
    fn clipped_to_image(profile: Profile, limit: f64, reach: f64) -> Self {
        let full = Self { max_angle: limit, max_radius: radius(&profile, limit), profile, skew: 0.0 };
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

    /// The derivative of the radius by the angle on the axis, in focal lengths per radian.
    pub(super) fn slope_on_axis(&self) -> f64 {
        match self.profile {
            Profile::DoubleSphere { xi, .. } => 1.0 / (1.0 + xi),
            Profile::KannalaBrandt(_) | Profile::Equisolid | Profile::Eucm { .. } | Profile::Scaramuzza { .. } => 1.0,
        }
    }

    /// Whether the radius can grow so steeply inside the model's range that no table follows.
    pub(super) fn can_be_steep(&self) -> bool {
        !matches!(self.profile, Profile::KannalaBrandt(_) | Profile::Equisolid)
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
        let point = DVec2::new(ray.x * scale, ray.y * scale);
        Some(if self.skew == 0.0 { point } else { DVec2::new(point.x + self.skew * point.y, point.y) })
    }

    /// Finds the unit ray of a point in focal lengths.
    pub(super) fn unproject(&self, point: DVec2) -> Option<DVec3> {
        let point = if self.skew == 0.0 { point } else { DVec2::new(point.x - self.skew * point.y, point.y) };
        let r = libm::hypot(point.x, point.y);
        if r == 0.0 {
            return Some(DVec3::Z);
        }
        let (sin, cos) = libm::sincos(self.angle(r)?);
        Some(DVec3::new(point.x / r * sin, point.y / r * sin, cos))
    }

    /// Inverts the profile: the angle that is drawn at radius `r`.
    fn angle(&self, r: f64) -> Option<f64> {
        if r.is_nan() || r > self.max_radius * (1.0 + 1e-12) {
            return None;
        }
        match &self.profile {
            Profile::Equisolid => Some((2.0 * libm::asin((r / 2.0).min(1.0))).min(self.max_angle)),
            Profile::DoubleSphere { xi, alpha } => {
                let phi = sphere_angle(*alpha, r);
                Some((phi + libm::asin(xi * libm::sin(phi))).min(self.max_angle))
            }
            Profile::Eucm { alpha, beta } => {
                let root = libm::sqrt(*beta);
                let (sin, cos) = libm::sincos(sphere_angle(*alpha, r * root));
                Some(libm::atan2(sin / root, cos).min(self.max_angle))
            }
            Profile::Scaramuzza { c, .. } => Some(scaramuzza_angle(c, r).min(self.max_angle)),
            Profile::KannalaBrandt(k) => Some(find_root(r, self.max_angle, |angle| {
                let (value, slope) = kannala_brandt(k, angle);
                [value - r, slope]
            })),
        }
    }
}

/// Evaluates a profile: the radius in focal lengths at an angle in radians.
fn radius(profile: &Profile, angle: f64) -> f64 {
    match profile {
        Profile::KannalaBrandt(k) => kannala_brandt(k, angle).0,
        Profile::Equisolid => 2.0 * libm::sin(angle / 2.0),
        Profile::DoubleSphere { xi, alpha } => {
            let (sin, cos) = libm::sincos(angle);
            let depth = xi + cos;
            sin / (alpha * libm::hypot(sin, depth) + (1.0 - alpha) * depth)
        }
        Profile::Eucm { alpha, beta } => {
            let (sin, cos) = libm::sincos(angle);
            sin / (alpha * libm::hypot(libm::sqrt(*beta) * sin, cos) + (1.0 - alpha) * cos)
        }
        Profile::Scaramuzza { c, end } => scaramuzza_radius(c, *end, angle),
    }
}

/// Scaramuzza's polynomial g(r) = 1 + c2 r^2 + ... + c6 r^6, and its derivative.
fn scaramuzza(c: &[f64; 5], r: f64) -> [f64; 2] {
    let [c2, c3, c4, c5, c6] = c;
    let value = 1.0 + r * r * (c2 + r * (c3 + r * (c4 + r * (c5 + r * c6))));
    [value, r * (2.0 * c2 + r * (3.0 * c3 + r * (4.0 * c4 + r * (5.0 * c5 + r * 6.0 * c6))))]
}

/// The angle that Scaramuzza's polynomial sees at a radius, radians.
fn scaramuzza_angle(c: &[f64; 5], r: f64) -> f64 {
    libm::atan2(r, scaramuzza(c, r)[0])
}

/// Inverts [`scaramuzza_angle`] for a radius up to `end`.
///
/// The function r cos theta - g(r) sin theta has the sign of the radius' angle less theta, and needs no arc tangent.
fn scaramuzza_radius(c: &[f64; 5], end: f64, angle: f64) -> f64 {
    let (sin, cos) = libm::sincos(angle);
    find_root(angle, end, |r| {
        let [value, slope] = scaramuzza(c, r);
        [r * cos - value * sin, cos - slope * sin]
    })
}

/// The angle phi, seen from the centre of the last sphere, up to which r = sin phi / (alpha + (1 - alpha) cos phi) rises.
///
/// Double sphere and the enhanced unified model end with this projection. It turns back where cos phi = -(1 - alpha) / alpha, or
/// becomes infinite where cos phi = -alpha / (1 - alpha), whichever is nearer.
fn last_sphere_angle(alpha: f64) -> f64 {
    let ratio = if alpha <= 0.5 { alpha / (1.0 - alpha) } else { (1.0 - alpha) / alpha };
    libm::acos(-ratio)
}

/// Inverts r = sin phi / (alpha + (1 - alpha) cos phi) for phi; beyond the largest radius it gives the angle of the largest.
///
/// With t = tan(phi / 2) this is (2 alpha - 1) r t^2 - 2 t + r = 0, of which the smaller root is taken without cancellation.
fn sphere_angle(alpha: f64, r: f64) -> f64 {
    2.0 * libm::atan(r / (1.0 + libm::sqrt((1.0 - (2.0 * alpha - 1.0) * r * r).max(0.0))))
}

/// Checks a coefficient against its range.
fn check(
    name: &'static str,
    value: f64,
    range: core::ops::RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), LensError> {
    if range.contains(&value) { Ok(()) } else { Err(LensError::Coefficient { name, value, expected }) }
}

/// The radius of the Kannala-Brandt polynomial, and its derivative by the angle.
fn kannala_brandt(k: &[f64; 4], angle: f64) -> (f64, f64) {
    let s = angle * angle;
    let value = angle * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * k[3]))));
    let slope = 1.0 + s * (3.0 * k[0] + s * (5.0 * k[1] + s * (7.0 * k[2] + s * 9.0 * k[3])));
    (value, slope)
}
