//! Placement of words beside points, so that none lies over another or off the sheet.

use glam::DVec2;

/// The rectangles of a sheet that are taken, each as left top and right bottom corner.
pub(super) struct LabelLayout {
    taken: Vec<(DVec2, DVec2)>,
    low: DVec2,
    high: DVec2,
}

/// Free space beside words, pixels.
const GAP: f64 = 2.0;
/// Distance between a point and its words, pixels.
const BESIDE: f64 = 8.0;
/// Number of rings around a point on which positions are tried, from the innermost outwards.
const RINGS: i32 = 9;
/// Distance between the rings, pixels.
const RING: f64 = 16.0;
/// Number of positions on a ring.
const DIRECTIONS: i32 = 16;

impl LabelLayout {
    /// Returns an empty sheet between two corners.
    pub(super) fn within(low: DVec2, high: DVec2) -> Self {
        Self { taken: Vec::new(), low, high }
    }

    /// Takes the room of words whose baseline starts at `corner`.
    pub(super) fn occupy(&mut self, corner: DVec2, size: DVec2) {
        self.taken.push(rectangle(corner, size));
    }

    /// Places words beside a point. Returns where their baseline starts, and whether they are so far off that a line
    /// should lead to them.
    pub(super) fn place_label(&mut self, at: DVec2, size: DVec2) -> (DVec2, bool) {
        let right = DVec2::new(at.x + BESIDE, at.y + 0.35 * size.y);
        let left = DVec2::new(at.x - BESIDE - size.x, right.y);
        let above = DVec2::new(at.x - size.x / 2.0, at.y - BESIDE);
        let below = DVec2::new(at.x - size.x / 2.0, at.y + BESIDE + 0.8 * size.y);
        let beside = [right, left, above, below].map(|corner| (corner, false));
        let around = (1..=RINGS).flat_map(|ring| {
            (0..DIRECTIONS).map(move |direction| {
                let angle = core::f64::consts::TAU * f64::from(direction) / f64::from(DIRECTIONS);
                let (sin, cos) = libm::sincos(angle);
                let off = DVec2::new(cos, -sin) * (BESIDE + f64::from(ring) * RING);
                let corner = at + off + DVec2::new(if cos < 0.0 { -size.x } else { 0.0 }, 0.35 * size.y);
                (corner, true)
            })
        });
        let found = beside.into_iter().chain(around).find(|(corner, _)| self.is_free(*corner, size));
        // If there is no room, the words lie over others rather than off the sheet.
        let clamped =
            right.clamp(self.low + DVec2::new(0.0, size.y), (self.high - DVec2::new(size.x, 0.0)).max(self.low));
        let (corner, leader) = found.unwrap_or((clamped, false));
        self.occupy(corner, size);
        (corner, leader)
    }

    fn is_free(&self, corner: DVec2, size: DVec2) -> bool {
        let (low, high) = rectangle(corner, size);
        let inside = low.cmpge(self.low).all() && high.cmple(self.high).all();
        inside && !self.taken.iter().any(|(a, b)| low.cmplt(*b).all() && high.cmpgt(*a).all())
    }
}

/// Returns the rectangle that words take.
fn rectangle(corner: DVec2, size: DVec2) -> (DVec2, DVec2) {
    (corner - DVec2::new(GAP, size.y), corner + DVec2::new(size.x + GAP, 0.25 * size.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_do_not_overlap() {
        let mut layout = LabelLayout::within(DVec2::ZERO, DVec2::splat(400.0));
        let size = DVec2::new(80.0, 13.0);
        let corners: Vec<DVec2> =
            (0..8).map(|i| layout.place_label(DVec2::new(200.0 + f64::from(i), 200.0), size).0).collect();
        for (i, a) in corners.iter().enumerate() {
            for b in &corners[..i] {
                assert!((a.x - b.x).abs() >= size.x || (a.y - b.y).abs() >= size.y, "{a} {b}");
            }
        }
    }
}
