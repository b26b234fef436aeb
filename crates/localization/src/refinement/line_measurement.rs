//! Where lines lie in the image, against where a pose puts them.

use glam::{DVec2, DVec3};
use nalgebra::Matrix6;

use super::miscalibration::{Miscalibration, row};
use super::paint::Paint;
use super::points::{LinePoint, LinePoints};
use super::profile::{Profile, Strip};
use realitysim_geometry::{Isometry, Projector, Twist};
use realitysim_vision::LineImage;

/// A place of a line, found in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineMeasurement {
    /// Unit ray in `camera_optical_frame`.
    pub ray: DVec3,
    /// The place of the field's line, in `map`.
    pub point: DVec3,
    /// Unit vector along the line, in `map`.
    pub tangent: DVec3,
    /// Standard deviation in units of that of a line whose place is known best, in pixels.
    pub sigmas: f64,
    /// Of how many such places a picture shows the line, 0 to 1.
    pub visibility: f64,
    /// Across the line.
    pub pixels_per_rad: f64,
    /// How the ray would change with the lens's stretch and shift and the sensor's readout: see [`Miscalibration`].
    pub(super) bends: [DVec3; 4],
    /// When it was exposed: see [`row`].
    pub row: f64,
    /// From the camera, metres.
    pub(super) distance: f64,
    /// Which of the field's lines it is.
    pub line: usize,
    /// The sight before is the neighbour along the same line.
    pub follows: bool,
}

/// How places come to be drawn: by the lens, what it has wrong, and how it moves while rows are read.
#[derive(Clone, Copy)]
pub struct CameraModel<'a> {
    pub projector: &'a Projector,
    pub off: &'a Miscalibration,
    pub twist: &'a Twist,
}

impl CameraModel<'_> {
    /// How far what stands still at `place`, in the middle row's time, has gone by when this [`row`] is read: to first order.
    pub fn moved_until_read(&self, place: DVec3, row: f64) -> DVec3 {
        self.twist.passing(place) * (self.off.readout_s * row)
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Places where a line had to be seen, and nothing hid it.
    pub expected: usize,
    pub missed: usize,
    /// Of those expected, each counted by its visibility.
    pub visible: f64,
}

/// Lines thinner than this are not looked for.
const THINNEST_PX: f64 = 0.8;
/// Nor those whose edges, as drawn, lie along rather than beside each other: sine of the angle.
const LEAST_SINE: f64 = 0.25;
/// Neighbours along a line are at least this far apart.
const APART_PX: f64 = 4.0;
/// What is looked for lies within this many standard deviations, ...
const REACH_SIGMAS: f64 = 2.5;
/// ... within these limits.
const LEAST_REACH_PX: f64 = 2.5;
const MOST_REACH_PX: f64 = 24.0;
/// A line thinner than this is found the worse the thinner it is: less of it stands out of noise, blur and texture.
const THIN_PX: f64 = 2.4;
/// And one wider than this the wider it is: more of paint and carpet in its profile.
const WIDE_PX: f64 = 6.0;
/// The place of a line as faint as the noise is known so much worse than that of a clear one.
const FAINT_SIGMAS: f64 = 5.0;
/// A line is where a pose has it if it stands out most within so many pixels of that place, and so many more for each pixel of the width
/// that is seen half the time: the peak of a faint line is moved by noise.
const FOREMOST_PX: f64 = 0.2;
const FOREMOST_MORE_PER_PX: f64 = 0.45;
/// Looks for every line in view of the pose; what it finds replaces `sights`. `covariance` says how wrong the pose may
/// be.
pub fn measure(
    points: &LinePoints,
    image: &LineImage,
    eye: CameraModel,
    map_from_optical: &Isometry,
    covariance: &Matrix6<f64>,
    sights: &mut Vec<LineMeasurement>,
) -> Counts {
    sights.clear();
    let mut counts = Counts::default();
    let Some(paint) = Paint::of(image) else { return counts };
    let camera = map_from_optical.translation;
    let mut last_line = usize::MAX;
    let mut follows = false;
    each_place(points, image, eye, map_from_optical, APART_PX, |line, point, expected| {
        follows &= line == last_line;
        last_line = line;
        let reach = expected.reach_px(point, camera, covariance);
        match expected.find(image, reach, paint) {
            Outcome::Hidden => follows = false,
            Outcome::Missed => {
                follows = false;
                counts.expected += 1;
                counts.missed += 1;
                counts.visible += paint.visibility(expected.strip.width_px);
            }
            Outcome::Found(found) => {
                counts.expected += 1;
                counts.visible += paint.visibility(expected.strip.width_px);
                sights.push(expected.sight(line, point, found, follows, paint));
                follows = true;
            }
        }
    });
    counts
}

