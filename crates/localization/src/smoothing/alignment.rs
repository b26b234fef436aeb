//! Matching of the same ground in two images by its texture.
//!
//! Patches of the later image are looked for where both tags put them in the earlier one. The earlier image is warped through the
//! ground plane into the later camera (to first order over a patch) and then shifted until both agree: by whole pixels with
//! correlation, and by fractions with the method of Lucas and Kanade (1981). The module is pure.

use glam::{DMat2, DVec2, DVec3};

use super::Match;
use realitysim_geometry::{Isometry, Projector};
use realitysim_vision::Picture;

/// An image with the pose at which its tag puts its camera.
#[derive(Clone, Copy, Debug)]
pub struct Look<'a> {
    /// The image.
    pub picture: &'a Picture,
    /// Pose of the camera in `map`.
    pub map_from_optical: Isometry,
}

/// Distance between the patches that are tried, pixels.
const GRID: usize = 24;
/// Half the side of a patch, pixels, without its middle.
const HALF_SIDE: i32 = 5;
const AREA: usize = ((2 * HALF_SIDE + 1) * (2 * HALF_SIDE + 1)) as usize;
/// Largest error of the tags that is searched, pixels.
const SEARCH_PX: i32 = 4;
/// Largest number of matches of a pair of images: those with the most texture.
const MAX_MATCHES: usize = 60;
/// Largest distance of a patch from the camera, metres: beyond it a pixel covers too much ground for texture.
const RANGE_LIMIT_M: f64 = 3.0;
/// Least texture: smaller eigenvalue of the mean squared gradient, in gray levels squared.
const MIN_TEXTURE: f64 = 6.0;
/// Correlation above which two patches show the same.
const MIN_CORRELATION: f64 = 0.8;
/// Largest number of iterations.
const ROUNDS: usize = 8;

/// Finds points of the ground that both images show. `hides` tells whether a pixel of either image shows the robot itself.
pub fn matches(projector: &Projector, before: &Look, here: &Look, hides: impl Fn(DVec2) -> bool) -> Vec<Match> {
    let (width, height) = (here.picture.width, here.picture.height);
    let fits = |look: &Look| look.picture.luma.len() == width * height;
    let edge = (HALF_SIDE + SEARCH_PX + 2) as usize;
    if !fits(before) || !fits(here) || width.min(height) <= 2 * edge {
        return Vec::new();
    }
    let rows = (edge..height - edge).step_by(GRID);
    let tried = rows.flat_map(|v| (edge..width - edge).step_by(GRID).map(move |u| (u, v)));
    let mut textured: Vec<(f64, [usize; 2])> = tried
        .filter(|(u, v)| !hides(DVec2::new(*u as f64, *v as f64)))
        .map(|(u, v)| (texture(here.picture, [u, v]), [u, v]))
        .filter(|(texture, _)| *texture > MIN_TEXTURE)
        .collect();
    textured.sort_by(|a, b| b.0.total_cmp(&a.0));
    let found = textured.into_iter().filter_map(|(_, pixel)| {
        let seen = PatchMap::new(projector, before, here, DVec2::from(pixel.map(|value| value as f64)))?;
        let known = !hides(seen.before);
        known.then(|| seen.find(before.picture, here.picture, pixel)).flatten()
    });
    found.take(MAX_MATCHES).collect()
}

/// An affine map from the surroundings of a pixel of the later image into the earlier image.
struct PatchMap {
    /// Pixel of the earlier image.
    before: DVec2,
    /// Derivative of the earlier image's pixel by the later one's.
    turn: DMat2,
}

impl PatchMap {
    /// Projects the surroundings of pixel `at` through the ground; `None` if it is too far away or not in the earlier image.
    fn new(projector: &Projector, before: &Look, here: &Look, at: DVec2) -> Option<Self> {
        let earlier_from_map = before.map_from_optical.inverse();
        let place = |pixel: DVec2| -> Option<DVec2> {
            let ray: DVec3 = here.map_from_optical.transform_vector(projector.lens().unproject(pixel)?);
            let from = here.map_from_optical.translation;
            let distance = -from.z / ray.z;
            let near = distance > 0.0 && distance < RANGE_LIMIT_M;
            near.then(|| projector.project_inside(earlier_from_map.transform_point(from + ray * distance))).flatten()
        };
        let reach = f64::from(HALF_SIDE);
        let middle = place(at)?;
        let [x, y] = [DVec2::X, DVec2::Y]
            .map(|axis| Some((place(at + axis * reach)? - place(at - axis * reach)?) / (2.0 * reach)));
        Some(Self { before: middle, turn: DMat2::from_cols(x?, y?) })
    }

