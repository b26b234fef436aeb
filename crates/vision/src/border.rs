//! The border of the visible carpet.
//!
//! Seen from any camera the carpet, a rectangle, fills a convex cone of rays, whatever the lens and however wrong
//! the tilt. So the border is found by walking outwards on the ground along every azimuth while the colour is the carpet's, and
//! taking the convex hull of the ends. The hull bridges robots and people that hide a part of the border.

use core::f64::consts::TAU;

use glam::{DVec2, DVec3, Vec3};

use super::WorkingScale;
use super::carpet::Surface;
use realitysim_geometry::{Isometry, Projector, multiversioned};

/// The outline of the visible carpet: a convex polygon on the ground of `base_footprint`, metres, counter-clockwise.
///
/// It has no corners while the border is unknown; everything then counts as inside.
#[derive(Clone, Debug, Default)]
pub struct CarpetBorder {
    corners: Vec<DVec2>,
    /// Ends of the carpet along the azimuths.
    ends: Vec<DVec2>,
    /// For each edge the coefficients (of x, of y, constant) of a function that is positive on the inner side of the edge.
    edges: Vec<[f32; 3]>,
}

/// Number of directions in which the border is looked for.
const AZIMUTHS: usize = 120;
/// Range of the first step along an azimuth, metres from the point below the camera.
const FIRST_RANGE_M: f64 = 0.25;
/// Range of the last step along an azimuth, metres.
const LAST_RANGE_M: f64 = 15.0;
/// Number of steps along an azimuth; their ranges grow geometrically.
const STEPS: usize = 44;
/// Number of points that are compared with an edge side by side.
const BATCH: usize = 32;
/// Width of the strip at the border into which the narrow blur smears the surroundings, pixels of the working image.
const BLUR_REACH_PX: f64 = 6.0;

/// Directions and ranges at which the border is looked for, the same for every frame.
#[derive(Clone, Debug)]
pub struct Rays {
    directions: Vec<DVec2>,
    ranges: [f64; STEPS],
}

impl Default for Rays {
    fn default() -> Self {
        let directions = (0..AZIMUTHS).map(|azimuth| {
            let (sin, cos) = libm::sincos(TAU * azimuth as f64 / AZIMUTHS as f64);
            DVec2::new(cos, sin)
        });
        let growth = libm::pow(LAST_RANGE_M / FIRST_RANGE_M, 1.0 / (STEPS - 1) as f64);
        let ranges = core::array::from_fn(|step| FIRST_RANGE_M * libm::pow(growth, step as f64));
        Self { directions: directions.collect(), ranges }
    }
}

impl Rays {
    /// Projects the ground points at all ranges along one azimuth: u and v of each, NaN outside the field of view.
    ///
    /// `below` is the ground point below the camera and `along` the direction, both in `camera_optical_frame`.
    fn project(&self, projector: &Projector, below: DVec3, along: DVec3) -> [[f32; STEPS]; 2] {
        let (below, along, ranges) = (below.as_vec3(), along.as_vec3(), &self.ranges);
        multiversioned!(|projector: &Projector, below: Vec3, along: Vec3, ranges: &[f64; STEPS]| -> [[f32; STEPS]; 2] {
            let [mut xs, mut ys, mut zs] = [[0.0; STEPS]; 3];
            for (step, range) in ranges.iter().enumerate() {
                let range = *range as f32;
                (xs[step], ys[step], zs[step]) =
                    (below.x + along.x * range, below.y + along.y * range, below.z + along.z * range);
            }
            projector.project_all(&[xs, ys, zs])
        })
    }
}

impl CarpetBorder {
    /// Makes the border unknown.
    pub fn clear(&mut self) {
        self.corners.clear();
        self.edges.clear();
    }

