//! A sphere that rests on the carpet, such as a ball: found by a pixel of one image, and labelled in others.

use glam::{DVec2, DVec3};
use thiserror::Error;

use realitysim_geometry::Isometry;

use crate::class_map::SIGMAS;
use crate::{PoseCovariance, PosedImage};

/// Standard deviation of a pixel that a person points at, along each axis, pixels.
pub const POINTING_SIGMA_PX: f64 = 0.5;
/// Boxes of which a smaller share of the sphere's disc is in the picture and not behind the robot's own body are left out.
pub const MIN_SHOWN_SHARE: f64 = 0.5;
/// Boxes that are smaller, in pixels, are left out.
const MIN_BOX_PX: f64 = 3.0;
/// Boxes are left out whose shift by [`SIGMAS`] standard deviations is a larger share of their smaller side: about two thirds of the box
/// would still overlap.
const MAX_SHIFT_SHARE: f64 = 1.0 / 3.0;
/// Points around the outline; between two of them it bulges by 0.03 % of its radius.
const OUTLINE_POINTS: usize = 128;
/// Points across the disc by which the shown share is counted.
const DISC_POINTS: i32 = 16;

/// A sphere that rests on the plane z = 0 of `map`, found by its middle in one image.
#[derive(Clone, Copy, Debug)]
pub struct RestingSphere {
    /// Its centre in `map`, metres; z is the radius.
    pub centre: DVec3,
    /// Radius, metres.
    pub radius_m: f64,
    /// Pose of `camera_link` in `map` by which it was found.
    found_from: Isometry,
    covariance: PoseCovariance,
    /// What a step of one pixel along u and along v moves the centre by, metres.
    per_pixel: [DVec3; 2],
}

/// The box around a sphere in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphereBox {
    /// Left upper corner, pixels; the left upper corner of the image is (0, 0), so that the first pixel's centre is (0.5, 0.5).
    pub from: DVec2,
    /// Right lower corner, pixels.
    pub to: DVec2,
    /// Standard deviation of its place along the longer axis, pixels: from the covariances of both poses and [`POINTING_SIGMA_PX`].
    pub sigma_px: f64,
    /// Share of the sphere's disc that is in the picture and not behind the robot's own body.
    pub shown_share: f64,
}

/// Why a pixel determines no sphere.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum NoSphere {
    /// The pixel is not in the image.
    #[error("the pixel is not in the image, which has {width} x {height} pixels counted from 0")]
    Outside {
        /// Width of the image, pixels.
        width: usize,
        /// Height of the image, pixels.
        height: usize,
    },
    /// The lens draws nothing there.
    #[error("the lens draws nothing at this pixel")]
    Dark,
    /// The ray does not meet the plane of the centres of such spheres.
    #[error("nothing that rests on the carpet and has this radius has its middle there: the pixel looks over it")]
    Above,
}

/// Why an image has no box of a sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoBox {
    /// Most of the sphere is out of the picture, behind the camera or behind the robot's own body.
    NotShown,
    /// It is smaller than a detector could find.
    Small,
    /// The poses do not tell well enough where it is.
    Uncertain,
}

impl RestingSphere {
    /// Finds the sphere of a radius whose middle the pixel `at` of an image shows; the first pixel's centre is (0, 0).
    ///
    /// # Errors
    ///
    /// [`NoSphere`] if there is no such place.
    pub fn find(image: &PosedImage, at: DVec2, radius_m: f64) -> Result<Self, NoSphere> {
        let [width, height] = [image.camera.width(), image.camera.height()];
        if !at.is_finite() || !image.camera.lens().contains(at) {
            return Err(NoSphere::Outside { width, height });
        }
        if image.camera.lens().unproject(at).is_none() {
            return Err(NoSphere::Dark);
        }
        let meets = |at: DVec2| meet_plane(image, at, radius_m);
        let centre = meets(at).ok_or(NoSphere::Above)?;
        let step = 1e-3;
        let per_pixel = [DVec2::X, DVec2::Y].map(|axis| {
            let beside = meets(at + axis * step).map(|there| (there - centre) / step);
            beside.or_else(|| meets(at - axis * step).map(|there| (centre - there) / step)).unwrap_or(DVec3::ZERO)
        });
        Ok(Self { centre, radius_m, found_from: image.map_from_link, covariance: image.covariance, per_pixel })
    }