/// What a picture shows of a place at which a pose has a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inspected {
    /// Where the line should be, in pixels of the full-size image.
    pub pixel: DVec2,
    /// Of how many such places a picture shows the line, 0 to 1.
    pub visibility: f64,
    pub finding: Finding,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// Something stands before it, or the light changes there.
    Hidden,
    /// Plain carpet.
    Missing,
    /// Here, in pixels of the full-size image.
    Found(DVec2),
}

/// Looks for every line in view close to where the pose has it.
pub fn inspect(
    points: &LinePoints,
    image: &LineImage,
    eye: CameraModel,
    map_from_optical: &Isometry,
) -> Vec<Inspected> {
    let mut inspected = Vec::new();
    let Some(paint) = Paint::of(image) else { return inspected };
    each_place(points, image, eye, map_from_optical, APART_PX, |_, _, expected| {
        let finding = match expected.find(image, LEAST_REACH_PX, paint) {
            Outcome::Hidden => Finding::Hidden,
            Outcome::Missed => Finding::Missing,
            Outcome::Found(found) => {
                Finding::Found(image.scale().undo(expected.strip.middle + expected.strip.direction * found.offset_px))
            }
        };
        let pixel = image.scale().undo(expected.strip.middle);
        inspected.push(Inspected { pixel, visibility: paint.visibility(expected.strip.width_px), finding });
    });
    inspected
}

/// How far a place of a line stands out, and how far plain carpet beside it does, each looked for within [`LEAST_REACH_PX`]: in standard
/// deviations of plain carpet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Of the line as drawn.
    pub width_px: f64,
    pub line: f64,
    pub carpet: f64,
}

/// Plain carpet is looked at so many line widths beside a line, ...
const BESIDE: f64 = 4.0;
/// ... and must be so many from any other.
const CLEAR_OF_LINES: f64 = 3.0;

/// How every place of a line answers to the matched filter from where the camera truly was, with carpet as near to it as can be told from it.
pub fn responses(
    points: &LinePoints,
    image: &LineImage,
    eye: CameraModel,
    map_from_optical: &Isometry,
) -> Vec<Response> {
    let mut responses = Vec::new();
    let Some(paint) = Paint::of(image).filter(|paint| paint.noise() > 0.0) else { return responses };
    let width_m = points.line_width_m;
    each_place(points, image, eye, map_from_optical, APART_PX, |_, point, expected| {
        let answer = |strip: &Strip| {
            let profile = Profile::across(strip, image, LEAST_REACH_PX)?;
            let (at, response) = profile.best();
            let is_carpet = !profile.hides(image, at) && paint.are_carpet(profile.flanks(at));
            is_carpet.then_some(response / paint.noise())
        };
        let clear = |side: &f64| {
            points.distance(point.position + point.normal * (side * BESIDE * width_m)) > CLEAR_OF_LINES * width_m
        };
        let Some(side) = [1.0, -1.0].into_iter().find(clear) else { return };
        let Strip { middle, direction, width_px } = expected.strip;
        let beside = Strip { middle: middle + direction * (side * BESIDE * width_px), direction, width_px };
        if let (Some(line), Some(carpet)) = (answer(&expected.strip), answer(&beside)) {
            responses.push(Response { width_px, line, carpet });
        }
    });
    responses
}

/// Every place of a line that the pose would have drawn in the image, at least so many pixels from the one before it on its line.
pub(super) fn each_place(
    points: &LinePoints,
    image: &LineImage,
    eye: CameraModel,
    map_from_optical: &Isometry,
    apart_px: f64,
    mut visit: impl FnMut(usize, &LinePoint, &Expected),
) {
    let from_carpet = FromCarpet::new(&map_from_optical.inverse());
    let camera = map_from_optical.translation;
    let projector = eye.projector;
    let least_cos = libm::cos(projector.lens().max_angle().min(core::f64::consts::PI));
    let height = camera.z.max(0.05);
    // Beyond this a line is thinner than the thinnest whatever its direction.
    let farthest =
        libm::sqrt(projector.lens().focal() * points.line_width_m * image.scale().factor() / THINNEST_PX * height)
            * 2.0;
    let farthest = farthest.max(farthest * farthest / (4.0 * height)).max(1.0);
    for (line, stroke) in points.strokes.iter().enumerate() {
        let mut last = DVec2::INFINITY;
        for point in stroke {
            let to = point.position - camera.truncate();
            if to.length_squared() > farthest * farthest {
                continue;
            }
            let centre = from_carpet.point(point.position);
            if centre.z < least_cos * centre.length() {
                continue;
            }
            let Some(pixel) = projector.project(centre) else { continue };
            if !projector.lens().contains(pixel) || pixel.distance_squared(last) < apart_px * apart_px {
                continue;
            }
            let width_m = points.line_width_m;
            let Some(expected) = Expected::new(point, width_m, (centre, pixel), image, eye, &from_carpet) else {
                continue;
            };
            last = pixel;
            visit(line, point, &expected);
        }
    }
}

