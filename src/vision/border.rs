//! Where the carpet ends.
//!
//! Seen from any camera the carpet, a rectangle, fills a convex cone of rays, whatever the lens and however wrong
//! the tilt. So: walk outwards on the ground along every azimuth while the colour stays the carpet's, and take
//! the convex hull of the ends. Robots and people that hide a part of the edge are bridged by the hull.

use core::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::WorkingScale;
use super::carpet::{Carpet, Sample, Surface};
use super::mask::BodyMask;
use super::picture::Picture;
use crate::geometry::{Isometry, Lens};

/// A convex polygon on the ground of `base_footprint`, counter-clockwise.
#[derive(Clone, Debug, PartialEq)]
pub struct CarpetBorder {
    corners: Vec<DVec2>,
}

const AZIMUTHS: usize = 120;
const NEAREST_M: f64 = 0.25;
const FARTHEST_M: f64 = 15.0;
const STEPS: usize = 56;
/// Samples whose colour is learnt from lie within this range of the robot.
const LEARN_WITHIN_M: f64 = 2.5;
/// The strip at the edge that the narrow blur smears the surroundings into, in pixels.
const BLUR_REACH_PX: f64 = 6.0;

impl CarpetBorder {
    /// With the carpet's colour; `None` when no edge can be told: a gray picture, or no carpet in view.
    pub fn find(
        picture: &Picture,
        lens: &Lens,
        footprint_from_optical: &Isometry,
        to_working: WorkingScale,
        body: Option<&BodyMask>,
    ) -> Option<(Self, Carpet)> {
        if picture.chroma.is_empty() {
            return None;
        }
        let optical_from_footprint = footprint_from_optical.inverse();
        let foot = footprint_from_optical.translation.truncate();
        let height = footprint_from_optical.translation.z;
        let pixels_per_radian = lens.focal();
        let growth = libm::pow(FARTHEST_M / NEAREST_M, 1.0 / (STEPS - 1) as f64);
        let ranges: Vec<f64> = (0..STEPS).map(|step| NEAREST_M * libm::pow(growth, step as f64)).collect();
        let rays: Vec<Vec<Option<Sample>>> = (0..AZIMUTHS)
            .map(|azimuth| {
                let (sin, cos) = libm::sincos(TAU * azimuth as f64 / AZIMUTHS as f64);
                ranges
                    .iter()
                    .map(|range| {
                        let ground = DVec3::new(foot.x + cos * range, foot.y + sin * range, 0.0);
                        let pixel = lens.project(optical_from_footprint.transform_point(ground))?;
                        if !lens.contains(pixel) || body.is_some_and(|body| body.hides(pixel)) {
                            return None;
                        }
                        sample(picture, to_working.apply(pixel))
                    })
                    .collect()
            })
            .collect();
        let carpet = Carpet::learn(rays.iter().flat_map(|ray| {
            ray.iter().zip(&ranges).filter(|(_, range)| **range < LEARN_WITHIN_M).filter_map(|(sample, _)| *sample)
        }))?;
        let ends: Vec<DVec2> = rays
            .iter()
            .enumerate()
            .filter_map(|(azimuth, ray)| {
                let last = last_step(&carpet, ray)?;
                let range = ranges[last];
                let smear = BLUR_REACH_PX / pixels_per_radian * (height * height + range * range) / height.max(0.05);
                let (sin, cos) = libm::sincos(TAU * azimuth as f64 / AZIMUTHS as f64);
                Some(foot + DVec2::new(cos, sin) * (range - smear).max(0.0))
            })
            .collect();
        let corners = convex_hull(ends);
        (corners.len() >= 3).then_some((Self { corners }, carpet))
    }

    pub fn corners(&self) -> &[DVec2] {
        &self.corners
    }

    pub fn holds(&self, ground: DVec2) -> bool {
        self.edges().all(|(a, b)| (b - a).perp_dot(ground - a) >= 0.0)
    }

    /// The part of the line y = `y` inside the polygon, as an interval of x.
    pub fn row(&self, y: f64) -> Option<(f64, f64)> {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in self.edges() {
            if (a.y <= y) != (b.y <= y) {
                let x = a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y);
                low = low.min(x);
                high = high.max(x);
            }
        }
        (low <= high).then_some((low, high))
    }

    fn edges(&self) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
        let next = self.corners.iter().cycle().skip(1);
        self.corners.iter().copied().zip(next.copied())
    }
}

/// The step up to which the ray is best explained as carpet: the highest running sum of +1 for carpet, -2 for anything
/// that does not lie on it.
fn last_step(carpet: &Carpet, ray: &[Option<Sample>]) -> Option<usize> {
    let (mut sum, mut best, mut last) = (0, 0, None);
    for (step, sample) in ray.iter().enumerate() {
        let Some(sample) = sample else { continue };
        match carpet.classify(*sample) {
            Surface::Carpet => sum += 1,
            Surface::Other => sum -= 2,
            Surface::White | Surface::Dark => continue,
        }
        if sum > best {
            (best, last) = (sum, Some(step));
        }
    }
    last
}

/// Mean of the four pixels around a place, `None` outside.
fn sample(picture: &Picture, at: DVec2) -> Option<Sample> {
    let (u, v) = (libm::floor(at.x), libm::floor(at.y));
    if u < 0.0 || v < 0.0 || u + 1.0 >= picture.width as f64 || v + 1.0 >= picture.height as f64 {
        return None;
    }
    let corner = v as usize * picture.width + u as usize;
    let (mut luma, mut chroma) = (0.0, [0.0; 2]);
    for index in [corner, corner + 1, corner + picture.width, corner + picture.width + 1] {
        luma += f32::from(picture.luma[index]) / 4.0;
        for (sum, value) in chroma.iter_mut().zip(picture.chroma[index]) {
            *sum += (f32::from(value) - 128.0) / 4.0;
        }
    }
    Some(Sample::new(luma, chroma))
}

/// Andrew's monotone chain, counter-clockwise, without collinear points.
fn convex_hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let half = |points: &mut dyn Iterator<Item = DVec2>| {
        let mut chain: Vec<DVec2> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..] {
                if (b - a).perp_dot(point - b) > 0.0 {
                    break;
                }
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = half(&mut points.iter().copied());
    hull.extend(half(&mut points.iter().rev().copied()));
    hull
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_square_holds_its_middle_and_its_rows() {
        let square = vec![DVec2::new(1.0, 1.0), DVec2::new(-1.0, 1.0), DVec2::new(-1.0, -1.0), DVec2::new(1.0, -1.0)];
        let border = CarpetBorder { corners: convex_hull(square) };
        assert_eq!(border.corners().len(), 4);
        assert!(border.holds(DVec2::new(0.9, -0.9)) && !border.holds(DVec2::new(1.1, 0.0)));
        assert_eq!(border.row(0.5), Some((-1.0, 1.0)));
        assert_eq!(border.row(1.5), None);
    }

    proptest! {
        #[test]
        fn the_hull_holds_every_point(points in proptest::collection::vec((-5.0..5.0f64, -5.0..5.0f64), 3..40)) {
            let points: Vec<DVec2> = points.into_iter().map(DVec2::from).collect();
            let hull = CarpetBorder { corners: convex_hull(points.clone()) };
            for point in &points {
                let worst = hull.edges().map(|(a, b)| (b - a).perp_dot(*point - a)).fold(f64::INFINITY, f64::min);
                prop_assert!(worst >= -1e-9);
            }
        }
    }
}