    /// Finds where the later image shows the patch of the earlier one.
    fn find(&self, before: &Picture, here: &Picture, pixel: [usize; 2]) -> Option<Match> {
        let mut wanted = [0.0; AREA];
        for (value, offset) in wanted.iter_mut().zip(offsets()) {
            *value = gray(before, self.before + self.turn * offset)?;
        }
        let wanted = Patch::new(wanted)?;
        let mut best = (f64::NEG_INFINITY, DVec2::ZERO);
        for (dx, dy) in (-SEARCH_PX..=SEARCH_PX).flat_map(|dy| (-SEARCH_PX..=SEARCH_PX).map(move |dx| (dx, dy))) {
            let shifted = [pixel[0].wrapping_add_signed(dx as isize), pixel[1].wrapping_add_signed(dy as isize)];
            let patch = Patch::new(grays(here, shifted));
            let alike = patch.map_or(f64::NEG_INFINITY, |patch| patch.correlation(&wanted));
            if alike > best.0 {
                best = (alike, DVec2::new(f64::from(dx), f64::from(dy)));
            }
        }
        let at = DVec2::from(pixel.map(|value| value as f64));
        let mut shift = best.1;
        for _ in 0..ROUNDS {
            let step = step(here, at + shift, &wanted)?;
            shift += step;
            if step.length() < 0.01 {
                break;
            }
        }
        let found = Patch::at(here, at + shift)?;
        let good = found.correlation(&wanted) > MIN_CORRELATION && (shift - best.1).length() < 1.5;
        good.then_some(Match { before: self.before, here: at + shift })
    }
}

/// Gray values of a patch, normalised to mean 0 and length 1.
struct Patch([f64; AREA]);

impl Patch {
    /// Normalises the values; `None` if they have no texture.
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

    /// Correlation of two patches.
    fn correlation(&self, other: &Self) -> f64 {
        self.0.iter().zip(&other.0).map(|(a, b)| a * b).sum()
    }
}

fn offsets() -> impl Iterator<Item = DVec2> {
    (-HALF_SIDE..=HALF_SIDE).flat_map(|y| (-HALF_SIDE..=HALF_SIDE).map(move |x| DVec2::new(f64::from(x), f64::from(y))))
}

/// One Gauss-Newton step of the shift; brightness and contrast are taken from the patches.
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
    (step.is_finite() && step.length() < f64::from(HALF_SIDE)).then_some(step)
}

/// Smaller eigenvalue of the mean squared gradient around a pixel, which is at least `HALF_SIDE + 1` from the edge.
fn texture(picture: &Picture, [u, v]: [usize; 2]) -> f64 {
    let half = HALF_SIDE as usize;
    let gray = |u: usize, v: usize| f64::from(picture.luma[v * picture.width + u]);
    let [mut a, mut b, mut c] = [0.0; 3];
    for (u, v) in (v - half..=v + half).flat_map(|v| (u - half..=u + half).map(move |u| (u, v))) {
        let (x, y) = ((gray(u + 1, v) - gray(u - 1, v)) / 2.0, (gray(u, v + 1) - gray(u, v - 1)) / 2.0);
        (a, b, c) = (a + x * x, b + x * y, c + y * y);
    }
    let (mean, half) = ((a + c) / 2.0, (a - c) / 2.0);
    (mean - libm::sqrt(half * half + b * b)) / AREA as f64
}

fn gradient(picture: &Picture, at: DVec2) -> Option<DVec2> {
    let across = |axis: DVec2| Some((gray(picture, at + axis)? - gray(picture, at - axis)?) / 2.0);
    Some(DVec2::new(across(DVec2::X)?, across(DVec2::Y)?))
}

/// Gray values around a pixel, which is at least `HALF_SIDE` from the edge.
fn grays(picture: &Picture, [u, v]: [usize; 2]) -> [f64; AREA] {
    let (side, half) = (2 * HALF_SIDE as usize + 1, HALF_SIDE as usize);
    let mut values = [0.0; AREA];
    for (row, line) in values.chunks_exact_mut(side).enumerate() {
        let from = &picture.luma[(v + row - half) * picture.width + u - half..][..side];
        line.iter_mut().zip(from).for_each(|(value, gray)| *value = f64::from(*gray));
    }
    values
}

/// Bilinear gray value; `None` outside of the image.
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

    /// The brightness of a lawn with smooth blots of some centimetres.
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
        // The tag is off by what tags are: a centimetre and half a degree.
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
