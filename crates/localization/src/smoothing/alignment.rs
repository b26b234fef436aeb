//! The same ground in two images, found by its texture.
//!
//! Patches of the later image are looked for where both tags put them in the earlier one: the earlier image is drawn through the ground as
//! the later camera would see it (to first order over a patch), then shifted until both agree: whole pixels by correlation, the rest by
//! Lucas and Kanade (1981). Pure.

use glam::{DMat2, DVec2, DVec3};

use super::Match;
use realitysim_geometry::{Isometry, Projector};
use realitysim_vision::Picture;

/// An image and where its tag puts its camera.
#[derive(Clone, Copy, Debug)]
pub struct Look<'a> {
    pub picture: &'a Picture,
    pub map_from_optical: Isometry,
}

/// Patches are tried on a grid of this many pixels.
const GRID: usize = 24;
/// Half the side of a patch, without its middle.
const HALF: i32 = 5;
const AREA: usize = ((2 * HALF + 1) * (2 * HALF + 1)) as usize;
/// How far off both tags may put it, pixels.
const REACH: i32 = 4;
/// Of a frame, the ones with the most texture.
const MAX_MATCHES: usize = 60;
/// Farther on the ground a pixel is too long for texture.
const FARTHEST_M: f64 = 3.0;
/// Least texture: smaller eigenvalue of the mean squared gradient, in gray levels squared.
const TEXTURE: f64 = 6.0;
/// Correlation from which on both patches show the same.
const ALIKE: f64 = 0.8;
const ROUNDS: usize = 8;

/// Places of the ground that both images show. `hides` tells where a pixel of either shows the robot itself.
pub fn matches(projector: &Projector, before: &Look, here: &Look, hides: impl Fn(DVec2) -> bool) -> Vec<Match> {
    let (width, height) = (here.picture.width, here.picture.height);
    let fits = |look: &Look| look.picture.luma.len() == width * height;
    let edge = (HALF + REACH + 2) as usize;
    if !fits(before) || !fits(here) || width.min(height) <= 2 * edge {
        return Vec::new();
    }
    let rows = (edge..height - edge).step_by(GRID);
    let tried = rows.flat_map(|v| (edge..width - edge).step_by(GRID).map(move |u| (u, v)));
    let mut textured: Vec<(f64, DVec2)> = tried
        .map(|(u, v)| DVec2::new(u as f64, v as f64))
        .filter(|at| !hides(*at))
        .map(|at| (texture(here.picture, at), at))
        .filter(|(texture, _)| *texture > TEXTURE)
        .collect();
    textured.sort_by(|a, b| b.0.total_cmp(&a.0));
    let found = textured.into_iter().filter_map(|(_, at)| {
        let seen = Through::new(projector, before, here, at)?;
        let known = !hides(seen.before);
        known.then(|| seen.find(before.picture, here.picture, at)).flatten()
    });
    found.take(MAX_MATCHES).collect()
}

/// Where the earlier image shows what lies around a pixel of the later one.
struct Through {
    before: DVec2,
    /// Pixels of the earlier image by pixels of the later one.
    turn: DMat2,
}

impl Through {
    fn new(projector: &Projector, before: &Look, here: &Look, at: DVec2) -> Option<Self> {
        let earlier_from_map = before.map_from_optical.inverse();
        let place = |pixel: DVec2| -> Option<DVec2> {
            let ray: DVec3 = here.map_from_optical.transform_vector(projector.lens().unproject(pixel)?);
            let from = here.map_from_optical.translation;
            let distance = -from.z / ray.z;
            let near = distance > 0.0 && distance < FARTHEST_M;
            near.then(|| projector.project_inside(earlier_from_map.transform_point(from + ray * distance))).flatten()
        };
        let reach = f64::from(HALF);
        let middle = place(at)?;
        let [x, y] = [DVec2::X, DVec2::Y]
            .map(|axis| Some((place(at + axis * reach)? - place(at - axis * reach)?) / (2.0 * reach)));
        Some(Self { before: middle, turn: DMat2::from_cols(x?, y?) })
    }

    fn find(&self, before: &Picture, here: &Picture, at: DVec2) -> Option<Match> {
        let mut wanted = [0.0; AREA];
        for (value, offset) in wanted.iter_mut().zip(offsets()) {
            *value = gray(before, self.before + self.turn * offset)?;
        }
        let wanted = Patch::new(wanted)?;
        let mut best = (f64::NEG_INFINITY, DVec2::ZERO);
        for (dx, dy) in (-REACH..=REACH).flat_map(|dy| (-REACH..=REACH).map(move |dx| (dx, dy))) {
            let shift = DVec2::new(f64::from(dx), f64::from(dy));
            let alike = Patch::at(here, at + shift).map_or(f64::NEG_INFINITY, |patch| patch.alike(&wanted));
            if alike > best.0 {
                best = (alike, shift);
            }
        }
        let mut shift = best.1;
        for _ in 0..ROUNDS {
            let step = step(here, at + shift, &wanted)?;
            shift += step;
            if step.length() < 0.01 {
                break;
            }
        }
        let found = Patch::at(here, at + shift)?;
        let good = found.alike(&wanted) > ALIKE && (shift - best.1).length() < 1.5;
        good.then_some(Match { before: self.before, here: at + shift })
    }
}

