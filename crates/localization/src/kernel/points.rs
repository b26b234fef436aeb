//! Line points in the form that the kernel reads.

use glam::DVec2;

use super::LANES;

/// Points in `map`, as multiples of a unit about a centre. For a field 9 m long the unit is a seventh of a millimetre.
#[derive(Clone, Debug, Default)]
pub struct Points {
    pub(super) places: Vec<[i16; 2]>,
    pub(super) centre: DVec2,
    pub(super) unit_m: f64,
}

/// Smallest unit, metres: that of a single point, or of several that lie close together.
const MIN_UNIT_M: f64 = 1e-5;

impl Points {
    /// Converts positions in `map`, metres.
    pub fn new(positions: impl IntoIterator<Item = DVec2>) -> Self {
        let positions: Vec<DVec2> = positions.into_iter().collect();
        let (low, high) = positions.iter().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), position| {
            (low.min(*position), high.max(*position))
        });
        let centre = if positions.is_empty() { DVec2::ZERO } else { (low + high) / 2.0 };
        let unit_m = ((high - low).max_element() / 2.0 / f64::from(i16::MAX)).max(MIN_UNIT_M);
        let place = |position: &DVec2| ((*position - centre) / unit_m).to_array().map(|part| libm::round(part) as i16);
        Self { places: positions.iter().map(place).collect(), centre, unit_m }
    }

    /// Replaces the points by those of `other` in the given groups of [`LANES`] points, in ascending order. The buffer is used again.
    pub fn select(&mut self, other: &Points, groups: impl Iterator<Item = usize>) {
        (self.centre, self.unit_m) = (other.centre, other.unit_m);
        self.places.clear();
        for group in groups {
            let first = (group * LANES).min(other.len());
            self.places.extend_from_slice(&other.places[first..(first + LANES).min(other.len())]);
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }
}
