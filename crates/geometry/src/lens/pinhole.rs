//! The pinhole model with OpenCV's distortion: radial (polynomial or rational), tangential and thin prism terms.
//!
//! A ray's point (x, y) = (X / Z, Y / Z) with s = x^2 + y^2 is drawn at (OpenCV, "Camera Calibration and 3D Reconstruction"):
//!
//! ```text
//! radial = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)
//! u = x radial + 2 p1 x y + p2 (s + 2 x^2) + s1 s + s2 s^2
//! v = y radial + p1 (s + 2 y^2) + 2 p2 x y + s3 s + s4 s^2
//! ```

use glam::{DVec2, DVec3};

use super::{LensError, check_coefficients, half_fov};
use crate::monotonic::find_root;
use crate::polynomial;

/// A pinhole with distortion, and the largest angle that it draws.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pinhole {
    distortion: Distortion,
    /// Largest undistorted radius, the tangent of the largest angle off the axis.
    max_radius: f64,
    /// Whether it is known that no two points within `max_radius` are drawn at one.
    is_one_to_one: bool,
}

/// The coefficients of the distortion; those that a model does not have are 0.
#[derive(Clone, Debug, PartialEq)]
struct Distortion {
    /// Radial coefficients of the numerator: k1, k2, k3.
    numerator: [f64; 3],
    /// Radial coefficients of the denominator: k4, k5, k6.
    denominator: [f64; 3],
    /// Tangential coefficients p1, p2.
    tangential: [f64; 2],
    /// Thin prism coefficients s1 to s4.
    prism: [f64; 4],
}

/// Names of OpenCV's coefficients in its order.
const NAMES: [&str; 12] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4"];
/// Largest magnitude of a coefficient of the rational model: with it, polynomials of the whole view stay below 1e60.
const MAX_COEFFICIENT: f64 = 1e9;
/// Largest field of view, degrees. A pinhole image means nothing beyond 89.5 degrees off the axis.
const MAX_FOV_DEG: f64 = 179.0;
/// Largest number of Newton steps of one inversion.
const MAX_STEPS: usize = 50;
/// Largest number of times that a Newton step is halved.
const MAX_HALVINGS: usize = 40;
/// Largest distance of the distorted result from the requested point, in focal lengths: 1e-11 px at 1000 px.
const TOLERANCE: f64 = 1e-14;

impl Pinhole {
    /// Checks the coefficients k1, k2, p1, p2, k3 and finds the angle up to which the lens draws.
    ///
    /// `reach` is the distance of the image's farthest corner from the principal point, in focal lengths.
    pub(super) fn plumb_bob(d: [f64; 5], reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        let distortion = Distortion::new(&d)?;
        let [_, _, p1, p2, _] = d;
        let slope = distortion.radial_slope();
        let limit = limit(fov_deg, |limit| polynomial::first_non_positive(&slope, limit * limit).map(libm::sqrt))?;
        let mut lens = Self { distortion, max_radius: limit, is_one_to_one: false };
        // Up to the image's corner, with room for what the tangential terms add.
        if let Some(corner) = lens.undistorted_radius(reach * (1.0 + 4.0 * (p1.abs() + p2.abs()) * reach)) {
            lens.max_radius = corner;
        }
        Ok(lens)
    }