/// `camera_optical_frame` from the plane of the carpet.
struct FromCarpet {
    x: DVec3,
    y: DVec3,
    origin: DVec3,
}

impl FromCarpet {
    fn new(optical_from_map: &Isometry) -> Self {
        let [x, y] = [DVec3::X, DVec3::Y].map(|axis| optical_from_map.transform_vector(axis));
        Self { x, y, origin: optical_from_map.translation }
    }

    fn point(&self, at: DVec2) -> DVec3 {
        self.origin + self.vector(at)
    }

    fn vector(&self, along: DVec2) -> DVec3 {
        self.x * along.x + self.y * along.y
    }
}

enum Outcome {
    /// Out of the image, or something stands before it.
    Hidden,
    /// Plain carpet where the line should be.
    Missed,
    Found(Found),
}

struct Found {
    /// From where the line was expected.
    offset_px: f64,
    /// How far it stands out, in standard deviations of plain carpet; infinite where that has none.
    to_noise: f64,
}

/// A short piece of line as the pose would have it drawn.
pub(super) struct Expected {
    /// Unit ray of the line's middle in `camera_optical_frame`.
    ray: DVec3,
    /// From the line's one edge to its other: difference of unit rays.
    across: DVec3,
    pub(super) strip: Strip,
    bends: [DVec3; 4],
    row: f64,
    distance: f64,
}

impl Expected {
    fn new(
        point: &LinePoint,
        line_width_m: f64,
        (centre, pixel): (DVec3, DVec2),
        image: &LineImage,
        eye: CameraModel,
        from_carpet: &FromCarpet,
    ) -> Option<Self> {
        let half = |direction: DVec2| from_carpet.vector(direction * (line_width_m / 2.0));
        let (aside, along) = (half(point.normal), half(-point.normal.perp()));
        let (left, right) = (centre + aside, centre - aside);
        let lens = eye.projector.lens();
        // Where it all is when its row is read.
        let row = row(lens, pixel);
        let late = eye.moved_until_read(centre, row);
        let drawn = |place: DVec3| Some(image.scale().apply(eye.off.drawn(lens, eye.projector.project(place + late)?)));
        let (from, to) = (drawn(right)?, drawn(left)?);
        let width_px = from.distance(to);
        if width_px < THINNEST_PX {
            return None;
        }
        // At a flat angle a line is drawn sheared: the way from its one edge to the other runs along it.
        let middle = (from + to) / 2.0;
        let along_px = drawn(centre + along)? - middle;
        if (to - from).perp_dot(along_px).abs() < LEAST_SINE * width_px * along_px.length() {
            return None;
        }
        let (across, direction) = (left.normalize() - right.normalize(), (to - from) / width_px);
        // What a lens draws elsewhere than it is said to seems to lie off; how far along the line does not show.
        let moves = Miscalibration::gradient(lens, image.scale().undo(middle));
        let per_px = image.scale().factor() / (direction.perp_dot(along_px) * width_px);
        let [stretch, u, v] = moves.map(|by| across * (-by.perp_dot(along_px) * per_px));
        let ray = centre.normalize();
        // Feet go the same way for long, as errors of a lens do: only what turns tells how a sensor is read.
        let bends = [stretch, u, v, eye.twist.angular.cross(ray) * row];
        let strip = Strip { middle, direction, width_px };
        Some(Self { ray, across, strip, bends, row, distance: centre.length() })
    }

    fn pixels_per_rad(&self) -> f64 {
        self.strip.width_px / self.across.length().max(1e-12)
    }

