//! The pinhole model with `plumb_bob` distortion: radial k1, k2, k3 and tangential p1, p2 (OpenCV's calibration model).

use glam::{DVec2, DVec3};

use super::{LensError, half_fov};
use crate::polynomial;

/// A pinhole with distortion, and the largest angle that it draws.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PlumbBob {
    /// Radial coefficients k1, k2, k3.
    k: [f64; 3],
    /// Tangential coefficients p1, p2.
    p: [f64; 2],
    /// Largest undistorted radius, the tangent of the largest angle off the axis.
    max_radius: f64,
}

/// Largest field of view, degrees. A pinhole image means nothing beyond 89.5 degrees off the axis.
const MAX_FOV_DEG: f64 = 179.0;
/// Largest number of Newton steps of one inversion.
const MAX_STEPS: usize = 50;
/// Largest distance of the distorted result from the requested point, in focal lengths: 1e-11 px at 1000 px.
const TOLERANCE: f64 = 1e-14;

impl PlumbBob {
    /// Checks the coefficients k1, k2, p1, p2, k3 and finds the angle up to which the lens draws.
    ///
    /// `reach` is the distance of the image's farthest corner from the principal point, in focal lengths.
    pub(super) fn new(d: [f64; 5], reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        let [k1, k2, p1, p2, k3] = d;
        for (name, value) in ["k1", "k2", "p1", "p2", "k3"].into_iter().zip(d) {
            if !value.is_finite() {
                return Err(LensError::NotFinite { name, value });
            }
        }
        let stated = half_fov(fov_deg, MAX_FOV_DEG)?.map(libm::tan);
        let limit = stated.unwrap_or_else(|| libm::tan((MAX_FOV_DEG / 2.0).to_radians()));
        // d r_distorted / d r as a polynomial in r^2.
        let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3];
        let turn = polynomial::first_non_positive(&slope, limit * limit).map(libm::sqrt);
        if let (Some(at), Some(fov_deg)) = (turn, fov_deg) {
            return Err(LensError::NotMonotonic { at_deg: libm::atan(at).to_degrees(), fov_deg });
        }
        let limit = turn.map_or(limit, |at| at * (1.0 - 1e-6));
        let mut lens = Self { k: [k1, k2, k3], p: [p1, p2], max_radius: limit };
        // Up to the image's corner, with room for what the tangential terms add.
        if let Some(corner) = lens.undistorted_radius(reach * (1.0 + 4.0 * (p1.abs() + p2.abs()) * reach)) {
            lens.max_radius = corner;
        }
        Ok(lens)
    }

    /// The largest angle off the axis, radians.
    pub(super) fn max_angle(&self) -> f64 {
        libm::atan(self.max_radius)
    }

    /// Projects a ray to a point in focal lengths from the principal point.
    pub(super) fn project(&self, ray: DVec3) -> Option<DVec2> {
        let point = DVec2::new(ray.x / ray.z, ray.y / ray.z);
        let inside = ray.z > 0.0 && ray.z.is_finite() && point.length() <= self.max_radius * (1.0 + 1e-12);
        inside.then(|| self.distort(point).0)
    }

    /// Finds the unit ray of a point in focal lengths: Newton's method in two dimensions, from the exact inverse of the radial part.
    pub(super) fn unproject(&self, target: DVec2) -> Option<DVec3> {
        let r = libm::hypot(target.x, target.y);
        if r == 0.0 && self.p == [0.0; 2] {
            return Some(DVec3::Z);
        }
        let start = self.undistorted_radius(r).unwrap_or(self.max_radius);
        let mut point = if r > 0.0 { target * (start / r) } else { DVec2::ZERO };
        for _ in 0..MAX_STEPS {
            let (value, [a, b, c, d]) = self.distort(point);
            let miss = target - value;
            if miss.length() <= TOLERANCE * (1.0 + r) {
                break;
            }
            let determinant = a * d - b * c;
            if determinant.is_nan() || determinant <= 0.0 {
                return None;
            }
            let step = DVec2::new(d * miss.x - b * miss.y, a * miss.y - c * miss.x) / determinant;
            if step.length() <= f64::EPSILON * point.length() {
                break;
            }
            point += step;
        }
        let close = (self.distort(point).0 - target).length() <= 1e-10 * (1.0 + r);
        let inside = point.length() <= self.max_radius * (1.0 + 1e-9);
        (close && inside).then(|| DVec3::new(point.x, point.y, 1.0).normalize())
    }

    /// The distorted point and the Jacobian of the distortion, row by row.
    fn distort(&self, q: DVec2) -> (DVec2, [f64; 4]) {
        let ([k1, k2, k3], [p1, p2]) = (self.k, self.p);
        let s = q.x * q.x + q.y * q.y;
        let radial = 1.0 + s * (k1 + s * (k2 + s * k3));
        let radial_slope = k1 + s * (2.0 * k2 + s * 3.0 * k3);
        let value = DVec2::new(
            q.x * radial + 2.0 * p1 * q.x * q.y + p2 * (s + 2.0 * q.x * q.x),
            q.y * radial + p1 * (s + 2.0 * q.y * q.y) + 2.0 * p2 * q.x * q.y,
        );
        let cross = 2.0 * q.x * q.y * radial_slope + 2.0 * p1 * q.x + 2.0 * p2 * q.y;
        let jacobian = [
            radial + 2.0 * q.x * q.x * radial_slope + 2.0 * p1 * q.y + 6.0 * p2 * q.x,
            cross,
            cross,
            radial + 2.0 * q.y * q.y * radial_slope + 6.0 * p1 * q.y + 2.0 * p2 * q.x,
        ];
        (value, jacobian)
    }

    /// Inverts the radial part alone, by Newton's method guarded by bisection; `None` beyond what the lens can draw.
    fn undistorted_radius(&self, distorted: f64) -> Option<f64> {
        let [k1, k2, k3] = self.k;
        let value = |r: f64| {
            let s = r * r;
            r * (1.0 + s * (k1 + s * (k2 + s * k3)))
        };
        if distorted.is_nan() || distorted > value(self.max_radius) {
            return None;
        }
        let (mut low, mut high) = (0.0, self.max_radius);
        let mut r = distorted.min(high);
        for _ in 0..80 {
            let miss = value(r) - distorted;
            if miss > 0.0 {
                high = r
            } else {
                low = r
            }
            let s = r * r;
            let newton = r - miss / (1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3)));
            let next = if newton > low && newton < high { newton } else { low + (high - low) / 2.0 };
            if (next - r).abs() <= f64::EPSILON * next {
                break;
            }
            r = next;
        }
        Some(r)
    }
}
