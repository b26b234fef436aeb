//! The places of the field at which lines are looked for.

use glam::DVec2;

use realitysim_geometry::{Field, field::Stroke};

#[derive(Clone, Debug, PartialEq)]
pub struct LinePoints {
    /// Stroke by stroke, in order along each.
    pub(super) strokes: Vec<Vec<LinePoint>>,
    pub(super) line_width_m: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LinePoint {
    pub(super) position: DVec2,
    /// Unit vector across the line.
    pub(super) normal: DVec2,
}

const SPACING_M: f64 = 0.04;
/// Crosses and marks are too short to have a direction.
const SHORTEST_M: f64 = 0.3;
/// In line widths: nearer to another line its paint disturbs the profile.
const CLEARANCE: f64 = 2.0;

impl LinePoints {
    pub fn new(field: &Field) -> Self {
        let line_width_m = field.line_width();
        let long = field.strokes().iter().filter(|stroke| stroke.length() >= SHORTEST_M);
        let clear = |own: &Stroke, at: DVec2| {
            field.strokes().iter().all(|other| other == own || other.distance(at) > CLEARANCE * line_width_m)
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

    /// Metres to the nearest place of a line.
    pub(super) fn distance(&self, at: DVec2) -> f64 {
        self.strokes.iter().flatten().map(|point| point.position.distance(at)).fold(f64::INFINITY, f64::min)
    }
}
