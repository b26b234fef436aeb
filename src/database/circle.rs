//! How far from the axis a source's lens draws anything, from what its images never show.

use glam::{DVec2, DVec3};

use crate::geometry::{Lens, LensParameters};

/// Of the pixels farther from the axis than the circle's edge, so many show nothing. The others are dust and reflections.
const DARK_SHARE: f64 = 0.995;
/// A smaller part of the image beyond the edge is none: a corner that was never lit.
const LEAST_BEYOND: f64 = 0.005;
/// Rings in which pixels are counted.
const RING_DEG: f64 = 0.25;
/// A circle of which not as much is ever lit, or narrower, is something else that is dark.
const LIT_SHARE: f64 = 0.75;
const NARROWEST_DEG: f64 = 60.0;

/// Full angle of view of the circle that the lens draws; `None` where it fills the image, or what is dark is no circle.
/// `shows` says of each pixel, row by row, whether it ever showed anything.
pub(super) fn circle_deg(lens: &LensParameters, shows: &[bool]) -> Option<f64> {
    let lens = Lens::new(LensParameters { fov_deg: None, ..lens.clone() }).ok()?;
    let width = lens.width() as usize;
    let mut rings = vec![(0u64, 0u64); (180.0 / RING_DEG) as usize + 1];
    for (index, shows) in shows.iter().enumerate() {
        let Some(ray) = lens.unproject(DVec2::new((index % width) as f64, (index / width) as f64)) else { continue };
        let (all, lit) = &mut rings[(ray.angle_between(DVec3::Z).to_degrees() / RING_DEG) as usize];
        (*all, *lit) = (*all + 1, *lit + u64::from(*shows));
    }
    let share = |(all, lit): (u64, u64)| lit as f64 / all.max(1) as f64;
    let sum = |rings: &[(u64, u64)]| rings.iter().fold((0, 0), |sum, ring| (sum.0 + ring.0, sum.1 + ring.1));
    let edge = (1..rings.len()).find(|edge| share(sum(&rings[*edge..])) <= 1.0 - DARK_SHARE)?;
    let (beyond, within) = (sum(&rings[edge..]), sum(&rings[..edge]));
    let fov_deg = 2.0 * edge as f64 * RING_DEG;
    let is_circle =
        beyond.0 as f64 >= LEAST_BEYOND * shows.len() as f64 && share(within) >= LIT_SHARE && fov_deg >= NARROWEST_DEG;
    is_circle.then_some(fov_deg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::load_lens;

    fn fisheye() -> LensParameters {
        let lens = load_lens("fisheye-640").expect("shipped").lens.parameters().clone();
        LensParameters { fov_deg: None, ..lens }
    }

    fn shown(lens: &LensParameters, shows: impl Fn(usize, usize) -> bool) -> Vec<bool> {
        let (width, height) = (lens.width as usize, lens.height as usize);
        (0..width * height).map(|index| shows(index % width, index / width)).collect()
    }

    #[test]
    fn the_circle_is_found_to_a_pixel_whatever_the_robot_hides_of_it() {
        let lens = fisheye();
        let at = |u: usize, v: usize| (u as f64 - lens.cx).hypot(v as f64 - lens.cy);
        for radius_px in [150.0, 200.0, 260.0] {
            // Its chest below, and dust in a corner.
            let mask =
                shown(&lens, |u, v| at(u, v) < radius_px && !(v > 400 && (250..390).contains(&u)) || (u < 8 && v < 8));
            let edge = DVec2::new(lens.cx + radius_px, lens.cy);
            let wanted = Lens::new(lens.clone()).unwrap().unproject(edge).unwrap().angle_between(DVec3::Z).to_degrees();
            let found = circle_deg(&lens, &mask).expect("a circle") / 2.0;
            assert!((found - wanted).abs() < 0.5, "{radius_px}: {found} for {wanted}");
        }
    }

    #[test]
    fn what_is_no_circle_is_none() {
        let lens = fisheye();
        assert_eq!(circle_deg(&lens, &shown(&lens, |_, _| true)), None, "all is lit");
        assert_eq!(circle_deg(&lens, &shown(&lens, |_, v| v > 240)), None, "the hall is dark above");
        assert_eq!(circle_deg(&lens, &shown(&lens, |u, v| u + v > 100)), None, "one corner");
        assert_eq!(circle_deg(&lens, &shown(&lens, |_, _| false)), None, "nothing is");
    }
}