    /// The box around the sphere in an image.
    ///
    /// # Errors
    ///
    /// [`NoBox`] if the image does not show enough of it, or it is not known well enough where.
    pub fn label(&self, image: &PosedImage) -> Result<SphereBox, NoBox> {
        let disc = Disc::of(self, image).ok_or(NoBox::NotShown)?;
        let shown_share = disc.shown_share(image);
        if shown_share < MIN_SHOWN_SHARE {
            return Err(NoBox::NotShown);
        }
        let size = DVec2::new(image.camera.width() as f64, image.camera.height() as f64);
        let corner = |pixel: DVec2| (pixel + 0.5).clamp(DVec2::ZERO, size);
        let outline: Vec<DVec2> = disc.outline().filter_map(|ray| image.camera.lens().project(ray)).collect();
        let from = outline.iter().copied().map(corner).reduce(DVec2::min).ok_or(NoBox::NotShown)?;
        let to = outline.iter().copied().map(corner).reduce(DVec2::max).ok_or(NoBox::NotShown)?;
        let side = (to - from).min_element();
        if side < MIN_BOX_PX {
            return Err(NoBox::Small);
        }
        let sigma_px = self.sigma_px(image);
        if SIGMAS * sigma_px > MAX_SHIFT_SHARE * side {
            return Err(NoBox::Uncertain);
        }
        Ok(SphereBox { from, to, sigma_px, shown_share })
    }

    /// Standard deviation of the pixel of the centre in an image along its longer axis, pixels.
    ///
    /// The errors of two images' poses count as independent. Those of the image by which the sphere was found cancel, because the same
    /// pose leads from the pixel to the carpet and back.
    fn sigma_px(&self, image: &PosedImage) -> f64 {
        let map_from_optical = image.map_from_link * Isometry::link_from_optical();
        let optical_from_map = map_from_optical.inverse();
        let pixel = |at: DVec3| image.camera.lens().project(optical_from_map.transform_point(at));
        let arm = self.centre - map_from_optical.translation;
        let step = 1e-4 * arm.length();
        let derivative = |axis: DVec3| match (pixel(self.centre + axis * step), pixel(self.centre - axis * step)) {
            (Some(after), Some(before)) => (after - before) / (2.0 * step),
            _ => DVec2::ZERO,
        };
        let jacobian = [DVec3::X, DVec3::Y, DVec3::Z].map(derivative);
        let sigma = |angle: f64| {
            let direction = DVec2::from_angle(angle);
            let along = DVec3::from_array(jacobian.map(|column| column.dot(direction)));
            let mut variance: f64 =
                self.per_pixel.iter().map(|step| (POINTING_SIGMA_PX * step.dot(along)).powi(2)).sum();
            if self.found_from != image.map_from_link {
                variance += self.found_sigma(along).powi(2) + image.covariance.sigma_along(along, arm).powi(2);
            }
            libm::sqrt(variance)
        };
        (0..8).map(|step| sigma(core::f64::consts::PI * f64::from(step) / 8.0)).fold(0.0, f64::max)
    }

    /// Standard deviation of `direction . centre` that comes from the pose by which the sphere was found, metres.
    fn found_sigma(&self, direction: DVec3) -> f64 {
        let from = (self.found_from * Isometry::link_from_optical()).translation;
        let ray = (self.centre - from).normalize_or(DVec3::NEG_Z);
        self.covariance.ground_sigma(direction.with_z(0.0), ray, from.z - self.radius_m)
    }
}

