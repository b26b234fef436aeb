//! Measurement of where field lines lie in the image, compared with where a pose puts them.

use glam::{DVec2, DVec3};
use nalgebra::Matrix6;

use super::line_contrast::Paint;
use super::miscalibration::{Miscalibration, row};
use super::points::{LinePoint, LinePoints};
use super::profile::{Profile, Strip};
use realitysim_geometry::{Isometry, Projector, Twist};
use realitysim_vision::LineImage;

/// A line place that was found in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineMeasurement {
    /// Unit ray in `camera_optical_frame` towards the line as found.
    pub ray: DVec3,
    /// The corresponding point of the field's line, in `map`, metres.
    pub point: DVec3,
    /// Unit vector along the line, in `map`.
    pub tangent: DVec3,
    /// Standard deviation of the place, relative to that of a clear line of the best width.
    pub sigmas: f64,
    /// Share of such places at which a picture shows the line, 0 to 1.
    pub visibility: f64,
    /// Scale of the image across the line.
    pub pixels_per_rad: f64,
    /// Derivatives of the ray by stretch and shift of the lens and by the sensor's readout time: see [`Miscalibration`].
    pub(super) ray_by_lens: [DVec3; 4],
    /// Time of exposure as a share of the readout: see [`row`].
    pub row: f64,
    /// Distance from the camera, metres.
    pub(super) distance: f64,
    /// Index of the field's line.
    pub line: usize,
    /// Whether the measurement before this one is its neighbour on the same line.
    pub follows: bool,
}

/// The camera model that maps points to pixels: the lens, its calibration errors, and the motion while rows are read.
#[derive(Clone, Copy)]
pub struct CameraModel<'a> {
    /// The lens as calibrated.
    pub projector: &'a Projector,
    /// Errors of that calibration, and the readout time.
    pub off: &'a Miscalibration,
    /// Velocity of the camera in its own frame.
    pub twist: &'a Twist,
}

impl CameraModel<'_> {
    /// Displacement of a static point in the camera's frame, metres, to first order: from `place`, where it is when the middle row
    /// is exposed, to where it is when this [`row`] is exposed.
    pub fn moved_until_read(&self, place: DVec3, row: f64) -> DVec3 {
        self.twist.passing(place) * (self.off.readout_s * row)
    }
}

/// Counts of line places in one image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Number of places that had to be visible and that nothing hid.
    pub expected: usize,
    /// Number of those at which no line was found.
    pub missed: usize,
    /// Sum of the visibilities of the expected places.
    pub visible: f64,
}

/// Lines thinner than this are not looked for ...
const MIN_WIDTH_PX: f64 = 0.8;
/// ... nor those whose edges, as drawn, are shifted along rather than beside each other: sine of the angle.
const MIN_SINE: f64 = 0.25;
/// Smallest distance between neighbouring places of a line, pixels.
const MIN_SPACING_PX: f64 = 4.0;
/// A line is looked for within this many standard deviations of where the pose puts it, ...
const REACH_SIGMAS: f64 = 2.5;
/// ... within these limits.
const MIN_REACH_PX: f64 = 2.5;
const REACH_LIMIT_PX: f64 = 24.0;
/// Below about this width, a line is located the less precisely the thinner it is: less of it stands out of noise and blur.
const THIN_PX: f64 = 2.4;
/// Above about this width, a line is located the less precisely the wider it is: its profile holds more texture.
const WIDE_PX: f64 = 6.0;
/// Standard deviation of a line that stands out as much as the noise, relative to that of a clear line.
const FAINT_SIGMAS: f64 = 5.0;
/// A line is foremost if its filter response peaks within this many pixels of where the pose has it, ...
const FOREMOST_PX: f64 = 0.2;
/// ... and this much more for each pixel of the width that is seen half the time: noise moves the peak of a faint line.
const FOREMOST_MORE_PER_PX: f64 = 0.45;
/// Looks for every line that is visible from the pose and replaces `measurements` with those found. `covariance` is that of the
/// pose's error (x, y, z, rotation vector) and limits how far lines are looked for.
pub fn measure(
    points: &LinePoints,
    image: &LineImage,
    camera_model: CameraModel,
    map_from_optical: &Isometry,
    covariance: &Matrix6<f64>,
    measurements: &mut Vec<LineMeasurement>,
) -> Counts {
    measurements.clear();
    let mut counts = Counts::default();
    let Some(paint) = Paint::of(image) else { return counts };
    let camera = map_from_optical.translation;
    let mut last_line = usize::MAX;
    let mut follows = false;
    each_place(points, image, camera_model, map_from_optical, MIN_SPACING_PX, |line, point, expected| {
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
                measurements.push(expected.measurement(line, point, found, follows, paint));
                follows = true;
            }
        }
    });
    counts
}

