//! Line points as the kernel reads them.

use glam::DVec2;

use super::LANES;

/// Places in `map`, as multiples of a unit about a centre: for a field 9 m long the unit is a seventh of a millimetre.
#[derive(Clone, Debug, Default)]
pub struct Points {
    pub(super) places: Vec<[i16; 2]>,
    pub(super) centre: DVec2,
    pub(super) unit_m: f64,
}

/// Of a single point, or several that lie closer together.
const LEAST_UNIT_M: f64 = 1e-5;

impl Points {
    pub fn new(positions: impl IntoIterator<Item = DVec2>) -> Self {
        let positions: Vec<DVec2> = positions.into_iter().collect();
        let (low, high) = positions.iter().fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), position| {
            (low.min(*position), high.max(*position))
        });
        let centre = if positions.is_empty() { DVec2::ZERO } else { (low + high) / 2.0 };
        let unit_m = ((high - low).max_element() / 2.0 / f64::from(i16::MAX)).max(LEAST_UNIT_M);
        let place = |position: &DVec2| ((*position - centre) / unit_m).to_array().map(|part| libm::round(part) as i16);
        Self { places: positions.iter().map(place).collect(), centre, unit_m }
    }

    /// Those of `other`'s points that lie in the given groups of [`LANES`], in ascending order; nothing is allocated twice.
    pub fn select(&mut self, other: &Points, groups: impl Iterator<Item = usize>) {
        (self.centre, self.unit_m) = (other.centre, other.unit_m);
        self.places.clear();
        for group in groups {
            let first = (group * LANES).min(other.len());
            self.places.extend_from_slice(&other.places[first..(first + LANES).min(other.len())]);
        }
    }

    pub fn len(&self) -> usize {
        self.places.len()
    }

    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }
}
