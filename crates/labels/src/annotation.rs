//! The landmarks of one image: where they are, how far that can be trusted, and boxes around them.

use glam::{DMat2, DVec2, DVec3};
use serde::Serialize;

use realitysim_geometry::{Isometry, Lens, longest_axis};
use realitysim_views::SURE;

use crate::class_map::PosedImage;
use crate::landmarks::LandmarkKind;
use crate::{Class, Labeller};

/// Whether a landmark can be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Visibility {
    /// Outside of the image.
    Outside,
    /// In the image, behind a post, the robot's own body, or something that moves.
    Hidden,
    /// In the image, with nothing before it that is known.
    Visible,
}

/// A landmark in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Where it is, pixels; the first pixel's centre is (0, 0). Of no meaning outside of the image.
    pub at: DVec2,
    /// Standard deviation of `at` along its longer axis, pixels, from the covariance of the pose.
    pub sigma_px: f64,
    /// Covariance of `at`, square pixels, from the covariance of the pose.
    pub covariance_px2: DMat2,
    /// Whether it can be seen.
    pub visibility: Visibility,
}

/// A box around a landmark or a post.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelBox {
    /// What it is around: [`LandmarkKind::PostFoot`] stands for a whole post.
    pub kind: LandmarkKind,
    /// Left upper corner, pixels; the left upper corner of the image is (0, 0), so that the first pixel's centre is (0.5, 0.5).
    pub from: DVec2,
    /// Right lower corner, pixels.
    pub to: DVec2,
    /// Share of it that shows something that moves, the robot itself, or nothing.
    pub hidden_share: f64,
}

/// Half the side of the ground that a box of a crossing or mark shows, metres.
const PATCH_M: f64 = 0.15;
/// Points around a patch.
const PATCH_POINTS: usize = 16;
/// Points along a post.
const POST_POINTS: usize = 17;
/// Boxes of which a larger share is hidden are left out.
const HIDDEN_SHARE_LIMIT: f64 = 0.6;
/// Boxes that are smaller, in pixels, are left out.
const MIN_BOX_PX: f64 = 3.0;

impl Labeller {
    /// The landmarks of the field in an image, in the order of [`Labeller::landmarks`].
    pub fn keypoints(&self, image: &PosedImage) -> Vec<Keypoint> {
        let seen = Seen::new(self, image);
        self.landmarks.iter().map(|landmark| seen.keypoint(landmark.at)).collect()
    }

    /// Boxes around the crossings, marks and posts that can be seen.
    pub fn boxes(&self, image: &PosedImage) -> Vec<LabelBox> {
        self.landmark_boxes(image).into_iter().flatten().collect()
    }

    /// The box of each landmark, in the order of [`Labeller::landmarks`]; `None` if it cannot be seen.
    pub fn landmark_boxes(&self, image: &PosedImage) -> Vec<Option<LabelBox>> {
        let seen = Seen::new(self, image);
        self.landmarks.iter().map(|landmark| seen.label_box(landmark.kind, landmark.at)).collect()
    }

    /// For each column of the image: the first row, from above, whose pixel shows the carpet or paint on it, or the image's height where none does.
    pub fn border(&self, image: &PosedImage, classes: &[Class]) -> Vec<usize> {
        let (width, height) = (image.camera.width(), image.camera.height());
        let is_carpet = |class: Class| matches!(class, Class::Carpet | Class::Line);
        (0..width).map(|u| (0..height).find(|v| is_carpet(classes[v * width + u])).unwrap_or(height)).collect()
    }
}

/// One image and the goals in it.
pub(crate) struct Seen<'a> {
    labeller: &'a Labeller,
    image: &'a PosedImage<'a>,
    lens: &'a Lens,
    map_from_optical: Isometry,
    optical_from_map: Isometry,
    goals: crate::goals::SeenGoals<'a>,
}

impl<'a> Seen<'a> {
    pub(crate) fn new(labeller: &'a Labeller, image: &'a PosedImage<'a>) -> Self {
        let map_from_optical = image.map_from_link * Isometry::link_from_optical();
        let (lens, optical_from_map) = (image.camera.lens(), map_from_optical.inverse());
        let goals = labeller.goals.seen_by(lens, &map_from_optical);
        Self { labeller, image, lens, map_from_optical, optical_from_map, goals }
    }

    /// Width of the image, pixels.
    pub(crate) fn width(&self) -> usize {
        self.image.camera.width()
    }

    /// Height of the image, pixels.
    pub(crate) fn height(&self) -> usize {
        self.image.camera.height()
    }

    /// Where the ray of a pixel meets the ground in `map`.
    pub(crate) fn ground(&self, pixel: DVec2) -> Option<DVec3> {
        let ray = self.map_from_optical.rotation * self.lens.unproject(pixel)?;
        let from = self.map_from_optical.translation;
        (ray.z < 0.0 && from.z > 0.0).then(|| from + ray * (from.z / -ray.z))
    }

    fn pixel(&self, at: DVec3) -> Option<DVec2> {
        self.lens.project(self.optical_from_map.transform_point(at)).filter(|pixel| self.lens.contains(*pixel))
    }

