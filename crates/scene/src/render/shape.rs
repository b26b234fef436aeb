//! Painted lines and rectangles, and the share of a pixel that they cover.

use glam::DVec2;

use super::footprint::{GroundPoint, tent_integral};
use realitysim_geometry::Field;
use realitysim_geometry::field::Stroke;

/// A painted line. Lengths are metres, positions are in `map`.
#[derive(Clone, Copy, Debug)]
pub(super) enum Shape {
    /// A straight line with square ends. `along` is a unit vector.
    Bar { centre: [f32; 2], along: [f32; 2], half_length: f32, half_width: f32 },
    /// A circle.
    Ring { centre: [f32; 2], radius: f32, half_width: f32 },
    /// A quarter of a circle, where x and y have the signs of `side` from the centre.
    Quarter { centre: [f32; 2], side: [f32; 2], radius: f32, half_width: f32 },
}

impl Shape {
    /// All painted lines of a field.
    pub(super) fn all(field: &Field) -> Vec<Shape> {
        let half_width = (field.line_width() / 2.0) as f32;
        let shape = |stroke| match stroke {
            Stroke::Segment { from, to } => Shape::Bar {
                centre: ((from + to) / 2.0).as_vec2().to_array(),
                along: (to - from).normalize_or(DVec2::X).as_vec2().to_array(),
                half_length: (from.distance(to) / 2.0) as f32,
                half_width,
            },
            Stroke::Circle { centre, radius } => {
                Shape::Ring { centre: centre.as_vec2().to_array(), radius: radius as f32, half_width }
            }
            Stroke::Quarter { centre, radius, side } => Shape::Quarter {
                centre: centre.as_vec2().to_array(),
                side: side.as_vec2().to_array(),
                radius: radius as f32,
                half_width,
            },
        };
        field.painted_strokes().into_iter().map(shape).collect()
    }

    /// Whether paint may lie within `margin` of the square around `centre`. It may be true for paint slightly farther away.
    pub(super) fn near(&self, centre: [f32; 2], half_side: f32, margin: f32) -> bool {
        let reach = half_side * core::f32::consts::SQRT_2 + margin;
        match *self {
            Shape::Bar { centre: own, along, half_length, half_width } => {
                let (x, y) = (centre[0] - own[0], centre[1] - own[1]);
                let t = (x * along[0] + y * along[1]).abs() - half_length;
                let s = (x * along[1] - y * along[0]).abs() - half_width;
                t <= reach && s <= reach
            }
            Shape::Ring { centre: own, radius, half_width } => {
                let from_centre = libm::hypotf(centre[0] - own[0], centre[1] - own[1]);
                (from_centre - radius).abs() <= half_width + reach
            }
            Shape::Quarter { centre: own, side, radius, half_width } => {
                let (x, y) = ((centre[0] - own[0]) * side[0], (centre[1] - own[1]) * side[1]);
                let is_on_side = x >= -reach && y >= -reach;
                is_on_side && (libm::hypotf(x, y) - radius).abs() <= half_width + reach
            }
        }
    }

    /// Share of the pixel that the line covers, 0 to 1.
    #[inline]
    pub(super) fn coverage(&self, p: &GroundPoint) -> f32 {
        let reach = p.reach;
        match *self {
            Shape::Bar { centre, along, half_length, half_width } => {
                let (x, y) = (p.x - centre[0], p.y - centre[1]);
                let s = x * along[1] - y * along[0];
                let t = x * along[0] + y * along[1];
                if s.abs() > half_width + reach || t.abs() > half_length + reach {
                    return 0.0;
                }
                let across = band(p, s, along[1], -along[0], half_width);
                // Far from both ends the length has no effect.
                if t.abs() < half_length - reach {
                    across
                } else {
                    across * band(p, t, along[0], along[1], half_length)
                }
            }
            Shape::Ring { centre, radius, half_width } => around(p, centre, radius, half_width),
            Shape::Quarter { centre, side, radius, half_width } => {
                let (x, y) = ((p.x - centre[0]) * side[0], (p.y - centre[1]) * side[1]);
                if x < -reach || y < -reach {
                    return 0.0;
                }
                let ring = around(p, centre, radius, half_width);
                // Far from both ends the ring has no end.
                if x > reach && y > reach {
                    return ring;
                }
                let (in_x, _) = p.pixels_to(x, side[0], 0.0);
                let (in_y, _) = p.pixels_to(y, 0.0, side[1]);
                ring * tent_integral(in_x) * tent_integral(in_y)
            }
        }
    }
}

/// Share of the pixel that a ring covers, 0 to 1.
#[inline]
fn around(p: &GroundPoint, centre: [f32; 2], radius: f32, half_width: f32) -> f32 {
    let (x, y) = (p.x - centre[0], p.y - centre[1]);
    let from_centre = (x * x + y * y).sqrt();
    let s = from_centre - radius;
    if s.abs() > half_width + p.reach {
        return 0.0;
    }
    let scale = 1.0 / from_centre.max(1e-6);
    band(p, s, x * scale, y * scale, half_width)
}

/// Share of a pixel at signed distance `s` that lies between -`half` and +`half`. The distance grows along (nx, ny).
#[inline]
fn band(p: &GroundPoint, s: f32, nx: f32, ny: f32, half: f32) -> f32 {
    let (pixels, per_metre) = p.pixels_to(s, nx, ny);
    let half = half * per_metre;
    tent_integral(pixels + half) - tent_integral(pixels - half)
}

/// Share of the pixel inside the rectangle around the origin with these half sides.
#[inline]
pub(super) fn inside_rectangle(p: &GroundPoint, half_x: f32, half_y: f32) -> f32 {
    let reach = p.reach;
    let (x, y) = (half_x - p.x.abs(), half_y - p.y.abs());
    if x > reach && y > reach {
        return 1.0;
    }
    if x < -reach || y < -reach {
        return 0.0;
    }
    let (in_x, _) = p.pixels_to(x, -1f32.copysign(p.x), 0.0);
    let (in_y, _) = p.pixels_to(y, 0.0, -1f32.copysign(p.y));
    tent_integral(in_x) * tent_integral(in_y)
}