/// Where the ray of a pixel meets the plane at a height above the carpet.
fn meet_plane(image: &PosedImage, at: DVec2, height_m: f64) -> Option<DVec3> {
    let map_from_optical = image.map_from_link * Isometry::link_from_optical();
    let ray = map_from_optical.rotation * image.camera.lens().unproject(at)?;
    let from = map_from_optical.translation;
    let distance = (height_m - from.z) / ray.z;
    let is_ahead = ray.z < 0.0 && distance.is_finite() && distance > 0.0;
    is_ahead.then(|| (from + ray * distance).with_z(height_m))
}

/// The cone of rays that meet a sphere, in `camera_optical_frame`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Disc {
    /// Unit ray to the centre.
    axis: DVec3,
    /// Unit vectors across it: to the right, and up as seen from the camera with `map`'s z up.
    across: [DVec3; 2],
    /// Tangent of half the cone's angle.
    tangent: f64,
}

impl Disc {
    /// `None` if the camera is within the sphere.
    pub(crate) fn of(sphere: &RestingSphere, image: &PosedImage) -> Option<Self> {
        let optical_from_map = (image.map_from_link * Isometry::link_from_optical()).inverse();
        let centre = optical_from_map.transform_point(sphere.centre);
        let distance = centre.length();
        if distance <= sphere.radius_m {
            return None;
        }
        let axis = centre / distance;
        let up = optical_from_map.rotation * DVec3::Z;
        let up = (up - axis * up.dot(axis)).try_normalize().unwrap_or(axis.any_orthonormal_vector());
        let sine = sphere.radius_m / distance;
        Some(Self { axis, across: [axis.cross(up), up], tangent: sine / libm::sqrt(1.0 - sine * sine) })
    }

    /// The ray through a point of the disc's plane, in radii from its middle: right and up.
    pub(crate) fn ray(&self, at: DVec2) -> DVec3 {
        self.axis + (self.across[0] * at.x + self.across[1] * at.y) * self.tangent
    }

    /// Rays of the outline, which touch the sphere.
    fn outline(&self) -> impl Iterator<Item = DVec3> {
        let angle = |step: usize| core::f64::consts::TAU * step as f64 / OUTLINE_POINTS as f64;
        (0..OUTLINE_POINTS).map(move |step| self.ray(DVec2::from_angle(angle(step))))
    }

    /// Share of the disc that is in the picture and not behind the robot's own body.
    fn shown_share(&self, image: &PosedImage) -> f64 {
        let at = |step: i32| (f64::from(step) + 0.5) * 2.0 / f64::from(DISC_POINTS) - 1.0;
        let places =
            (0..DISC_POINTS).flat_map(|row| (0..DISC_POINTS).map(move |column| DVec2::new(at(column), at(row))));
        let (mut shown, mut all) = (0u32, 0u32);
        for place in places.filter(|place| place.length() <= 1.0) {
            all += 1;
            shown += u32::from(shown_pixel(image, self.ray(place)).is_some());
        }
        f64::from(shown) / f64::from(all.max(1))
    }
}

