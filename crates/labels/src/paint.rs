//! The painted lines of a field as areas: how far a point of the ground is from the nearest edge of paint.

use glam::DVec2;

use realitysim_geometry::Field;
use realitysim_geometry::field::Stroke;

/// The paint of a field, in cells of the carpet so that few strokes are looked at for a point.
#[derive(Clone, Debug)]
pub(crate) struct Paint {
    strokes: Vec<Painted>,
    half_width: f64,
    /// Half extents of the carpet, metres.
    half: DVec2,
    columns: usize,
    rows: usize,
    /// For each cell, row by row: the strokes that a point of it may be near.
    cells: Vec<Vec<u16>>,
}

/// A stroke, prepared for the many points that ask for its edge.
#[derive(Clone, Debug)]
enum Painted {
    /// Its middle, the unit vector along it, and half of its length in metres.
    Segment { middle: DVec2, along: DVec2, half_length: f64 },
    /// A curved stroke.
    Curve(Stroke),
}

/// An edge of paint near a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Edge {
    /// Distance from the edge, metres; negative on paint.
    pub(crate) distance: f64,
    /// Unit vector across the edge.
    pub(crate) normal: DVec2,
}

/// The cells name the strokes whose edges are within this distance, metres; for farther ones, all strokes are looked at.
const REACH_M: f64 = 0.06;
/// Side of a cell, metres.
const CELL_M: f64 = 0.1;

impl Paint {
    pub(crate) fn new(field: &Field) -> Self {
        let (strokes, half_width, half) =
            (field.painted_strokes(), field.line_width() / 2.0, field.carpet_half_extent());
        let count = |side: f64| libm::ceil(2.0 * side / CELL_M).max(1.0) as usize;
        let (columns, rows) = (count(half.x), count(half.y));
        let near = |index: usize| {
            let at = DVec2::new((index % columns) as f64 + 0.5, (index / columns) as f64 + 0.5) * CELL_M - half;
            let reach = half_width + REACH_M + CELL_M;
            let strokes = strokes.iter().enumerate().filter(|(_, stroke)| stroke.distance(at) <= reach);
            strokes.map(|(which, _)| which as u16).collect()
        };
        let cells = (0..columns * rows).map(near).collect();
        let strokes = strokes.iter().map(Painted::of).collect();
        Self { strokes, half_width, half, columns, rows, cells }
    }

    /// The edge of paint that is nearest to a point of the carpet, if it is within `reach_m`, or the point on paint.
    pub(crate) fn nearest_edge(&self, point: DVec2, reach_m: f64) -> Option<Edge> {
        if reach_m > REACH_M {
            return nearest(self.strokes.iter(), self.half_width, point, reach_m);
        }
        let cell = (point + self.half) / CELL_M;
        let column = (cell.x.max(0.0) as usize).min(self.columns - 1);
        let row = (cell.y.max(0.0) as usize).min(self.rows - 1);
        let near = self.cells[row * self.columns + column].iter();
        nearest(near.map(|which| &self.strokes[usize::from(*which)]), self.half_width, point, reach_m)
    }
}

/// The nearest edge of some strokes, if it is within `reach_m`.
fn nearest<'a>(
    strokes: impl Iterator<Item = &'a Painted>,
    half_width: f64,
    point: DVec2,
    reach_m: f64,
) -> Option<Edge> {
    let edges = strokes.filter(|stroke| stroke.may_reach(half_width + reach_m, point));
    let edges = edges.map(|stroke| edge(stroke, half_width, point));
    edges.min_by(|a, b| a.distance.total_cmp(&b.distance)).filter(|edge| edge.distance <= reach_m)
}

impl Painted {
    fn of(stroke: &Stroke) -> Self {
        match *stroke {
            Stroke::Segment { from, to } => {
                let along = (to - from).normalize_or(DVec2::X);
                Self::Segment { middle: (from + to) / 2.0, along, half_length: from.distance(to) / 2.0 }
            }
            curve => Self::Curve(curve),
        }
    }