    /// How far off the line may be drawn if the pose is as wrong as its covariance says.
    fn reach_px(&self, point: &LinePoint, camera: DVec3, covariance: &Matrix6<f64>) -> f64 {
        let tangent = DVec3::new(-point.normal.y, point.normal.x, 0.0);
        let off = point.position.extend(0.0) - camera;
        let across = off.cross(tangent);
        let length = across.length().max(1e-9);
        let (normal, ray) = (across / length, off.normalize());
        let turn = ray.cross(normal);
        let shift = -tangent.cross(ray) / length;
        let gradient = nalgebra::Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
        let sigma = libm::sqrt(gradient.dot(&(covariance * gradient)).max(0.0));
        (REACH_SIGMAS * sigma * self.pixels_per_rad()).clamp(LEAST_REACH_PX, MOST_REACH_PX)
    }

    fn sight(&self, line: usize, point: &LinePoint, found: Found, follows: bool, paint: Paint) -> LineMeasurement {
        LineMeasurement {
            ray: (self.ray + self.across * (found.offset_px / self.strip.width_px)).normalize(),
            point: point.position.extend(0.0),
            tangent: DVec3::new(-point.normal.y, point.normal.x, 0.0),
            sigmas: libm::hypot(sigmas(self.strip.width_px), FAINT_SIGMAS / found.to_noise),
            visibility: paint.visibility(self.strip.width_px),
            pixels_per_rad: self.pixels_per_rad(),
            bends: self.bends,
            row: self.row,
            distance: self.distance,
            line,
            follows,
        }
    }

    /// The line's middle along the normal.
    fn find(&self, image: &LineImage, reach_px: f64, paint: Paint) -> Outcome {
        let Some(profile) = Profile::across(&self.strip, image, reach_px) else { return Outcome::Hidden };
        let (at, response) = profile.best();
        let hides = |at: usize| profile.hides(image, at);
        if hides(at) {
            return Outcome::Hidden;
        }
        let flanks = profile.flanks(at);
        if response < paint.least(self.strip.width_px) {
            // Carpet is darker than a line would be; brightness beyond the field or a robot's shell says nothing.
            let is_seen = !hides(profile.middle()) && paint.are_carpet(profile.flanks(profile.middle()));
            return if is_seen { Outcome::Missed } else { Outcome::Hidden };
        }
        // Where a lens's picture ends, or a robot's shadow begins, a line is cut and its middle elsewhere; beyond there is none.
        if !paint.are_carpet(flanks) {
            return Outcome::Hidden;
        }
        Outcome::Found(Found { offset_px: profile.offset_px(profile.centroid(at)), to_noise: response / paint.noise() })
    }

    /// Whether the line stands out more than anything else within so many pixels beside it, and how often it would by chance.
    /// `None` where something stands before it.
    pub(super) fn is_foremost(&self, image: &LineImage, paint: Paint, within_px: f64) -> Option<(bool, f64)> {
        let profile = Profile::across(&self.strip, image, within_px)?;
        if profile.hides(image, profile.middle()) || !paint.are_carpet(profile.flanks(profile.middle())) {
            return None;
        }
        let near_px = FOREMOST_PX + FOREMOST_MORE_PER_PX * paint.half_seen_px();
        let near = libm::round(near_px / profile.step_px()).max(1.0) as usize;
        let (at, _) = profile.best();
        let all = profile.middles().len();
        Some((at.abs_diff(profile.middle()) <= near, ((2 * near + 1) as f64 / all as f64).min(1.0)))
    }
}

/// Standard deviation of the place of a line so wide: 1 at the best width, which is sqrt([`THIN_PX`] [`WIDE_PX`]). Fitted to what
/// the places in ten logs lie off (docs/design.md).
fn sigmas(width_px: f64) -> f64 {
    let (thin, wide) = (THIN_PX / width_px, width_px / WIDE_PX);
    libm::sqrt((1.0 + thin * thin + wide * wide) / (1.0 + 2.0 * THIN_PX / WIDE_PX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_best_width_is_known_best_and_others_the_worse_the_farther_they_are_from_it() {
        let best = (THIN_PX * WIDE_PX).sqrt();
        assert!((sigmas(best) - 1.0).abs() < 1e-12);
        for step in 0..20 {
            let (near, far) = (1.0 + 0.1 * f64::from(step), 1.1 + 0.1 * f64::from(step));
            assert!(sigmas(best * far) > sigmas(best * near) && sigmas(best / far) > sigmas(best / near));
            assert!((sigmas(best * far) - sigmas(best / far)).abs() < 1e-12, "as many times too wide as too thin");
        }
    }
}
