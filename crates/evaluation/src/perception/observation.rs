//! What a detector made of each landmark of a picture, and what it found where there is none.

use glam::{DMat2, DQuat, DVec2, DVec3};

use realitysim_geometry::{Isometry, Lens, wrap_angle};
use realitysim_labels::{Detection, Keypoint, LANDMARK_CLASSES, Labeller, PosedImage, Visibility};
use realitysim_views::{NOTHING, Raster, luma};

use super::bands::Light;

/// A picture that a detector has looked at.
#[derive(Clone, Copy, Debug)]
pub struct JudgedPicture<'a> {
    /// The landmarks of the field.
    pub labeller: &'a Labeller,
    /// Pose and lens, and which pixels show the scene: landmarks are judged there alone.
    pub image: PosedImage<'a>,
    /// Its pixels.
    pub pixels: &'a Raster,
    /// Angular speed of the camera, radians a second. `None` if it is unknown.
    pub speed_rad_s: Option<f64>,
}

/// All that was seen of a detector.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observations {
    /// Angular speed of the camera in each picture, radians a second.
    pub speeds_rad_s: Vec<Option<f64>>,
    /// Landmarks that were to be seen, and false detections.
    pub all: Vec<Observation>,
}

/// A landmark that was to be seen, or a false detection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Number of its class in [`LANDMARK_CLASSES`].
    pub class: usize,
    /// Distance over the ground from the camera, metres; infinite for a false detection above the horizon.
    pub distance_m: f64,
    /// Angle to the optical axis, radians.
    pub off_axis_rad: f64,
    /// Angular speed of the camera, radians a second.
    pub speed_rad_s: Option<f64>,
    /// How bright the picture is around it.
    pub light: Light,
    /// What the detector made of it.
    pub outcome: Outcome,
}

/// What a detector made of a landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// It was to be seen, and no detection is of it.
    Missed,
    /// A detection is of it.
    Found(Offset),
    /// The detection is of no landmark.
    False,
}

/// Where a detection lies, seen from its landmark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// Pixels to the right and down.
    pub pixel: DVec2,
    /// Covariance of the landmark's own pixel.
    pub label_px2: DMat2,
    /// Radians to the left and metres away, on the ground, and the covariance of the label there. `None` above the horizon.
    pub ground: Option<(DVec2, DMat2)>,
}

/// Half the side of the square of pixels whose brightness is that of a landmark's surroundings.
const LIGHT_RADIUS_PX: usize = 8;
/// Step of the derivative of the ground by the pixel.
const STEP_PX: f64 = 0.01;
/// Longest time between tags of which an angular speed is made.
const NEIGHBOUR_WITHIN_NS: i64 = 250_000_000;

/// Compares the detections in a picture with its landmarks, and adds the result to `observations`.
pub fn observe(picture: &JudgedPicture, detections: &[Detection], observations: &mut Observations) {
    let keypoints = picture.labeller.keypoints(&picture.image);
    let matched = picture.labeller.match_detections(&keypoints, detections, picture.image.camera.width());
    let eye = Eye::new(picture);
    observations.speeds_rad_s.push(picture.speed_rad_s);
    for (place, (landmark, keypoint)) in picture.labeller.landmarks().iter().zip(&keypoints).enumerate() {
        let Some(class) = LANDMARK_CLASSES.class(landmark.kind) else { continue };
        if keypoint.visibility != Visibility::Visible {
            continue;
        }
        let detection = matched.iter().position(|of| *of == Some(place)).map(|at| &detections[at]);
        let outcome = detection.map_or(Outcome::Missed, |found| Outcome::Found(eye.offset(found.at, keypoint)));
        observations.all.push(eye.observation(class, keypoint.at, outcome));
    }
    let others = detections.iter().zip(&matched).filter(|(_, of)| of.is_none());
    observations.all.extend(others.map(|(found, _)| eye.observation(found.class, found.at, Outcome::False)));
}

/// The camera of a picture.
struct Eye<'a> {
    picture: &'a JudgedPicture<'a>,
    lens: &'a Lens,
    map_from_optical: Isometry,
}

impl<'a> Eye<'a> {
    fn new(picture: &'a JudgedPicture) -> Self {
        let map_from_optical = picture.image.map_from_link * Isometry::link_from_optical();
        Self { picture, lens: picture.image.camera.lens(), map_from_optical }
    }