/// Gray values of mean 0 and length 1.
struct Patch([f64; AREA]);

impl Patch {
    /// `None` for one without texture.
    fn new(mut values: [f64; AREA]) -> Option<Self> {
        let mean = values.iter().sum::<f64>() / AREA as f64;
        values.iter_mut().for_each(|value| *value -= mean);
        let length = libm::sqrt(values.iter().map(|value| value * value).sum());
        values.iter_mut().for_each(|value| *value /= length);
        (length > 1.0).then_some(Self(values))
    }

    fn at(picture: &Picture, at: DVec2) -> Option<Self> {
        let mut values = [0.0; AREA];
        for (value, offset) in values.iter_mut().zip(offsets()) {
            *value = gray(picture, at + offset)?;
        }
        Self::new(values)
    }

    fn alike(&self, other: &Self) -> f64 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }
}

fn offsets() -> impl Iterator<Item = DVec2> {
    (-HALF..=HALF).flat_map(|y| (-HALF..=HALF).map(move |x| DVec2::new(f64::from(x), f64::from(y))))
}

/// Gauss-Newton on the shift alone; brightness and contrast are taken from the patches.
fn step(picture: &Picture, at: DVec2, wanted: &Patch) -> Option<DVec2> {
    let (mut values, mut slopes) = ([0.0; AREA], [DVec2::ZERO; AREA]);
    for ((value, slope), offset) in values.iter_mut().zip(&mut slopes).zip(offsets()) {
        *value = gray(picture, at + offset)?;
        *slope = gradient(picture, at + offset)?;
    }
    let mean = values.iter().sum::<f64>() / AREA as f64;
    let contrast: f64 = values.iter().zip(&wanted.0).map(|(value, wanted)| (value - mean) * wanted).sum();
    let middle = slopes.iter().sum::<DVec2>() / AREA as f64;
    let (mut normal, mut right) = ([0.0; 3], DVec2::ZERO);
    for ((value, slope), wanted) in values.iter().zip(slopes).zip(&wanted.0) {
        let (slope, off) = (slope - middle, value - mean - contrast * wanted);
        normal = [normal[0] + slope.x * slope.x, normal[1] + slope.x * slope.y, normal[2] + slope.y * slope.y];
        right -= slope * off;
    }
    let [a, b, c] = normal;
    let determinant = a * c - b * b;
    let step = DVec2::new(c * right.x - b * right.y, a * right.y - b * right.x) / determinant;
    (step.is_finite() && step.length() < f64::from(HALF)).then_some(step)
}

fn texture(picture: &Picture, at: DVec2) -> f64 {
    let [mut a, mut b, mut c] = [0.0; 3];
    for slope in offsets().filter_map(|offset| gradient(picture, at + offset)) {
        (a, b, c) = (a + slope.x * slope.x, b + slope.x * slope.y, c + slope.y * slope.y);
    }
    let (mean, half) = ((a + c) / 2.0, (a - c) / 2.0);
    (mean - libm::sqrt(half * half + b * b)) / AREA as f64
}

fn gradient(picture: &Picture, at: DVec2) -> Option<DVec2> {
    let across = |axis: DVec2| Some((gray(picture, at + axis)? - gray(picture, at - axis)?) / 2.0);
    Some(DVec2::new(across(DVec2::X)?, across(DVec2::Y)?))
}

