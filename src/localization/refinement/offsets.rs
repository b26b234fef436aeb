//! Where lines lie in the image, against where a pose puts them.

use glam::{DVec2, DVec3};
use nalgebra::Matrix6;

use super::miscalibration::{Miscalibration, row};
use super::points::{LinePoint, LinePoints};
use crate::geometry::{Isometry, Projector, Twist};
use crate::vision::LineImage;

/// A place of a line, found in the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Unit ray in `camera_optical_frame`.
    pub ray: DVec3,
    /// The place of the field's line, in `map`.
    pub point: DVec3,
    /// Unit vector along the line, in `map`.
    pub tangent: DVec3,
    /// Standard deviation in units of that of a line whose place is known best, in pixels.
    pub sigmas: f64,
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
pub struct Eye<'a> {
    pub projector: &'a Projector,
    pub off: &'a Miscalibration,
    pub twist: &'a Twist,
}

impl Eye<'_> {
    /// How far what stands still at `place`, in the middle row's time, has gone by when this [`row`] is read: to first order.
    pub fn moved_until_read(&self, place: DVec3, row: f64) -> DVec3 {
        self.twist.passing(place) * (self.off.readout_s * row)
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Places where a line had to be seen, and nothing hid it.
    pub expected: usize,
    pub missed: usize,
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
/// Share of the expected contrast that makes a line.
const LEAST_CONTRAST: f64 = 0.35;
/// Carpet that is lit at all is brighter than this share of the step from it to a line: of the gray that a camera writes it is about as
/// much as the step itself.
const UNLIT: f64 = 0.2;
/// The narrow line contrast of vision shows this much of a line's own contrast.
const SHOWN_CONTRAST: f64 = 0.672;

/// Looks for every line in view of the pose; what it finds replaces `sights`. `covariance` says how wrong the pose may
/// be.
pub fn measure(
    points: &LinePoints,
    image: &LineImage,
    eye: Eye,
    map_from_optical: &Isometry,
    covariance: &Matrix6<f64>,
    sights: &mut Vec<Sight>,
) -> Counts {
    sights.clear();
    let mut counts = Counts::default();
    let contrast = f64::from(image.full_contrast()) / SHOWN_CONTRAST;
    if !contrast.is_finite() {
        return counts;
    }
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
        let mut follows = false;
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
            if !projector.lens().contains(pixel) || pixel.distance_squared(last) < APART_PX * APART_PX {
                continue;
            }
            let width_m = points.line_width_m;
            let Some(expected) = Expected::new(point, width_m, (centre, pixel), image, eye, &from_carpet) else {
                continue;
            };
            last = pixel;
            let reach = expected.reach_px(point, camera, covariance);
            match expected.find(image, reach, contrast) {
                Outcome::Hidden => follows = false,
                Outcome::Missed => {
                    follows = false;
                    counts.expected += 1;
                    counts.missed += 1;
                }
                Outcome::Found(offset_px) => {
                    counts.expected += 1;
                    sights.push(expected.sight(line, point, offset_px, follows));
                    follows = true;
                }
            }
        }
    }
    counts
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
    Found(f64),
}