    /// Finds the border in one frame; `surfaces` says what each half-resolution pixel shows.
    pub fn find(
        &mut self,
        rays: &Rays,
        surfaces: &[Surface],
        half_width: usize,
        projector: &Projector,
        footprint_from_optical: &Isometry,
        to_working: WorkingScale,
    ) {
        let optical_from_footprint = footprint_from_optical.inverse();
        let foot = footprint_from_optical.translation.truncate();
        let height = footprint_from_optical.translation.z;
        let below = optical_from_footprint.transform_point(foot.extend(0.0));
        let pixels_per_radian = projector.lens().focal() * to_working.factor();
        let min_cos = libm::cos(projector.lens().max_angle());
        let ends = rays.directions.iter().filter_map(|direction| {
            let along = optical_from_footprint.transform_vector(direction.extend(0.0));
            if max_cos_off_axis(below, along) < min_cos {
                return None;
            }
            let [us, vs] = rays.project(projector, below, along);
            let seen = us.into_iter().zip(vs).map(|(u, v)| {
                let pixel = Some(DVec2::new(u.into(), v.into())).filter(|pixel| projector.lens().contains(*pixel))?;
                let pixel = (to_working.apply(pixel) + DVec2::splat(0.5)) * 0.5;
                surfaces
                    .get((pixel.y.max(0.0) as usize) * half_width + (pixel.x.max(0.0) as usize).min(half_width - 1))
                    .copied()
            });
            let range = rays.ranges[last_carpet_step(seen)?];
            let smear = BLUR_REACH_PX / pixels_per_radian * (height * height + range * range) / height.max(0.05);
            Some(foot + *direction * (range - smear).max(0.0))
        });
        self.ends.clear();
        self.ends.extend(ends);
        self.build_polygon();
    }

    /// Makes the polygon of the ends.
    fn build_polygon(&mut self) {
        convex_hull(&mut self.ends, &mut self.corners);
        if self.corners.len() < 3 {
            return self.clear();
        }
        let Self { corners, edges, .. } = self;
        edges.clear();
        edges.extend(edges_of(corners).map(|(a, b)| {
            let along = b - a;
            // Coefficients of the perpendicular product of the edge and the vector from its start to the point.
            [-along.y, along.x, along.y * a.x - along.x * a.y].map(|part| part as f32)
        }));
    }

    /// Corners on the ground of `base_footprint`, metres, counter-clockwise; empty while the border is unknown.
    pub fn corners(&self) -> &[DVec2] {
        &self.corners
    }

    /// Tells for each point on the ground of `base_footprint` whether it lies within the border.
    ///
    /// A NaN point never does. All others do while the border is unknown.
    pub fn find_inside(&self, ground: &[DVec2], inside: &mut Vec<bool>) {
        inside.clear();
        let edges = &self.edges;
        multiversioned!(|edges: &[[f32; 3]], ground: &[DVec2], inside: &mut Vec<bool>| {
            for ground in ground.chunks(BATCH) {
                let mut worst = [f32::INFINITY; BATCH];
                let (mut xs, mut ys) = ([f32::NAN; BATCH], [f32::NAN; BATCH]);
                for ((x, y), at) in xs.iter_mut().zip(&mut ys).zip(ground) {
                    (*x, *y) = (at.x as f32, at.y as f32);
                }
                for [to_x, to_y, first] in edges {
                    for ((worst, x), y) in worst.iter_mut().zip(&xs).zip(&ys) {
                        let side = to_x * x + to_y * y + first;
                        *worst = if side < *worst { side } else { *worst };
                    }
                }
                let of_each = worst.iter().zip(&xs).map(|(worst, x)| *worst >= 0.0 && !x.is_nan());
                inside.extend(of_each.take(ground.len()));
            }
        });
    }

    /// The part of the line y = `y` (metres) within the border, as an interval of x; the whole line while the border is unknown.
    pub fn row(&self, y: f64) -> Option<(f64, f64)> {
        if self.corners.is_empty() {
            return Some((f64::NEG_INFINITY, f64::INFINITY));
        }
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in edges_of(&self.corners) {
            if (a.y <= y) != (b.y <= y) {
                let x = a.x + (b.x - a.x) * (y - a.y) / (b.y - a.y);
                low = low.min(x);
                high = high.max(x);
            }
        }
        (low <= high).then_some((low, high))
    }
}

/// Pairs each corner with the next, around the polygon.
fn edges_of(corners: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
    let next = corners.iter().cycle().skip(1);
    corners.iter().copied().zip(next.copied())
}

