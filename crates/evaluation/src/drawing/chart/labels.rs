//! Room for words beside points: none over another, none off the sheet.

use glam::DVec2;

/// Rectangles that are taken, as (left top, right bottom).
pub(super) struct Placed {
    taken: Vec<(DVec2, DVec2)>,
    low: DVec2,
    high: DVec2,
}

/// Free room around words.
const GAP: f64 = 2.0;
const BESIDE: f64 = 8.0;
/// Rings of places around a point that are tried, each farther out.
const RINGS: i32 = 9;
const RING: f64 = 16.0;
const DIRECTIONS: i32 = 16;

impl Placed {
    pub(super) fn within(low: DVec2, high: DVec2) -> Self {
        Self { taken: Vec::new(), low, high }
    }

    /// Words whose baseline starts at `corner`.
    pub(super) fn occupy(&mut self, corner: DVec2, size: DVec2) {
        self.taken.push(rectangle(corner, size));
    }

    /// Where the words' baseline is to start, and whether they are so far off that a line should lead to them.
    pub(super) fn find_room(&mut self, at: DVec2, size: DVec2) -> (DVec2, bool) {
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
        // A crowd too dense for all words: better over another than lost, but on the sheet.
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

fn rectangle(corner: DVec2, size: DVec2) -> (DVec2, DVec2) {
    (corner - DVec2::new(GAP, size.y), corner + DVec2::new(size.x + GAP, 0.25 * size.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_do_not_overlap() {
        let mut placed = Placed::within(DVec2::ZERO, DVec2::splat(400.0));
        let size = DVec2::new(80.0, 13.0);
        let corners: Vec<DVec2> =
            (0..8).map(|i| placed.find_room(DVec2::new(200.0 + f64::from(i), 200.0), size).0).collect();
        for (i, a) in corners.iter().enumerate() {
            for b in &corners[..i] {
                assert!((a.x - b.x).abs() >= size.x || (a.y - b.y).abs() >= size.y, "{a} {b}");
            }
        }
    }
}
