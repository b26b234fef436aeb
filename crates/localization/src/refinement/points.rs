//! Sample points on the field lines.

use glam::DVec2;

use realitysim_geometry::{Field, field::Stroke};

/// Sample points, 4 cm apart, on the lines of a field.
#[derive(Clone, Debug, PartialEq)]
pub struct LinePoints {
    /// For each stroke, its points in order.
    pub(super) strokes: Vec<Vec<LinePoint>>,
    pub(super) line_width_m: f64,
}

/// A point on the centre of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LinePoint {
    /// Metres, in `map`.
    pub(super) position: DVec2,
    /// Unit vector across the line.
    pub(super) normal: DVec2,
}

/// Distance between points along a line, metres.
const SPACING_M: f64 = 0.04;
/// Shorter strokes, such as crosses and marks, have no clear direction and are left out.
const MIN_LENGTH_M: f64 = 0.3;
/// Smallest distance from another line, in line widths: the paint of a nearer one disturbs the profile.
const MIN_CLEARANCE: f64 = 2.0;

impl LinePoints {
    /// Samples the lines of `field`, leaving out short strokes and points close to another line.
    pub fn new(field: &Field) -> Self {
        let line_width_m = field.line_width();
        let long = field.strokes().iter().filter(|stroke| stroke.length() >= MIN_LENGTH_M);
        let clear = |own: &Stroke, at: DVec2| {
            field.strokes().iter().all(|other| other == own || other.distance(at) > MIN_CLEARANCE * line_width_m)
        };
        let strokes = long
            .map(|stroke| {
                stroke
                    .points(SPACING_M)
                    .into_iter()
                    .filter(|point| clear(stroke, point.position))
                    .map(|point| LinePoint { position: point.position, normal: point.normal })
                    .collect()
            })
            .collect();
        Self { strokes, line_width_m }
    }

    /// Distance to the nearest point of a line, metres.
    pub(super) fn distance(&self, at: DVec2) -> f64 {
        self.strokes.iter().flatten().map(|point| point.position.distance(at)).fold(f64::INFINITY, f64::min)
    }
}