/// Bilinear; `None` outside.
fn gray(picture: &Picture, at: DVec2) -> Option<f64> {
    let (u, v) = (at.x as usize, at.y as usize);
    if !(at.x >= 0.0 && at.y >= 0.0 && u + 1 < picture.width && v + 1 < picture.height) {
        return None;
    }
    let (fu, fv) = (at.x - u as f64, at.y - v as f64);
    let row = |v: usize| {
        let pair = &picture.luma[v * picture.width + u..][..2];
        f64::from(pair[0]) + (f64::from(pair[1]) - f64::from(pair[0])) * fu
    };
    let (upper, lower) = (row(v), row(v + 1));
    Some(upper + (lower - upper) * fv)
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_geometry::{Euler, Lens, LensModel, LensParameters};

    fn projector() -> Projector {
        let model = LensModel::KannalaBrandt { k: [-0.01, 0.002, 0.0, 0.0] };
        let parameters = LensParameters {
            width: 320,
            height: 240,
            fx: 105.0,
            fy: 105.0,
            cx: 161.0,
            cy: 118.0,
            model,
            fov_deg: Some(170.0),
        };
        Projector::new(&Lens::new(parameters).expect("a lens"))
    }

    fn pose(x: f64, y: f64, yaw_deg: f64) -> Isometry {
        let euler = Euler { yaw: yaw_deg.to_radians(), pitch: 0.6, roll: 0.01 };
        Isometry::from_euler(euler, DVec3::new(x, y, 0.5)) * Isometry::link_from_optical()
    }

    /// Smooth blots of some centimetres.
    fn lawn(place: DVec2) -> f64 {
        let corner = |x: f64, y: f64| {
            let number = (x as i64).wrapping_mul(73_856_093) ^ (y as i64).wrapping_mul(19_349_663);
            f64::from((number as u32).wrapping_mul(2_654_435_761) >> 16) / 65_536.0
        };
        let cell = (place / 0.05).floor();
        let part = place / 0.05 - cell;
        let part = part * part * (DVec2::splat(3.0) - 2.0 * part);
        let row = |y: f64| corner(cell.x, y) + (corner(cell.x + 1.0, y) - corner(cell.x, y)) * part.x;
        60.0 + 120.0 * (row(cell.y) + (row(cell.y + 1.0) - row(cell.y)) * part.y)
    }

    fn picture(projector: &Projector, pose: &Isometry, ground: impl Fn(DVec2) -> f64) -> Picture {
        let gray = |u: usize, v: usize| {
            let Some(ray) = projector.lens().unproject(DVec2::new(u as f64, v as f64)) else { return 0 };
            let ray = pose.transform_vector(ray);
            let distance = -pose.translation.z / ray.z;
            if distance > 0.0 { ground((pose.translation + ray * distance).truncate()) as u8 } else { 90 }
        };
        Picture::from_gray(320, 240, (0..320 * 240).map(|i| gray(i % 320, i / 320)).collect()).expect("fits")
    }

    #[test]
    fn ground_is_found_again_though_both_tags_are_off() {
        let projector = projector();
        let (before, here) = (pose(0.0, 0.0, 0.0), pose(0.06, 0.02, 6.0));
        let pictures = [before, here].map(|pose| picture(&projector, &pose, lawn));
        // As tags are: a centimetre and half a degree.
        let tagged = pose(0.07, 0.02, 6.5);
        let look = |which: usize, map_from_optical| Look { picture: &pictures[which], map_from_optical };
        let found = matches(&projector, &look(0, before), &look(1, tagged), |_| false);
        assert!(found.len() > 30, "{}", found.len());
        let mut off: Vec<f64> = (found.iter())
            .map(|shared| {
                let ray = before.transform_vector(projector.lens().unproject(shared.before).expect("seen"));
                let place = before.translation - ray * (before.translation.z / ray.z);
                let truth = projector.project(here.inverse().transform_point(place)).expect("seen");
                truth.distance(shared.here)
            })
            .collect();
        off.sort_by(f64::total_cmp);
        assert!(off[off.len() / 2] < 0.1 && off[off.len() * 9 / 10] < 0.3, "{off:?}");
        let hidden = matches(&projector, &look(0, before), &look(1, tagged), |pixel| pixel.y > 120.0);
        assert!(hidden.iter().all(|shared| shared.here.y < 126.0 && shared.before.y <= 120.0));
    }

    #[test]
    fn what_has_no_texture_or_is_of_something_else_matches_nothing() {
        let projector = projector();
        let (before, here) = (pose(0.0, 0.0, 0.0), pose(0.06, 0.02, 6.0));
        let plain = picture(&projector, &before, |_| 90.0);
        let elsewhere = picture(&projector, &before, |place| lawn(place + DVec2::new(3.0, 7.0)));
        let real = picture(&projector, &here, lawn);
        let small = Picture::from_gray(8, 8, vec![0; 64]).expect("fits");
        for other in [&plain, &elsewhere, &small] {
            let look = Look { picture: other, map_from_optical: before };
            let found = matches(&projector, &look, &Look { picture: &real, map_from_optical: here }, |_| false);
            assert!(found.len() <= 2, "{}", found.len());
        }
        let nan = Look { picture: &plain, map_from_optical: Isometry { translation: DVec3::NAN, ..before } };
        assert!(matches(&projector, &nan, &Look { picture: &real, map_from_optical: here }, |_| false).is_empty());
    }
}
