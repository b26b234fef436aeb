//! Finds the circle in which a source's lens draws its image, from the pixels that its images never light.
//!
//! Where the picture ends, dark pixels lie beside lit ones on a circle; the robot's body, a dark hall and dirt add other
//! edges. The circle through most edge pixels is found by trying three at a time (Fischler and Bolles 1981, RANSAC; spread
//! evenly over all triples by the additive recurrence R3 of Roberts 2018), and fitted by least squares to all edge pixels
//! that lie on it (Kasa 1976). Nothing may be lit beyond it.

use glam::{DVec2, DVec3};
use nalgebra::{Matrix3, Vector3};

use realitysim_geometry::{Lens, LensParameters};

/// A circle in the image, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Circle {
    centre: DVec2,
    radius: f64,
}

/// Number of triples of edge pixels that are tried.
const TRIALS: u32 = 600;
/// Steps of the additive recurrence R3.
const R3: [f64; 3] = [0.819_172_513_396_164_4, 0.671_043_606_703_789_2, 0.549_700_477_901_970_3];
/// Distance up to which a pixel lies on a circle.
const NEAR_PX: f64 = 1.5;
/// Least share of the edge pixels that must lie on the circle.
const MIN_EDGE_SHARE: f64 = 0.2;
/// Least number of edge pixels on the circle, as a share of its circumference in pixels.
const MIN_ARC_SHARE: f64 = 0.1;
/// Width of the circle's soft edge, beyond which the image must be dark.
const SOFT_PX: f64 = 3.0;
/// Least share of the pixels beyond the circle that must be dark; the rest is dust and reflections.
const DARK_SHARE: f64 = 0.97;
/// Least share of the image that must lie beyond the circle. Less is a corner that was never lit.
const MIN_OUTSIDE_SHARE: f64 = 0.005;
/// Smallest full angle of view of a circle.
const MIN_FOV_DEG: f64 = 60.0;

/// The full angle of view of the circle that the lens draws, degrees. `None` if the circle fills the image, or what is dark
/// is not outside a circle.
///
/// `shows` says of each pixel, row by row, whether it ever showed anything.
pub(super) fn circle_deg(lens: &LensParameters, shows: &[bool]) -> Option<f64> {
    let lens = Lens::new(LensParameters { fov_deg: None, ..lens.clone() }).ok()?;
    let width = lens.width() as usize;
    let circle = find(shows, width)?;
    let within = (0..shows.len()).map(|index| place(index, width)).filter(|at| circle.signed_distance(*at) <= 0.0);
    let angles = within.filter_map(|at| lens.unproject(at)).map(|ray| ray.angle_between(DVec3::Z).to_degrees());
    Some(2.0 * angles.fold(0.0, f64::max)).filter(|fov_deg| *fov_deg >= MIN_FOV_DEG)
}

/// The pixel with this index.
fn place(index: usize, width: usize) -> DVec2 {
    DVec2::new((index % width) as f64, (index / width) as f64)
}

/// The circle that bounds the picture and has most edge pixels on it.
fn find(shows: &[bool], width: usize) -> Option<Circle> {
    let edge: Vec<DVec2> = edge_of(shows, width);
    let mut best: Option<(usize, Circle)> = None;
    for trial in 0..TRIALS {
        let draw =
            |step: f64| edge.get(((0.5 + f64::from(trial) * step).fract() * edge.len() as f64) as usize).copied();
        let Some(circle) = Circle::through([draw(R3[0])?, draw(R3[1])?, draw(R3[2])?]) else { continue };
        let on_it = edge.iter().filter(|at| circle.signed_distance(**at).abs() <= NEAR_PX).count();
        let is_better = best.is_none_or(|(most, _)| on_it > most);
        if is_better && on_it as f64 >= circle.min_edge_pixels(edge.len()) && circle.bounds_picture(shows, width) {
            best = Some((on_it, circle));
        }
    }
    let (_, circle) = best?;
    let on_it: Vec<DVec2> = edge.into_iter().filter(|at| circle.signed_distance(*at).abs() <= NEAR_PX).collect();
    Circle::fitted(&on_it).filter(|fitted| fitted.bounds_picture(shows, width)).or(Some(circle))
}

/// The points between dark pixels and lit ones beside or below them.
fn edge_of(shows: &[bool], width: usize) -> Vec<DVec2> {
    let between = |index: usize, step: usize| {
        let is_edge = (step == width || index % width + 1 < width)
            && shows.get(index + step).is_some_and(|next| *next != shows[index]);
        is_edge.then(|| (place(index, width) + place(index + step, width)) / 2.0)
    };
    (0..shows.len()).flat_map(|index| [1, width].into_iter().filter_map(move |step| between(index, step))).collect()
}

