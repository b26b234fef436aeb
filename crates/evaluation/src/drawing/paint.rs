//! The paint of the field as areas with outlines: painted lines have a width, square ends and full corners.

use core::f64::consts::{FRAC_PI_2, TAU};

use glam::DVec2;

use realitysim_geometry::Field;
use realitysim_geometry::field::Stroke;

/// The area of one painted line, metres in `map`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Patch {
    Bar {
        from: DVec2,
        to: DVec2,
        half_width: f64,
    },
    Ring {
        centre: DVec2,
        radius: f64,
        half_width: f64,
    },
    /// A quarter of a ring, where x and y have the signs of `side` from the centre.
    Quarter {
        centre: DVec2,
        side: DVec2,
        radius: f64,
        half_width: f64,
    },
}

/// An edge of a patch, as a curve from t = 0 to t = 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Edge {
    Straight { from: DVec2, to: DVec2 },
    Round { centre: DVec2, radius: f64 },
    Quarter { centre: DVec2, side: DVec2, radius: f64 },
}

/// Distance from the border of a patch within which a point counts as on it, metres: coinciding borders of two patches
/// must not cover each other.
const ON_BORDER_M: f64 = 1e-9;

/// Returns the painted lines of a field.
pub(super) fn patches(field: &Field) -> Vec<Patch> {
    let half_width = field.line_width() / 2.0;
    let patch = |stroke| match stroke {
        Stroke::Segment { from, to } => Patch::Bar { from, to, half_width },
        Stroke::Circle { centre, radius } => Patch::Ring { centre, radius, half_width },
        Stroke::Quarter { centre, radius, side } => Patch::Quarter { centre, side, radius, half_width },
    };
    field.painted_strokes().into_iter().map(patch).collect()
}

impl Patch {
    pub(super) fn edges(&self) -> Vec<Edge> {
        match *self {
            Patch::Bar { from, to, half_width } => {
                let across = (to - from).normalize_or(DVec2::X).perp() * half_width;
                let corners = [from + across, to + across, to - across, from - across];
                (0..4).map(|i| Edge::Straight { from: corners[i], to: corners[(i + 1) % 4] }).collect()
            }
            Patch::Ring { centre, radius, half_width } => [radius - half_width, radius + half_width]
                .into_iter()
                .filter(|radius| *radius > 0.0)
                .map(|radius| Edge::Round { centre, radius })
                .collect(),
            // The ends lie within the lines that the quarter meets.
            Patch::Quarter { centre, side, radius, half_width } => [radius - half_width, radius + half_width]
                .into_iter()
                .filter(|radius| *radius > 0.0)
                .map(|radius| Edge::Quarter { centre, side, radius })
                .collect(),
        }
    }

    /// Returns whether a point lies within the paint and not on its border.
    pub(super) fn covers(&self, point: DVec2) -> bool {
        match *self {
            Patch::Bar { from, to, half_width } => {
                let along = (to - from).normalize_or(DVec2::X);
                let off = point - (from + to) / 2.0;
                let (t, s) = (off.dot(along).abs(), off.perp_dot(along).abs());
                t < from.distance(to) / 2.0 - ON_BORDER_M && s < half_width - ON_BORDER_M
            }
            Patch::Ring { centre, radius, half_width } => {
                (point.distance(centre) - radius).abs() < half_width - ON_BORDER_M
            }
            Patch::Quarter { centre, side, radius, half_width } => {
                let off = (point - centre) * side;
                off.min_element() > ON_BORDER_M && (off.length() - radius).abs() < half_width - ON_BORDER_M
            }
        }
    }
}

impl Edge {
    pub(super) fn at(&self, t: f64) -> DVec2 {
        match *self {
            Edge::Straight { from, to } => from.lerp(to, t),
            Edge::Round { centre, radius } => {
                let (sin, cos) = libm::sincos(TAU * t);
                centre + DVec2::new(cos, sin) * radius
            }
            Edge::Quarter { centre, side, radius } => {
                let (sin, cos) = libm::sincos(FRAC_PI_2 * t);
                centre + DVec2::new(cos, sin) * side * radius
            }
        }
    }

    pub(super) fn length(&self) -> f64 {
        match *self {
            Edge::Straight { from, to } => from.distance(to),
            Edge::Round { radius, .. } => TAU * radius,
            Edge::Quarter { radius, .. } => FRAC_PI_2 * radius,
        }
    }
}