/// A short piece of line as the pose would have it drawn.
struct Expected {
    /// Unit ray of the line's middle in `camera_optical_frame`.
    ray: DVec3,
    /// From the line's one edge to its other: difference of unit rays.
    across: DVec3,
    /// Middle between the drawn edges, pixels of the working image.
    middle: DVec2,
    /// Unit vector across the drawn line.
    direction: DVec2,
    width_px: f64,
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
        eye: Eye,
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
        Some(Self { ray, across, middle, direction, width_px, bends, row, distance: centre.length() })
    }

    fn pixels_per_rad(&self) -> f64 {
        self.width_px / self.across.length().max(1e-12)
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

    fn sight(&self, line: usize, point: &LinePoint, offset_px: f64, follows: bool) -> Sight {
        Sight {
            ray: (self.ray + self.across * (offset_px / self.width_px)).normalize(),
            point: point.position.extend(0.0),
            tangent: DVec3::new(-point.normal.y, point.normal.x, 0.0),
            sigmas: sigmas(self.width_px),
            pixels_per_rad: self.pixels_per_rad(),
            bends: self.bends,
            row: self.row,
            distance: self.distance,
            line,
            follows,
        }
    }

    /// The line's middle along the normal, in pixels from where it was expected.
    fn find(&self, image: &LineImage, reach_px: f64, contrast: f64) -> Outcome {
        const MAX_SAMPLES: usize = 160;
        let width = self.width_px as f32;
        let step = (width / 6.0).clamp(0.5, 1.5);
        let in_steps = |pixels: f32| libm::roundf(pixels / step) as usize;
        // Half the line, the blur at its edge, the carpet beside it.
        let (band, gap, flank) = (in_steps(0.5 * width - 0.25), in_steps(1.5), in_steps((width / 3.0).max(2.0)));
        let margin = band + gap + flank;
        let reach = (in_steps(reach_px as f32)).min((MAX_SAMPLES - 1) / 2 - margin.min((MAX_SAMPLES - 1) / 2 - 1));
        let half = reach + margin;
        let count = 2 * half + 1;
        if count > MAX_SAMPLES {
            return Outcome::Hidden;
        }
        let (u0, v0) = (self.middle.x as f32, self.middle.y as f32);
        let (du, dv) = (self.direction.x as f32 * step, self.direction.y as f32 * step);
        let (mut profile, mut sums) = ([0.0f32; MAX_SAMPLES], [0.0f32; MAX_SAMPLES + 1]);
        let (profile, sums) = (&mut profile[..count], &mut sums[..count + 1]);
        if !image.profile([u0, v0], [du, dv], profile) {
            return Outcome::Hidden;
        }
        let mut sum = 0.0;
        for (total, value) in sums[1..].iter_mut().zip(&*profile) {
            sum += value;
            *total = sum;
        }
        let (per_band, per_flank) = (1.0 / (2 * band + 1) as f32, 1.0 / flank as f32);
        let sum = |from: usize, to: usize| sums[to] - sums[from];
        let flanks = |middle: usize| {
            let left = sum(middle - margin, middle - margin + flank);
            let right = sum(middle + margin + 1 - flank, middle + margin + 1);
            (left * per_flank, right * per_flank)
        };
        let (mut best, mut at) = (f32::NEG_INFINITY, half);
        for middle in margin..count - margin {
            let (left, right) = flanks(middle);
            let response = sum(middle - band, middle + band + 1) * per_band - left.max(right);
            if response > best {
                (best, at) = (response, middle);
            }
        }
        let hidden = |steps: f32| image.hides(u0 + steps * du, v0 + steps * dv);
        let beside = (band + gap + flank / 2) as f32;
        let offset = at as f32 - half as f32;
        if hidden(offset) || hidden(offset - beside) || hidden(offset + beside) {
            return Outcome::Hidden;
        }
        // Where a lens's picture ends, or a robot's shadow begins, a line is cut and its middle elsewhere; beyond there is none.
        let is_carpet = |(left, right): (f32, f32)| {
            f64::from((left - right).abs()) < LEAST_CONTRAST * contrast && f64::from(left.max(right)) > UNLIT * contrast
        };
        // A line thinner than the pixels' own blur shows less.
        let shown = contrast * (self.width_px / 2.0).min(1.0);
        if f64::from(best) < LEAST_CONTRAST * shown {
            // Carpet is darker than a line would be; brightness beyond the field or a robot's shell says nothing.
            let is_seen = !(hidden(0.0) || hidden(-beside) || hidden(beside)) && is_carpet(flanks(half));
            return if is_seen { Outcome::Missed } else { Outcome::Hidden };
        }
        if !is_carpet(flanks(at)) {
            return Outcome::Hidden;
        }
        Outcome::Found(f64::from(centroid(profile, at, band + gap, flanks(at)) - half as f32) * f64::from(step))
    }
}

/// Standard deviation of the place of a line so wide: 1 at the best width, which is sqrt([`THIN_PX`] [`WIDE_PX`]). Fitted to what
/// the places in ten logs lie off (docs/design.md).
fn sigmas(width_px: f64) -> f64 {
    let (thin, wide) = (THIN_PX / width_px, width_px / WIDE_PX);
    libm::sqrt((1.0 + thin * thin + wide * wide) / (1.0 + 2.0 * THIN_PX / WIDE_PX))
}

/// Centre of what stands out of the carpet within `reach` samples of the peak, the carpet's brightness going
/// straight from the left flank's to the right one's.
fn centroid(profile: &[f32], peak: usize, reach: usize, (left, right): (f32, f32)) -> f32 {
    let (mut sum, mut moment) = (0.0f32, 0.0f32);
    let (carpet, slope) = (0.5 * (left + right), (right - left) / (2.0 * reach as f32 + 1.0));
    for (k, value) in profile[peak - reach..=peak + reach].iter().enumerate() {
        let off = k as f32 - reach as f32;
        let above = value - (carpet + slope * off);
        sum += above;
        moment += above * off;
    }
    if sum > 0.0 { peak as f32 + (moment / sum).clamp(-(reach as f32), reach as f32) } else { peak as f32 }
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