impl Circle {
    /// The circle through three points; `None` if they lie nearly on a line.
    fn through([a, b, c]: [DVec2; 3]) -> Option<Self> {
        let (b, c) = (b - a, c - a);
        let double_area = b.perp_dot(c);
        if double_area.abs() < 1.0 {
            return None;
        }
        let (bb, cc) = (b.length_squared(), c.length_squared());
        let centre = DVec2::new(c.y * bb - b.y * cc, b.x * cc - c.x * bb) / (2.0 * double_area);
        Some(Self { centre: a + centre, radius: centre.length() })
    }

    /// The circle that minimises the sum of the squares of x^2 + y^2 + p x + q y + r over the points (Kasa 1976).
    fn fitted(points: &[DVec2]) -> Option<Self> {
        let mean = points.iter().sum::<DVec2>() / points.len().max(1) as f64;
        let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for point in points {
            let at = *point - mean;
            let row = Vector3::new(at.x, at.y, 1.0);
            normal += row * row.transpose();
            right -= row * at.length_squared();
        }
        let solved = normal.cholesky()?.solve(&right);
        let centre = DVec2::new(solved.x, solved.y) * -0.5;
        let square = centre.length_squared() - solved.z;
        (square > 0.0).then(|| Self { centre: mean + centre, radius: libm::sqrt(square) })
    }

    /// Distance of a point from the circle, positive outside.
    fn signed_distance(&self, at: DVec2) -> f64 {
        at.distance(self.centre) - self.radius
    }

    /// The fewest edge pixels that must lie on the circle, of `edge` in all.
    fn min_edge_pixels(&self, edge: usize) -> f64 {
        (MIN_EDGE_SHARE * edge as f64).max(MIN_ARC_SHARE * core::f64::consts::TAU * self.radius)
    }

    /// Whether the picture ends at this circle: enough of the image lies beyond it, and nearly all of that is dark.
    fn bounds_picture(&self, shows: &[bool], width: usize) -> bool {
        let outside =
            shows.iter().enumerate().filter(|(index, _)| self.signed_distance(place(*index, width)) > SOFT_PX);
        let (all, lit) = outside.fold((0u64, 0u64), |(all, lit), (_, shows)| (all + 1, lit + u64::from(*shows)));
        all as f64 >= MIN_OUTSIDE_SHARE * shows.len() as f64 && lit as f64 <= (1.0 - DARK_SHARE) * all as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::load_lens;

    fn fisheye() -> LensParameters {
        let lens = load_lens("fisheye-640").expect("shipped").lens.parameters().clone();
        LensParameters { fov_deg: None, ..lens }
    }

    fn shown(lens: &LensParameters, shows: impl Fn(usize, usize) -> bool) -> Vec<bool> {
        let (width, height) = (lens.width as usize, lens.height as usize);
        (0..width * height).map(|index| shows(index % width, index / width)).collect()
    }

    #[test]
    fn the_circle_is_found_to_a_pixel_whatever_hides_parts_of_it() {
        let lens = fisheye();
        for (radius_px, off_axis) in [(150.0, 0.0), (200.0, 31.0), (260.0, 0.0), (200.0, 94.0)] {
            let centre = DVec2::new(lens.cx + off_axis, lens.cy);
            let at = |u: usize, v: usize| DVec2::new(u as f64, v as f64).distance(centre);
            // The robot's body, a dark hall above, and dirt in a corner.
            let body = |u: usize, v: usize| v > 330 && u > 250;
            let hall = |v: usize| v < 200;
            let dirt = |u: usize, v: usize| u < 40 && v > 440;
            let edge = (centre + DVec2::new(radius_px, 0.0)).min(DVec2::new(639.0, 479.0));
            let lens_of = Lens::new(lens.clone()).unwrap();
            let wanted = lens_of.unproject(edge).unwrap().angle_between(DVec3::Z).to_degrees();
            for hides in 0..4 {
                let mask = shown(&lens, |u, v| {
                    let dark = (hides & 1 == 1 && body(u, v)) || (hides & 2 == 2 && hall(v));
                    (at(u, v) < radius_px && !dark) || dirt(u, v)
                });
                let found = circle_deg(&lens, &mask).expect("a circle") / 2.0;
                assert!((found - wanted).abs() < 1.0, "{radius_px} px, {off_axis} px, {hides}: {found} for {wanted}");
            }
        }
    }

    #[test]
    fn what_is_no_circle_is_none() {
        let lens = fisheye();
        assert_eq!(circle_deg(&lens, &shown(&lens, |_, _| true)), None, "all is lit");
        assert_eq!(circle_deg(&lens, &shown(&lens, |_, v| v > 240)), None, "the hall is dark above");
        assert_eq!(circle_deg(&lens, &shown(&lens, |u, v| u + v > 100)), None, "one corner");
        assert_eq!(circle_deg(&lens, &shown(&lens, |u, v| v < 300 || u < 200)), None, "a body");
        assert_eq!(circle_deg(&lens, &shown(&lens, |_, _| false)), None, "nothing is");
    }
}
