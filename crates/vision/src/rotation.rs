//! The rotation of a camera between two pictures, estimated from the pictures alone.
//!
//! Both pictures are compared in small copies. If a camera only rotates, its lens alone determines how every pixel moves, whatever the
//! distance of what it shows. So three unknowns explain all differences. They are found by least squares with the first
//! picture's gradients (inverse compositional alignment, Baker and Matthews 2004). If the camera also translates, near things move
//! differently, which is little for a rotation of some degrees.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::{Picture, Reduction};
use realitysim_geometry::Lens;

/// Estimates the rotation of a camera with one lens.
pub struct Turning<'a> {
    lens: &'a Lens,
    /// Pixels of the picture for each pixel of the small copy.
    factor: usize,
    /// Width of the small copy, pixels.
    width: usize,
    /// Height of the small copy, pixels.
    height: usize,
}

/// The small copy of a picture: luma, row by row.
pub struct Small(Vec<f64>);

/// Width of the small copy that is aimed at, pixels. One pixel of a fisheye is then two degrees.
const SMALL_WIDTH: usize = 80;
/// Number of Gauss-Newton iterations.
const ITERATIONS: usize = 6;
/// Smallest share of the first picture's points that the second picture must show.
const MIN_OVERLAP: f64 = 0.5;
/// Difference in gray levels at which a pixel's weight is halved: something moved there.
const OUTLIER_LEVELS: f64 = 40.0;
/// Share of the lens's largest angle that is used. Beyond it is the dark rim of the image circle, which never moves.
const INNER_SHARE: f64 = 0.85;
/// Step by which the lens is differentiated numerically, radians.
const STEP: f64 = 1e-4;

impl<'a> Turning<'a> {
    /// Prepares the estimation for a lens.
    pub fn new(lens: &'a Lens) -> Self {
        let factor = (lens.width() as usize / SMALL_WIDTH).clamp(1, 8);
        Self { lens, factor, width: lens.width() as usize / factor, height: lens.height() as usize / factor }
    }

    /// Makes the small copy of a picture; `None` if the picture does not have the lens's size.
    pub fn small(&self, picture: &Picture) -> Option<Small> {
        let fits = picture.width == self.lens.width() as usize && picture.height == self.lens.height() as usize;
        fits.then(|| {
            let mut reduction = Reduction::default();
            let small = picture.reduced(self.factor, &mut reduction);
            Small(small.luma.iter().map(|value| f64::from(*value)).collect())
        })
    }

    /// Estimates the rotation vector (radians) that turns the first camera into the second, in axes of `camera_optical_frame`.
    ///
    /// `None` if the pictures overlap too little, or show too little structure.
    pub fn between(&self, first: &Small, second: &Small) -> Option<DVec3> {
        let points = self.points(first);
        let mut second_from_first = DQuat::IDENTITY;
        for _ in 0..ITERATIONS {
            let mut normal = DMat3::ZERO;
            let mut right = DVec3::ZERO;
            let mut seen = 0;
            let differences: Vec<(DVec3, f64)> = (points.iter())
                .filter_map(|point| {
                    let ray = second_from_first * point.ray;
                    let there = self.is_inner(ray).then(|| self.project(ray))??;
                    let there = self.sample(second, there)?;
                    Some((point.row, there - point.value))
                })
                .collect();
            // The mean is left out, because the light may have changed between the two.
            let mean = differences.iter().map(|(_, off)| off).sum::<f64>() / differences.len().max(1) as f64;
            for (row, off) in differences {
                let off = off - mean;
                let weight = 1.0 / (1.0 + (off / OUTLIER_LEVELS) * (off / OUTLIER_LEVELS));
                normal += weight * DMat3::from_cols(row * row.x, row * row.y, row * row.z);
                right += weight * off * row;
                seen += 1;
            }
            if (seen as f64) < MIN_OVERLAP * points.len() as f64 || normal.determinant().abs() < 1e-9 {
                return None;
            }
            let step = normal.inverse() * right;
            // The step belongs to the first picture, so its inverse is applied before the estimate (inverse compositional).
            second_from_first = (second_from_first * DQuat::from_scaled_axis(-step)).normalize();
            if step.length() < 1e-6 {
                break;
            }
        }
        let turn = second_from_first.conjugate().to_scaled_axis();
        turn.is_finite().then_some(turn)
    }