    /// Whether a point may be this near to the centre line: false only if it surely is not.
    fn may_reach(&self, distance: f64, point: DVec2) -> bool {
        match *self {
            Self::Segment { middle, along, half_length } => {
                let off = point - middle;
                off.dot(along.perp()).abs() <= distance && off.dot(along).abs() <= half_length + distance
            }
            Self::Curve(Stroke::Circle { centre, radius } | Stroke::Quarter { centre, radius, .. }) => {
                (point - centre).abs().max_element() <= radius + distance
            }
            Self::Curve(Stroke::Segment { .. }) => true,
        }
    }
}

/// The edge of one stroke.
fn edge(stroke: &Painted, half_width: f64, point: DVec2) -> Edge {
    let curve = match *stroke {
        Painted::Segment { middle, along, half_length } => {
            let off = point - middle;
            let [x, y] = [off.dot(along), off.dot(along.perp())];
            let [beyond, beside] = [x.abs() - half_length, y.abs() - half_width];
            let [ends, sides] = [along * x.signum(), along.perp() * y.signum()];
            return match (beyond > 0.0, beside > 0.0) {
                (true, true) => {
                    let out = DVec2::new(beyond, beside);
                    let distance = out.length();
                    Edge { distance, normal: (ends * beyond + sides * beside) / distance }
                }
                _ if beyond > beside => Edge { distance: beyond, normal: ends },
                _ => Edge { distance: beside, normal: sides },
            };
        }
        Painted::Curve(curve) => curve,
    };
    match curve {
        Stroke::Segment { .. } => edge(&Painted::of(&curve), half_width, point),
        Stroke::Circle { centre, radius } => ring(point - centre, radius, half_width),
        Stroke::Quarter { centre, radius, side } => {
            let off = point - centre;
            let own = off * side;
            if own.min_element() >= 0.0 {
                return ring(off, radius, half_width);
            }
            // Beyond an end, the nearest point is on the cross-section there.
            let ends =
                [DVec2::X, DVec2::Y].map(|axis| axis * own.dot(axis).clamp(radius - half_width, radius + half_width));
            let nearest = if own.distance(ends[0]) < own.distance(ends[1]) { ends[0] } else { ends[1] };
            let out = own - nearest;
            Edge { distance: out.length(), normal: (out * side).normalize_or(DVec2::X) }
        }
    }
}

/// The edge of a ring around the origin.
fn ring(point: DVec2, radius: f64, half_width: f64) -> Edge {
    let off = point.length() - radius;
    Edge { distance: off.abs() - half_width, normal: point.normalize_or(DVec2::X) * off.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use realitysim_config::load_field;

    proptest! {
        /// Paint ends half a width beside the centre line, and at most at its corners' diagonal.
        #[test]
        fn paint_ends_half_a_width_beside_the_centre_line(
            x in -4.0..4.0f64, y in -3.0..3.0f64, reach_m in prop::sample::select(vec![0.0, 0.03, 0.06, 0.4]),
        ) {
            let field = Field::new(load_field("kid-2020").unwrap()).unwrap();
            let point = DVec2::new(x, y);
            let half_width = field.line_width() / 2.0;
            let centre = field.distance_to_centre_line(point);
            match Paint::new(&field).nearest_edge(point, reach_m) {
                None => prop_assert!(centre >= reach_m),
                Some(edge) => {
                    prop_assert!(edge.distance <= centre + 1e-9);
                    prop_assert!(edge.distance >= centre - core::f64::consts::SQRT_2 * half_width - 1e-9);
                    prop_assert!((edge.normal.length() - 1.0).abs() < 1e-9);
                    // Going along the normal leaves the paint, or comes nearer to another line.
                    let farther = Paint::new(&field).nearest_edge(point + edge.normal * 1e-4, reach_m);
                    prop_assert!(farther.is_none_or(|farther| farther.distance <= edge.distance + 1.001e-4));
                }
            }
        }
    }
}