/// An expected line place with what the image shows there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inspected {
    /// Expected pixel of the line in the full-size image.
    pub pixel: DVec2,
    /// Share of such places at which a picture shows the line, 0 to 1.
    pub visibility: f64,
    /// Result of the search there.
    pub finding: Finding,
}

/// Result of looking for a line where it is expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// Something stands before the line, or the lighting changes there.
    Hidden,
    /// Plain carpet.
    Missing,
    /// The line, at this pixel of the full-size image.
    Found(DVec2),
}

/// Looks for every line that is visible from the pose, close to where the pose has it.
pub fn inspect(
    points: &LinePoints,
    image: &LineImage,
    camera_model: CameraModel,
    map_from_optical: &Isometry,
) -> Vec<Inspected> {
    let mut inspected = Vec::new();
    let Some(paint) = Paint::of(image) else { return inspected };
    each_place(points, image, camera_model, map_from_optical, MIN_SPACING_PX, |_, _, expected| {
        let finding = match expected.find(image, MIN_REACH_PX, paint) {
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

/// Response of the matched filter to a line place and to plain carpet beside it, in standard deviations of plain carpet. Both are
/// the largest responses within `MIN_REACH_PX`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Width of the line as drawn, pixels.
    pub width_px: f64,
    /// Largest response at the line.
    pub line: f64,
    /// Largest response at the carpet beside it.
    pub carpet: f64,
}

/// Plain carpet is sampled this many line widths beside a line, ...
const BESIDE_WIDTHS: f64 = 4.0;
/// ... at least this many line widths from any other.
const CLEAR_WIDTHS: f64 = 3.0;

/// The response of the matched filter at every visible line place, given the true pose, and at carpet close beside it.
pub fn responses(
    points: &LinePoints,
    image: &LineImage,
    camera_model: CameraModel,
    map_from_optical: &Isometry,
) -> Vec<Response> {
    let mut responses = Vec::new();
    let Some(paint) = Paint::of(image).filter(|paint| paint.noise() > 0.0) else { return responses };
    let width_m = points.line_width_m;
    each_place(points, image, camera_model, map_from_optical, MIN_SPACING_PX, |_, point, expected| {
        let answer = |strip: &Strip| {
            let profile = Profile::across(strip, image, MIN_REACH_PX)?;
            let (at, response) = profile.peak();
            let is_carpet = !profile.is_hidden(image, at) && paint.are_carpet(profile.flanks(at));
            is_carpet.then_some(response / paint.noise())
        };
        let clear = |side: &f64| {
            points.distance(point.position + point.normal * (side * BESIDE_WIDTHS * width_m)) > CLEAR_WIDTHS * width_m
        };
        let Some(side) = [1.0, -1.0].into_iter().find(clear) else { return };
        let Strip { middle, direction, width_px } = expected.strip;
        let beside = Strip { middle: middle + direction * (side * BESIDE_WIDTHS * width_px), direction, width_px };
        if let (Some(line), Some(carpet)) = (answer(&expected.strip), answer(&beside)) {
            responses.push(Response { width_px, line, carpet });
        }
    });
    responses
}

/// Visits every line place that is visible from the pose and at least `apart_px` from the one before it on the same line.
pub(super) fn each_place(
    points: &LinePoints,
    image: &LineImage,
    camera_model: CameraModel,
    map_from_optical: &Isometry,
    apart_px: f64,
    mut visit: impl FnMut(usize, &LinePoint, &Expected),
) {
    let from_carpet = FromCarpet::new(&map_from_optical.inverse());
    let camera = map_from_optical.translation;
    let projector = camera_model.projector;
    let least_cos = libm::cos(projector.lens().max_angle().min(core::f64::consts::PI));
    let height = camera.z.max(0.05);
    // Beyond this distance a line is thinner than the minimum, whatever its direction.
    let farthest =
        libm::sqrt(projector.lens().focal() * points.line_width_m * image.scale().factor() / MIN_WIDTH_PX * height)
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
            let Some(expected) = Expected::new(point, width_m, (centre, pixel), image, camera_model, &from_carpet)
            else {
                continue;
            };
            last = pixel;
            visit(line, point, &expected);
        }
    }
}

/// Transformation from the plane of the carpet into `camera_optical_frame`.
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

/// Result of looking for one line place.
enum Outcome {
    /// The place is outside of the image, or something stands before it.
    Hidden,
    /// There is plain carpet where the line should be.
    Missed,
    Found(Found),
}

/// A line that was found.
struct Found {
    /// Offset from where the line was expected.
    offset_px: f64,
    /// Response in standard deviations of plain carpet; infinite where the carpet has no noise.
    to_noise: f64,
}

/// A short piece of a line as the pose would have it drawn.
pub(super) struct Expected {
    /// Unit ray towards the line's middle in `camera_optical_frame`.
    ray: DVec3,
    /// Difference of the unit rays towards the line's two edges.
    across: DVec3,
    pub(super) strip: Strip,
    ray_by_lens: [DVec3; 4],
    row: f64,
    distance: f64,
}

impl Expected {
    /// The expected line place, or `None` if it is not drawn, too thin, or sheared too much.
    fn new(
        point: &LinePoint,
        line_width_m: f64,
        (centre, pixel): (DVec3, DVec2),
        image: &LineImage,
        camera_model: CameraModel,
        from_carpet: &FromCarpet,
    ) -> Option<Self> {
        let half = |direction: DVec2| from_carpet.vector(direction * (line_width_m / 2.0));
        let (aside, along) = (half(point.normal), half(-point.normal.perp()));
        let (left, right) = (centre + aside, centre - aside);
        let lens = camera_model.projector.lens();
        // All of it at the time when its row is read.
        let row = row(lens, pixel);
        let late = camera_model.moved_until_read(centre, row);
        let drawn = |place: DVec3| {
            Some(image.scale().apply(camera_model.off.drawn(lens, camera_model.projector.project(place + late)?)))
        };
        let (from, to) = (drawn(right)?, drawn(left)?);
        let width_px = from.distance(to);
        if width_px < MIN_WIDTH_PX {
            return None;
        }
        // Seen at a flat angle, a line is sheared: the way from one edge to the other runs along it.
        let middle = (from + to) / 2.0;
        let along_px = drawn(centre + along)? - middle;
        if (to - from).perp_dot(along_px).abs() < MIN_SINE * width_px * along_px.length() {
            return None;
        }
        let (across, direction) = (left.normalize() - right.normalize(), (to - from) / width_px);
        // An error of the lens moves the line in the image; only the part across the line is visible.
        let moves = Miscalibration::gradient(lens, image.scale().undo(middle));
        let per_px = image.scale().factor() / (direction.perp_dot(along_px) * width_px);
        let [stretch, u, v] = moves.map(|by| across * (-by.perp_dot(along_px) * per_px));
        let ray = centre.normalize();
        // Translation goes the same way for long, as errors of a lens do: only rotation tells how the sensor is read.
        let ray_by_lens = [stretch, u, v, camera_model.twist.angular.cross(ray) * row];
        let strip = Strip { middle, direction, width_px };
        Some(Self { ray, across, strip, ray_by_lens, row, distance: centre.length() })
    }

    fn pixels_per_rad(&self) -> f64 {
        self.strip.width_px / self.across.length().max(1e-12)
    }

    /// Distance, in pixels and within limits, by which the line may be off if the pose is as wrong as its covariance says.
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
        (REACH_SIGMAS * sigma * self.pixels_per_rad()).clamp(MIN_REACH_PX, REACH_LIMIT_PX)
    }

    /// The measurement of this place from what was found.
    fn measurement(
        &self,
        line: usize,
        point: &LinePoint,
        found: Found,
        follows: bool,
        paint: Paint,
    ) -> LineMeasurement {
        LineMeasurement {
            ray: (self.ray + self.across * (found.offset_px / self.strip.width_px)).normalize(),
            point: point.position.extend(0.0),
            tangent: DVec3::new(-point.normal.y, point.normal.x, 0.0),
            sigmas: libm::hypot(sigmas(self.strip.width_px), FAINT_SIGMAS / found.to_noise),
            visibility: paint.visibility(self.strip.width_px),
            pixels_per_rad: self.pixels_per_rad(),
            ray_by_lens: self.ray_by_lens,
            row: self.row,
            distance: self.distance,
            line,
            follows,
        }
    }

    /// Looks for the line's middle along its normal.
    fn find(&self, image: &LineImage, reach_px: f64, paint: Paint) -> Outcome {
        let Some(profile) = Profile::across(&self.strip, image, reach_px) else { return Outcome::Hidden };
        let (at, response) = profile.peak();
        let hides = |at: usize| profile.is_hidden(image, at);
        if hides(at) {
            return Outcome::Hidden;
        }
        let flanks = profile.flanks(at);
        if response < paint.min_contrast(self.strip.width_px) {
            // Plain carpet means that the line is missing; brightness of a robot or of what is beyond the field means nothing.
            let is_seen = !hides(profile.middle()) && paint.are_carpet(profile.flanks(profile.middle()));
            return if is_seen { Outcome::Missed } else { Outcome::Hidden };
        }
        // At the edge of the lens's picture or of a shadow a line is cut and its middle displaced.
        if !paint.are_carpet(flanks) {
            return Outcome::Hidden;
        }
        Outcome::Found(Found { offset_px: profile.offset_px(profile.centroid(at)), to_noise: response / paint.noise() })
    }

    /// Whether the line stands out more than anything else within `within_px` beside it, and the probability of that by chance.
    /// `None` where something stands before it.
    pub(super) fn is_foremost(&self, image: &LineImage, paint: Paint, within_px: f64) -> Option<(bool, f64)> {
        let profile = Profile::across(&self.strip, image, within_px)?;
        if profile.is_hidden(image, profile.middle()) || !paint.are_carpet(profile.flanks(profile.middle())) {
            return None;
        }
        let near_px = FOREMOST_PX + FOREMOST_MORE_PER_PX * paint.half_seen_px();
        let near = libm::round(near_px / profile.step_px()).max(1.0) as usize;
        let (at, _) = profile.peak();
        let all = profile.middles().len();
        Some((at.abs_diff(profile.middle()) <= near, ((2 * near + 1) as f64 / all as f64).min(1.0)))
    }
}

/// Standard deviation of the place of a line of this width, relative to the best width, sqrt([`THIN_PX`] [`WIDE_PX`]). Fitted
/// to the deviations of line places in ten logs.
fn sigmas(width_px: f64) -> f64 {
    let (thin, wide) = (THIN_PX / width_px, width_px / WIDE_PX);
    libm::sqrt((1.0 + thin * thin + wide * wide) / (1.0 + 2.0 * THIN_PX / WIDE_PX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_located_worse_the_farther_it_is_from_the_best_width() {
        let best = (THIN_PX * WIDE_PX).sqrt();
        assert!((sigmas(best) - 1.0).abs() < 1e-12);
        for step in 0..20 {
            let (near, far) = (1.0 + 0.1 * f64::from(step), 1.1 + 0.1 * f64::from(step));
            assert!(sigmas(best * far) > sigmas(best * near) && sigmas(best / far) > sigmas(best / near));
            assert!((sigmas(best * far) - sigmas(best / far)).abs() < 1e-12, "as many times too wide as too thin");
        }
    }
}