    /// Checks 8 (k1, k2, p1, p2, k3 to k6) or 12 coefficients (and s1 to s4) and finds the angle up to which the lens draws.
    ///
    /// Within that angle no two rays have the same pixel: the symmetric part of the distortion's derivative is positive definite, as
    /// its radial part stretches by more than tangential and prism terms can take away. `reach` as in [`Self::plumb_bob`].
    pub(super) fn rational(d: &[f64], reach: f64, fov_deg: Option<f64>) -> Result<Self, LensError> {
        let distortion = Distortion::new(d)?;
        if let Some((name, value)) = NAMES.into_iter().zip(d).find(|(_, value)| value.abs() > MAX_COEFFICIENT) {
            let expected = "within -1e9 and 1e9, as every calibration is";
            return Err(LensError::Coefficient { name, value: *value, expected });
        }
        let positive = distortion.stretch_bounds();
        let turn = |limit| positive.iter().filter_map(|p| polynomial::first_non_positive(p, limit)).reduce(f64::min);
        let limit = limit(fov_deg, turn)?;
        let mut lens = Self { distortion, max_radius: limit, is_one_to_one: true };
        if let Some(corner) = lens.radius_that_covers(reach) {
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
        inside.then(|| self.distortion.apply(point).0)
    }

    /// Finds the unit ray of a point in focal lengths: Newton's method in two dimensions, from the exact inverse of the radial part.
    pub(super) fn unproject(&self, target: DVec2) -> Option<DVec3> {
        let r = libm::hypot(target.x, target.y);
        if r == 0.0 {
            return Some(DVec3::Z);
        }
        let start = self.undistorted_radius(r).unwrap_or(self.max_radius);
        let mut point = if r > 0.0 { target * (start / r) } else { DVec2::ZERO };
        for _ in 0..MAX_STEPS {
            let (value, [a, b, c, d]) = self.distortion.apply(point);
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
            point += if self.is_one_to_one { self.shortened(point, step, target) } else { step };
        }
        let close = (self.distortion.apply(point).0 - target).length() <= 1e-10 * (1.0 + r);
        let inside = point.length() <= self.max_radius * (1.0 + 1e-9);
        (close && inside).then(|| DVec3::new(point.x, point.y, 1.0).normalize())
    }

    /// A step halved until it leads nearer to the target inside the lens; Newton's method then finds every point of a lens that is
    /// one to one.
    fn shortened(&self, point: DVec2, step: DVec2, target: DVec2) -> DVec2 {
        let miss = |point: DVec2| (self.distortion.apply(point).0 - target).length();
        let before = miss(point);
        let mut step = step;
        for _ in 0..MAX_HALVINGS {
            let next = point + step;
            if next.length() <= self.max_radius * (1.0 + 1e-9) && miss(next) < before {
                break;
            }
            step *= 0.5;
        }
        step
    }

    /// Inverts the radial part alone, by Newton's method guarded by bisection; `None` beyond what the lens can draw.
    fn undistorted_radius(&self, distorted: f64) -> Option<f64> {
        if distorted.is_nan() || distorted > self.distortion.radius(self.max_radius)[0] {
            return None;
        }
        Some(invert(distorted, self.max_radius, |r| self.distortion.radius(r)))
    }

    /// An undistorted radius that contains all that is drawn within `reach`; `None` if that is beyond what the lens can draw.
    ///
    /// Wherever a ray of undistorted radius r lies, it is drawn at least `radius(r) - 3 |p| r^2 - |(s1, s3)| r^2 - |(s2, s4)| r^4`
    /// away from the principal point.
    fn radius_that_covers(&self, reach: f64) -> Option<f64> {
        let ([p, a, b], distortion) = (self.distortion.asymmetry(), &self.distortion);
        let least = |r: f64| {
            let [value, slope] = distortion.radius(r);
            [value - r * r * (3.0 * p + a + b * r * r), slope - r * (6.0 * p + 2.0 * a + 4.0 * b * r * r)]
        };
        (reach <= least(self.max_radius)[0]).then(|| invert(reach, self.max_radius, least))
    }
}

/// The undistorted radius up to which the lens draws: what is stated, or the largest of the model, or just short of the first turn.
///
/// `first_turn` finds the smallest radius up to a given one at which the lens is no longer monotonic.
fn limit(fov_deg: Option<f64>, first_turn: impl Fn(f64) -> Option<f64>) -> Result<f64, LensError> {
    let stated = half_fov(fov_deg, MAX_FOV_DEG)?.map(libm::tan);
    let limit = stated.unwrap_or_else(|| libm::tan((MAX_FOV_DEG / 2.0).to_radians()));
    let turn = first_turn(limit);
    if let (Some(at), Some(fov_deg)) = (turn, fov_deg) {
        return Err(LensError::NotMonotonic { at_deg: libm::atan(at).to_degrees(), fov_deg });
    }
    Ok(turn.map_or(limit, |at| at * (1.0 - 1e-6)))
}

/// Finds the radius from 0 to `end` at which a rising function, given with its slope, has a value.
fn invert(wanted: f64, end: f64, function: impl Fn(f64) -> [f64; 2]) -> f64 {
    find_root(wanted, end, |r| {
        let [value, slope] = function(r);
        [value - wanted, slope]
    })
}

impl Distortion {
    /// Takes up to 12 coefficients in OpenCV's order, each within [`super::MAX_COEFFICIENT`].
    fn new(d: &[f64]) -> Result<Self, LensError> {
        check_coefficients(NAMES.into_iter().zip(d))?;
        let mut all = [0.0; NAMES.len()];
        for (place, value) in all.iter_mut().zip(d) {
            *place = *value;
        }
        let [k1, k2, p1, p2, k3, k4, k5, k6, prism @ ..] = all;
        Ok(Self { numerator: [k1, k2, k3], denominator: [k4, k5, k6], tangential: [p1, p2], prism })
    }

    /// The distorted point and the Jacobian of the distortion, row by row.
    fn apply(&self, q: DVec2) -> (DVec2, [f64; 4]) {
        let [p1, p2] = self.tangential;
        let s = q.x * q.x + q.y * q.y;
        let [radial, radial_slope] = self.radial(s);
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
        if self.prism == [0.0; 4] { (value, jacobian) } else { self.add_prism(q, value, jacobian) }
    }