/// The pixel of a ray in `camera_optical_frame`, if the picture has it and it does not show the robot's own body.
pub(crate) fn shown_pixel(image: &PosedImage, ray: DVec3) -> Option<DVec2> {
    let pixel = image.camera.lens().project(ray).filter(|pixel| image.camera.lens().contains(*pixel))?;
    let index = libm::round(pixel.y) as usize * image.camera.width() + libm::round(pixel.x) as usize;
    let is_body = image.body.get(index).is_some_and(|body| *body);
    (!is_body && image.camera.shows().get(index) == Some(&true)).then_some(pixel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realitysim_config::load_lens;
    use realitysim_geometry::Euler;
    use realitysim_views::Camera;
    use std::sync::LazyLock;

    static CAMERA: LazyLock<Camera> = LazyLock::new(|| Camera::new(&load_lens("fisheye-640").unwrap().lens));

    fn posed(at: DVec3, yaw: f64, pitch: f64, covariance: PoseCovariance) -> PosedImage<'static> {
        let map_from_link = Isometry::from_euler(Euler { yaw, pitch, roll: 0.05 }, at);
        PosedImage { camera: &CAMERA, map_from_link, covariance, shown: &[], body: &[] }
    }

    fn exact(at: DVec3, yaw: f64, pitch: f64) -> PosedImage<'static> {
        posed(at, yaw, pitch, PoseCovariance::isotropic(0.0, 0.0))
    }

    /// The pixel of a point of `map`.
    fn pixel(image: &PosedImage, at: DVec3) -> DVec2 {
        let optical_from_map = (image.map_from_link * Isometry::link_from_optical()).inverse();
        CAMERA.lens().project(optical_from_map.transform_point(at)).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// The box holds all that is seen of the sphere, and its sides touch it.
        #[test]
        fn a_box_holds_the_surface_and_its_sides_touch_it(
            x in 0.5..2.5f64, y in -0.8..0.8f64, radius_m in 0.05..0.3f64, yaw in -0.3..0.3f64, height in 0.4..1.2f64,
        ) {
            let image = exact(DVec3::new(0.0, 0.0, height), yaw, 0.4);
            let centre = DVec3::new(x, y, radius_m);
            let sphere = RestingSphere::find(&image, pixel(&image, centre), radius_m).unwrap();
            prop_assert!(sphere.centre.distance(centre) < 1e-6);
            let Ok(found) = sphere.label(&image) else { return Ok(()) };
            prop_assume!(found.shown_share == 1.0);
            let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
            // Points of the surface, evenly over it (a Fibonacci lattice).
            for step in 0..5_000 {
                let z = 1.0 - (2.0 * f64::from(step) + 1.0) / 5_000.0;
                let turn = DVec2::from_angle(2.399_963_229_728_653 * f64::from(step)) * (1.0 - z * z).sqrt();
                let at = pixel(&image, centre + turn.extend(z) * radius_m) + 0.5;
                (low, high) = (low.min(at), high.max(at));
            }
            let slack = 0.003 * (high - low).max_element() + 0.01;
            for (outside, touched) in [(found.from - low, low - found.from), (high - found.to, found.to - high)] {
                prop_assert!(outside.max_element() <= slack, "{found:?} {low} {high}");
                prop_assert!(touched.max_element() <= 2.0 * slack, "{found:?} {low} {high}");
            }
        }

        /// What a small error of both poses and of the pointing moves the box by is what it states.
        #[test]
        fn the_stated_error_is_that_of_moved_poses(
            moved in prop::array::uniform6(-1.0..1.0f64), other in prop::array::uniform6(-1.0..1.0f64),
        ) {
            let step = 1e-6;
            let rows = |moved: [f64; 6]| PoseCovariance::from_rows(&core::array::from_fn(|at| moved[at / 6] * moved[at % 6])).unwrap();
            let shifted = |image: &PosedImage<'static>, moved: [f64; 6]| {
                let [x, y, z, a, b, c] = moved.map(|part| part * step);
                let pose = image.map_from_link;
                let turn = glam::DQuat::from_scaled_axis(DVec3::new(a, b, c));
                let map_from_link = Isometry::new(turn * pose.rotation, pose.translation + DVec3::new(x, y, z));
                PosedImage { map_from_link, ..*image }
            };
            let (at, radius_m) = (DVec3::new(1.2, 0.3, 0.07), 0.07);
            let (first, second) = (
                posed(DVec3::new(0.0, 0.0, 0.5), 0.1, 0.3, rows(moved)),
                posed(DVec3::new(1.5, -1.0, 0.5), 1.6, 0.3, rows(other)),
            );
            let clicked = pixel(&first, at);
            let truth = pixel(&second, at);
            let from_first = RestingSphere::find(&shifted(&first, moved), clicked, radius_m).unwrap();
            let by_first = (pixel(&second, from_first.centre) - truth) / step;
            let by_second = (pixel(&shifted(&second, other), at) - truth) / step;
            let sphere = RestingSphere::find(&first, clicked, radius_m).unwrap();
            let by_click = sphere.per_pixel.map(|moved| (pixel(&second, at + moved * step) - truth) / step * POINTING_SIGMA_PX);
            let all = [by_first, by_second, by_click[0], by_click[1]];
            let along = |angle: f64| all.iter().map(|by| by.dot(DVec2::from_angle(angle)).powi(2)).sum::<f64>().sqrt();
            let expected = (0..8).map(|part| along(core::f64::consts::PI * f64::from(part) / 8.0)).fold(0.0, f64::max);
            let stated = sphere.sigma_px(&second);
            prop_assert!((stated - expected).abs() < 1e-3 * expected + 1e-3, "{stated} {expected}");
        }
    }

    #[test]
    fn the_frame_pointed_at_gets_its_own_pixel_back() {
        let image = posed(DVec3::new(0.0, 0.0, 0.5), 0.1, 0.3, PoseCovariance::isotropic(0.05, 0.02));
        let at = DVec2::new(330.0, 250.0);
        let sphere = RestingSphere::find(&image, at, 0.07).unwrap();
        assert!(pixel(&image, sphere.centre).distance(at) < 1e-9);
        let found = sphere.label(&image).unwrap();
        // Its own pose's error does not matter in it: that of pointing is left.
        assert!((found.sigma_px - POINTING_SIGMA_PX).abs() < 0.01, "{found:?}");
        let middle = (found.from + found.to) / 2.0 - 0.5;
        assert!(middle.distance(at) < 0.5, "{middle}");
    }

    #[test]
    fn a_pixel_that_determines_no_sphere_is_told_why() {
        let image = exact(DVec3::new(0.0, 0.0, 0.5), 0.0, 0.3);
        let find = |u: f64, v: f64, radius_m: f64| RestingSphere::find(&image, DVec2::new(u, v), radius_m).unwrap_err();
        assert_eq!(find(640.0, 10.0, 0.07), NoSphere::Outside { width: 640, height: 480 });
        assert_eq!(find(f64::NAN, 10.0, 0.07), NoSphere::Outside { width: 640, height: 480 });
        assert_eq!(find(320.0, 20.0, 0.07), NoSphere::Above);
        assert_eq!(find(320.0, 240.0, 0.9), NoSphere::Above);
    }

    #[test]
    fn a_box_is_left_out_behind_the_camera_and_where_it_is_not_known() {
        let front = exact(DVec3::new(0.0, 0.0, 0.5), 0.0, 0.3);
        let sphere = RestingSphere::find(&front, pixel(&front, DVec3::new(1.0, 0.0, 0.07)), 0.07).unwrap();
        let label = |image: PosedImage| sphere.label(&image).map(|found| found.shown_share);
        assert_eq!(label(front), Ok(1.0));
        assert_eq!(label(exact(DVec3::new(0.0, 0.0, 0.5), 3.1, 0.3)), Err(NoBox::NotShown));
        assert_eq!(label(exact(DVec3::new(1.0, 0.0, 0.05), 0.0, 0.3)), Err(NoBox::NotShown));
        assert_eq!(label(exact(DVec3::new(-12.0, 0.0, 0.5), 0.0, 0.3)), Err(NoBox::Small));
        let vague = posed(DVec3::new(0.0, 0.1, 0.5), 0.0, 0.3, PoseCovariance::isotropic(0.1, 0.1));
        assert_eq!(label(vague), Err(NoBox::Uncertain));
        let body = vec![true; CAMERA.width() * CAMERA.height()];
        assert_eq!(label(PosedImage { body: &body, ..front }), Err(NoBox::NotShown));
    }
}