    fn observation(&self, class: usize, at: DVec2, outcome: Outcome) -> Observation {
        let ray = self.lens.unproject(at);
        Observation {
            class,
            distance_m: self.polar(at).map_or(f64::INFINITY, |polar| polar.y),
            off_axis_rad: ray.map_or(core::f64::consts::PI, |ray| ray.angle_between(DVec3::Z)),
            speed_rad_s: self.picture.speed_rad_s,
            light: Light::of(mean_luma(self.picture.pixels, at)),
            outcome,
        }
    }

    fn offset(&self, found: DVec2, keypoint: &Keypoint) -> Offset {
        let label_px2 = keypoint.covariance_px2;
        let ground = || {
            let (there, truth) = (self.polar(found)?, self.polar(keypoint.at)?);
            let derivative = self.polar_by_pixel(keypoint.at)?;
            let error = DVec2::new(wrap_angle(there.x - truth.x), there.y - truth.y);
            Some((error, derivative * label_px2 * derivative.transpose()))
        };
        Offset { pixel: found - keypoint.at, label_px2, ground: ground() }
    }

    /// Where a pixel's ray meets the ground, about the foot of the camera: azimuth in `map`, radians, and distance, metres.
    fn polar(&self, pixel: DVec2) -> Option<DVec2> {
        let ray = self.map_from_optical.transform_vector(self.lens.unproject(pixel)?);
        let down = -ray.z;
        (down > 1e-9).then(|| {
            let away = ray.truncate() * (self.map_from_optical.translation.z / down);
            DVec2::new(away.to_angle(), away.length())
        })
    }

    /// Derivative of [`Self::polar`] by the pixel.
    fn polar_by_pixel(&self, pixel: DVec2) -> Option<DMat2> {
        let along = |axis: DVec2| {
            let [from, to] = [-STEP_PX, STEP_PX].map(|step| self.polar(pixel + axis * step));
            let (from, to) = (from?, to?);
            Some(DVec2::new(wrap_angle(to.x - from.x), to.y - from.y) / (2.0 * STEP_PX))
        };
        Some(DMat2::from_cols(along(DVec2::X)?, along(DVec2::Y)?))
    }
}

/// Mean luma around a pixel, 0 to 255, over pixels that show something.
fn mean_luma(image: &Raster, at: DVec2) -> f64 {
    let range = |centre: f64, end: usize| {
        let centre = (libm::round(centre).max(0.0) as usize).min(end.saturating_sub(1));
        centre.saturating_sub(LIGHT_RADIUS_PX)..(centre + LIGHT_RADIUS_PX + 1).min(end)
    };
    let (mut sum, mut count) = (0u64, 0u64);
    for v in range(at.y, image.height) {
        for u in range(at.x, image.width) {
            let pixel = image.pixels[v * image.width + u];
            if pixel[3] != NOTHING {
                sum += u64::from(luma(pixel));
                count += 1;
            }
        }
    }
    sum as f64 / count.max(1) as f64
}

/// Angular speed of a camera at each of its tags, radians a second: time in nanoseconds and rotation, in the order of time.
///
/// It is taken between the tags before and after; where one of them is missing or more than 0.25 s away, from the other alone. `None`
/// where both are.
pub fn angular_speeds(tags: &[(i64, DQuat)]) -> Vec<Option<f64>> {
    let is_near = |a: usize, b: usize| (1..=NEIGHBOUR_WITHIN_NS).contains(&(tags[b].0.saturating_sub(tags[a].0)));
    let speed = |at: usize| {
        let before = at.checked_sub(1).filter(|before| is_near(*before, at)).unwrap_or(at);
        let after = Some(at + 1).filter(|after| *after < tags.len() && is_near(at, *after)).unwrap_or(at);
        let seconds = (tags[after].0 - tags[before].0) as f64 * 1e-9;
        (seconds > 0.0).then(|| tags[before].1.angle_between(tags[after].1) / seconds)
    };
    (0..tags.len()).map(speed).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_is_that_between_near_tags_and_else_unknown() {
        let tag = |ms: i64, angle: f64| (ms * 1_000_000, DQuat::from_rotation_z(angle));
        let found = angular_speeds(&[tag(0, 0.0), tag(100, 0.1), tag(200, 0.4), tag(1000, 0.5), tag(1000, 0.6)]);
        let expected = [Some(1.0), Some(2.0), Some(3.0), None, None];
        for (found, expected) in found.iter().zip(expected) {
            assert_eq!(found.is_some(), expected.is_some());
            assert!((found.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-6, "{found:?} {expected:?}");
        }
        assert!(angular_speeds(&[]).is_empty());
    }
}