    /// Adds the thin prism terms to a distorted point and its Jacobian.
    fn add_prism(&self, q: DVec2, value: DVec2, [a, b, c, d]: [f64; 4]) -> (DVec2, [f64; 4]) {
        let ([s1, s2, s3, s4], s) = (self.prism, q.x * q.x + q.y * q.y);
        let [by_u, by_v] = [2.0 * s1 + 4.0 * s2 * s, 2.0 * s3 + 4.0 * s4 * s];
        let moved = DVec2::new(s * (s1 + s * s2), s * (s3 + s * s4));
        (value + moved, [a + by_u * q.x, b + by_u * q.y, c + by_v * q.x, d + by_v * q.y])
    }

    /// The radial factor, and its derivative by the squared radius `s`.
    fn radial(&self, s: f64) -> [f64; 2] {
        let ([k1, k2, k3], [k4, k5, k6]) = (self.numerator, self.denominator);
        let value = 1.0 + s * (k1 + s * (k2 + s * k3));
        let slope = k1 + s * (2.0 * k2 + s * 3.0 * k3);
        if self.denominator == [0.0; 3] {
            return [value, slope];
        }
        let below = 1.0 + s * (k4 + s * (k5 + s * k6));
        let below_slope = k4 + s * (2.0 * k5 + s * 3.0 * k6);
        [value / below, (slope - value / below * below_slope) / below]
    }

    /// The distorted radius by the radial part alone, and its derivative by the undistorted radius `r`.
    fn radius(&self, r: f64) -> [f64; 2] {
        let s = r * r;
        let [radial, radial_slope] = self.radial(s);
        let slope = if self.denominator == [0.0; 3] {
            let [k1, k2, k3] = self.numerator;
            1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3))
        } else {
            radial + 2.0 * s * radial_slope
        };
        [r * radial, slope]
    }

    /// The derivative of the distorted radius by the undistorted one, times the denominator squared: a polynomial in the squared radius.
    fn radial_slope(&self) -> Vec<f64> {
        let ([k1, k2, k3], [k4, k5, k6]) = (self.numerator, self.denominator);
        let slope = [1.0, 3.0 * k1, 5.0 * k2, 7.0 * k3];
        if self.denominator == [0.0; 3] {
            return slope.to_vec();
        }
        let rise = polynomial::product(&slope, &[1.0, k4, k5, k6]);
        // The derivative of the denominator by the radius is 2 r (k4 + 2 k5 s + 3 k6 s^2).
        let fall = polynomial::product(&[1.0, k1, k2, k3], &[0.0, 2.0 * k4, 4.0 * k5, 6.0 * k6]);
        rise.iter().zip(&fall).map(|(rise, fall)| rise - fall).collect()
    }

    /// Sizes of the terms that are not radial: |(p1, p2)|, |(s1, s3)| and |(s2, s4)|.
    fn asymmetry(&self) -> [f64; 3] {
        let ([p1, p2], [s1, s2, s3, s4]) = (self.tangential, self.prism);
        [libm::hypot(p1, p2), libm::hypot(s1, s3), libm::hypot(s2, s4)]
    }

    /// Polynomials in the undistorted radius r that are positive where no two rays have the same pixel.
    ///
    /// The radial part stretches by its slope along the radius and by radius / r across it. The derivative of the tangential terms
    /// has a norm of at most 6 |p| r, that of the prism terms of at most 2 |(s1, s3)| r + 4 |(s2, s4)| r^3. Where both stretches are
    /// larger than that, the symmetric part of the whole derivative is positive definite, and on a disk such a map is one to one.
    fn stretch_bounds(&self) -> [Vec<f64>; 3] {
        let ([k1, k2, k3], [k4, k5, k6], [p, a, b]) = (self.numerator, self.denominator, self.asymmetry());
        let in_radius = |in_square: &[f64]| in_square.iter().flat_map(|c| [*c, 0.0]).collect::<Vec<f64>>();
        let below = in_radius(&[1.0, k4, k5, k6]);
        let square = polynomial::product(&below, &below);
        let taken = polynomial::product(&square, &[0.0, 6.0 * p + 2.0 * a, 0.0, 4.0 * b]);
        let left = |stretch: Vec<f64>| -> Vec<f64> {
            (0..taken.len()).map(|i| stretch.get(i).copied().unwrap_or(0.0) - taken[i]).collect()
        };
        let along = left(in_radius(&self.radial_slope()));
        let across = left(polynomial::product(&in_radius(&[1.0, k1, k2, k3]), &below));
        [below, along, across]
    }
}