    fn keypoint(&self, at: DVec3) -> Keypoint {
        let Some(pixel) = self.pixel(at) else {
            let (at, covariance_px2) = (DVec2::ZERO, DMat2::ZERO);
            return Keypoint { at, sigma_px: 0.0, covariance_px2, visibility: Visibility::Outside };
        };
        let arm = at - self.map_from_optical.translation;
        let (distance, ray) = (arm.length(), arm.normalize_or(DVec3::X));
        let hidden = !self.shows_scene(pixel) || self.goals.hides(pixel, ray, distance);
        let visibility = if hidden { Visibility::Hidden } else { Visibility::Visible };
        let (covariance_px2, sigma_px) = (self.covariance_px2(at, pixel), self.sigma_px(at, pixel));
        Keypoint { at: pixel, sigma_px, covariance_px2, visibility }
    }

    /// Standard deviation of the pixel of a point along its longer axis, pixels.
    pub(crate) fn sigma_px(&self, at: DVec3, pixel: DVec2) -> f64 {
        let covariance_px2 = self.covariance_px2(at, pixel);
        longest_axis(covariance_px2.x_axis.x, covariance_px2.x_axis.y, covariance_px2.y_axis.y)
    }

    /// Covariance of the pixel of a point, square pixels.
    fn covariance_px2(&self, at: DVec3, pixel: DVec2) -> DMat2 {
        let arm = at - self.map_from_optical.translation;
        // What a step of the point moves its pixel by, along two axes across the ray.
        let step = 1e-3 * arm.length();
        let (first, second) = arm.normalize_or(DVec3::X).any_orthonormal_pair();
        let moved = |axis: DVec3| {
            let there = self.lens.project(self.optical_from_map.transform_point(at + axis * step));
            there.map_or(DVec2::ZERO, |there| (there - pixel) / step)
        };
        let (by_first, by_second) = (moved(first), moved(second));
        let along_u = first * by_first.x + second * by_second.x;
        let along_v = first * by_first.y + second * by_second.y;
        let entry = |a, b| self.image.covariance.covariance_along([a, b], arm);
        let mixed = entry(along_u, along_v);
        DMat2::from_cols_array(&[entry(along_u, along_u), mixed, mixed, entry(along_v, along_v)])
    }

    /// Whether the pixel shows the scene: neither the robot itself, nor something that moves, nor nothing.
    fn shows_scene(&self, pixel: DVec2) -> bool {
        let index = libm::round(pixel.y) as usize * self.image.camera.width() + libm::round(pixel.x) as usize;
        self.image.shown.get(index) == Some(&SURE) && !self.image.body.get(index).is_some_and(|body| *body)
    }

    fn label_box(&self, kind: LandmarkKind, at: DVec3) -> Option<LabelBox> {
        let points: Vec<DVec3> = match kind {
            LandmarkKind::PostTop => return None,
            LandmarkKind::PostFoot => self.post(at),
            _ => patch(at),
        };
        let pixels: Vec<DVec2> = points.iter().filter_map(|point| self.pixel(*point)).collect();
        // Of a crossing that is half outside, a detector cannot tell the kind.
        let is_shown = if kind == LandmarkKind::PostFoot { pixels.len() >= 4 } else { 2 * pixels.len() > points.len() };
        if !is_shown {
            return None;
        }
        let size = DVec2::new(self.image.camera.width() as f64, self.image.camera.height() as f64);
        let corner = |pixel: DVec2| (pixel + 0.5).clamp(DVec2::ZERO, size);
        let from = pixels.iter().copied().map(corner).reduce(DVec2::min)?;
        let to = pixels.iter().copied().map(corner).reduce(DVec2::max)?;
        let hidden_share = self.hidden_share(from, to);
        let is_useful = (to - from).min_element() >= MIN_BOX_PX && hidden_share <= HIDDEN_SHARE_LIMIT;
        is_useful.then_some(LabelBox { kind, from, to, hidden_share })
    }

    /// Points of the outline of the post whose foot is at `at`.
    fn post(&self, at: DVec3) -> Vec<DVec3> {
        let Some(goal) = self.labeller.field.dimensions().goal else { return Vec::new() };
        let radius = goal.post_diameter_m / 2.0;
        let away = (at - self.map_from_optical.translation).truncate().normalize_or(DVec2::X);
        let across = away.perp().extend(0.0) * radius;
        let along = (0..POST_POINTS).map(|i| DVec3::Z * (goal.height_m + radius) * i as f64 / (POST_POINTS - 1) as f64);
        along.flat_map(|up| [at + up - across, at + up + across]).collect()
    }

    fn hidden_share(&self, from: DVec2, to: DVec2) -> f64 {
        let (width, height) = (self.image.camera.width(), self.image.camera.height());
        let range = |from: f64, to: f64, end: usize| from as usize..(libm::ceil(to) as usize).min(end);
        let (mut hidden, mut all) = (0u32, 0u32);
        for v in range(from.y, to.y, height) {
            for u in range(from.x, to.x, width) {
                let index = v * width + u;
                let shown = self.image.shown.get(index).copied().unwrap_or_default();
                let body = self.image.body.get(index).is_some_and(|body| *body);
                all += 1;
                hidden += u32::from(body || shown != SURE);
            }
        }
        f64::from(hidden) / f64::from(all.max(1))
    }
}

/// Points around a place of the ground.
fn patch(at: DVec3) -> Vec<DVec3> {
    let around = |i: usize| {
        let (sine, cosine) = libm::sincos(core::f64::consts::TAU * i as f64 / PATCH_POINTS as f64);
        at + DVec3::new(cosine, sine, 0.0) * PATCH_M
    };
    (0..PATCH_POINTS).map(around).collect()
}