    /// The points of the first picture that are compared, with the derivative of their values by the rotation.
    fn points(&self, first: &Small) -> Vec<Point> {
        let mut points = Vec::new();
        for v in 1..self.height - 1 {
            for u in 1..self.width - 1 {
                let at = |u: usize, v: usize| first.0[v * self.width + u];
                let gradient = DVec2::new((at(u + 1, v) - at(u - 1, v)) / 2.0, (at(u, v + 1) - at(u, v - 1)) / 2.0);
                let Some(ray) = self.lens.unproject(self.to_full_size(DVec2::new(u as f64, v as f64))) else {
                    continue;
                };
                let Some(here) = self.project(ray).filter(|_| self.is_inner(ray)) else { continue };
                let moved = |axis: DVec3| self.project(DQuat::from_scaled_axis(STEP * axis) * ray);
                if let (Some(x), Some(y), Some(z)) = (moved(DVec3::X), moved(DVec3::Y), moved(DVec3::Z)) {
                    let row = DVec3::new(
                        gradient.dot(x - here) / STEP,
                        gradient.dot(y - here) / STEP,
                        gradient.dot(z - here) / STEP,
                    );
                    points.push(Point { ray, value: at(u, v), row });
                }
            }
        }
        points
    }

    /// Whether a ray is far enough from the rim of the image circle.
    fn is_inner(&self, ray: DVec3) -> bool {
        ray.angle_between(DVec3::Z) < INNER_SHARE * self.lens.max_angle()
    }

    /// Turns coordinates of the small copy into those of the picture.
    fn to_full_size(&self, small: DVec2) -> DVec2 {
        let factor = self.factor as f64;
        small * factor + (factor - 1.0) / 2.0
    }

    /// Projects a ray to coordinates of the small copy.
    fn project(&self, ray: DVec3) -> Option<DVec2> {
        let factor = self.factor as f64;
        Some((self.lens.project(ray)? - (factor - 1.0) / 2.0) / factor)
    }

    /// Interpolates the small copy bilinearly; `None` outside of it.
    fn sample(&self, small: &Small, place: DVec2) -> Option<f64> {
        let inside = |value: f64, size: usize| value >= 0.0 && value < (size - 1) as f64;
        if !(inside(place.x, self.width) && inside(place.y, self.height)) {
            return None;
        }
        let (u, v) = (place.x as usize, place.y as usize);
        let (a, b) = (place.x - u as f64, place.y - v as f64);
        let at = |u: usize, v: usize| small.0[v * self.width + u];
        let upper = at(u, v) * (1.0 - a) + at(u + 1, v) * a;
        let lower = at(u, v + 1) * (1.0 - a) + at(u + 1, v + 1) * a;
        Some(upper * (1.0 - b) + lower * b)
    }
}

/// A pixel of the first picture.
struct Point {
    /// Unit ray in `camera_optical_frame`.
    ray: DVec3,
    /// Luma.
    value: f64,
    /// Derivative of the luma by a rotation about each axis, gray levels per radian.
    row: DVec3,
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_geometry::{Lens, LensParameters};

    /// Luma that the world has in a direction: smooth, and different everywhere.
    fn world(ray: DVec3) -> f64 {
        let r = ray.normalize();
        128.0 + 50.0 * libm::sin(5.0 * r.x + 1.0) * libm::cos(4.0 * r.y) + 40.0 * libm::sin(6.0 * r.z + 3.0 * r.x)
    }

    fn picture(lens: &Lens, camera_from_world: DQuat) -> Picture {
        let (width, height) = (lens.width() as usize, lens.height() as usize);
        let luma = (0..width * height).map(|i| {
            let pixel = DVec2::new((i % width) as f64, (i / width) as f64);
            lens.unproject(pixel).map_or(0, |ray| world(camera_from_world.conjugate() * ray) as u8)
        });
        Picture::from_gray(width, height, luma.collect()).expect("its size")
    }

    #[test]
    fn a_turn_about_any_axis_is_found() {
        let parameters: LensParameters =
            realitysim_config::load_lens("fisheye-640").expect("shipped").lens.parameters().clone();
        let lens = Lens::new(parameters).expect("a lens");
        let turning = Turning::new(&lens);
        let first = turning.small(&picture(&lens, DQuat::IDENTITY)).expect("its size");
        for turn in [
            DVec3::new(0.0, 0.02, 0.0),
            DVec3::new(0.03, 0.0, 0.0),
            DVec3::new(0.0, 0.0, -0.04),
            DVec3::new(0.02, -0.05, 0.03),
            DVec3::ZERO,
        ] {
            let second = picture(&lens, DQuat::from_scaled_axis(turn).conjugate());
            let found = turning.between(&first, &turning.small(&second).expect("its size")).expect("enough in view");
            let off = found.length() - turn.length();
            assert!(off.abs() < 0.002, "{found} for {turn}");
            assert!(found.distance(turn) < 0.004, "{found} for {turn}");
        }
    }

    #[test]
    fn a_plain_wall_says_nothing() {
        let lens = realitysim_config::load_lens("fisheye-640").expect("shipped").lens;
        let turning = Turning::new(&lens);
        let plain = Picture::from_gray(640, 480, vec![90; 640 * 480]).expect("its size");
        let small = || turning.small(&plain).expect("its size");
        assert!(turning.between(&small(), &small()).is_none());
        assert!(turning.small(&Picture::from_gray(4, 4, vec![0; 16]).expect("a size")).is_none());
    }
}