/// The largest cosine of the angle off the axis that any ground point along an azimuth has.
///
/// `below` is the ground point below the camera and `along` the direction, both in `camera_optical_frame`. An azimuth that lies
/// wholly outside the field of view need not be projected.
fn max_cos_off_axis(below: DVec3, along: DVec3) -> f64 {
    let turn = along.z * below.length_squared() / below.z;
    let cos = |range: f64| (below + along * range).normalize_or_zero().z;
    let inner = if turn > FIRST_RANGE_M && turn < LAST_RANGE_M { cos(turn) } else { -1.0 };
    cos(FIRST_RANGE_M).max(cos(LAST_RANGE_M)).max(inner)
}

/// The step up to which an azimuth is best explained as carpet.
///
/// It maximises the running sum of +1 for carpet and -2 for anything that is neither carpet nor white nor dark.
fn last_carpet_step(seen: impl Iterator<Item = Option<Surface>>) -> Option<usize> {
    let (mut sum, mut best, mut last) = (0, 0, None);
    for (step, surface) in seen.enumerate() {
        match surface {
            Some(Surface::Carpet) => sum += 1,
            Some(Surface::Other) => sum -= 2,
            Some(Surface::White | Surface::Dark) | None => continue,
        }
        if sum > best {
            (best, last) = (sum, Some(step));
        }
    }
    last
}

/// Finds the convex hull by Andrew's monotone chain, counter-clockwise, without collinear points. It reorders `points`.
fn convex_hull(points: &mut Vec<DVec2>, hull: &mut Vec<DVec2>) {
    points.sort_unstable_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    points.dedup();
    hull.clear();
    if points.len() < 3 {
        return hull.extend_from_slice(points);
    }
    let mut half = |points: &mut dyn Iterator<Item = DVec2>| {
        let first = hull.len();
        for point in points {
            while let [.., a, b] = hull[first..] {
                if (b - a).perp_dot(point - b) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(point);
        }
        hull.pop();
    };
    half(&mut points.iter().copied());
    half(&mut points.iter().rev().copied());
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_left_out_as_behind_the_camera_is_never_in_view(
            height in 0.05..2.0f64, roll in -1.5..1.5f64, pitch in -3.0..3.0f64, azimuth in 0.0..TAU,
        ) {
            let optical = DMat3::from_rotation_x(roll) * DMat3::from_rotation_y(pitch);
            let (below, along) = (optical * DVec3::NEG_Z * height, optical * DVec3::new(azimuth.cos(), azimuth.sin(), 0.0));
            let largest = max_cos_off_axis(below, along);
            for range in Rays::default().ranges {
                prop_assert!((below + along * range).normalize().z <= largest + 1e-12);
            }
        }
    }

    #[test]
    fn a_square_holds_its_middle_and_its_rows() {
        let square = vec![DVec2::new(1.0, 1.0), DVec2::new(-1.0, 1.0), DVec2::new(-1.0, -1.0), DVec2::new(1.0, -1.0)];
        let mut border = CarpetBorder { ends: square, ..CarpetBorder::default() };
        border.build_polygon();
        assert_eq!(border.corners().len(), 4);
        let mut inside = Vec::new();
        border.find_inside(&[DVec2::new(0.9, -0.9), DVec2::new(1.1, 0.0), DVec2::NAN], &mut inside);
        assert_eq!(inside, [true, false, false]);
        assert_eq!(border.row(0.5), Some((-1.0, 1.0)));
        assert_eq!(border.row(1.5), None);
    }

    proptest! {
        #[test]
        fn the_hull_holds_every_point(points in proptest::collection::vec((-5.0..5.0f64, -5.0..5.0f64), 3..40)) {
            let points: Vec<DVec2> = points.into_iter().map(DVec2::from).collect();
            let mut hull = Vec::new();
            convex_hull(&mut points.clone(), &mut hull);
            for point in &points {
                let worst = edges_of(&hull).map(|(a, b)| (b - a).perp_dot(*point - a)).fold(f64::INFINITY, f64::min);
                prop_assert!(worst >= -1e-9);
            }
        }
    }
}
