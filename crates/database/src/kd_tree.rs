//! Nearest neighbours among poses by a balanced k-d tree over positions and viewing directions.
//!
//! The leaves are runs of records, and the two halves of a node meet at the middle leaf of its run. So the tree is one array
//! of splits beside the records, and the weights of the metric can be chosen for each search.

use glam::{DQuat, DVec3};

use super::record::Record;
use realitysim_geometry::Isometry;

/// A distance between two poses: the root of the sum of three squares, each term times its weight.
///
/// The terms are the distance of the positions, the chord between the viewing directions (unit vectors), and the twist about
/// the viewing direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// Weight of a metre of distance.
    pub per_m: f64,
    /// Weight of the chord between the viewing directions, which is 0 to 2.
    pub per_direction: f64,
    /// Weight of a radian of twist about the viewing direction.
    pub per_roll: f64,
}

/// The weights by which the sources of a view are chosen: a turn by a radian costs half as much of a view as a step by a metre.
impl Default for Metric {
    fn default() -> Self {
        Self { per_m: 1.0, per_direction: 0.5, per_roll: 0.3 }
    }
}

/// The split of a node's run into two halves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Split {
    /// The coordinate that is split: 0 to 2 are x, y, z of the position, 3 to 5 those of the viewing direction.
    pub(super) dimension: u32,
    /// Value of the coordinate at which the second half begins.
    pub(super) value: f32,
}

/// Number of records in a leaf.
pub(super) const LEAF: usize = 24;
const DIMENSIONS: usize = 6;

/// Position and viewing direction, the coordinates of the tree.
pub(super) type Point = [f32; DIMENSIONS];

/// The coordinates of a pose.
pub(super) fn point(place: [f32; 3], rotation: [f32; 4]) -> Point {
    let [x, y, z, w] = rotation;
    // The camera looks along x, so the viewing direction is the first column of the rotation matrix.
    let forward = [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)];
    [place[0], place[1], place[2], forward[0], forward[1], forward[2]]
}

/// Number of leaves of a tree of this many records.
pub(super) fn leaves(count: usize) -> usize {
    count.div_ceil(LEAF)
}

/// Brings the records into the tree's order and returns one split for each leaf; split i lies before leaf i, and the first
/// one is unused.
pub(super) fn build(records: &mut [Record]) -> Vec<Split> {
    let count = leaves(records.len());
    let mut splits = vec![Split::default(); count.max(1)];
    split_run(records, 0, count, &mut splits);
    splits
}

/// Splits the run of the leaves from `first` up to `end` recursively. `records` are the records of these leaves.
fn split_run(records: &mut [Record], first: usize, end: usize, splits: &mut [Split]) {
    if end - first < 2 {
        return;
    }
    let middle = (first + end) / 2;
    let dimension = widest(records);
    let at = (middle - first) * LEAF;
    let of = |record: &Record| point(record.place, record.rotation)[dimension];
    let (_, pivot, _) = records.select_nth_unstable_by(at, |a, b| of(a).total_cmp(&of(b)));
    splits[middle] = Split { dimension: dimension as u32, value: of(pivot) };
    let (low, high) = records.split_at_mut(at);
    split_run(low, first, middle, splits);
    split_run(high, middle, end, splits);
}

/// The coordinate in which the records differ most.
fn widest(records: &[Record]) -> usize {
    let (mut low, mut high) = ([f32::INFINITY; DIMENSIONS], [f32::NEG_INFINITY; DIMENSIONS]);
    for record in records {
        for (i, value) in point(record.place, record.rotation).into_iter().enumerate() {
            (low[i], high[i]) = (low[i].min(value), high[i].max(value));
        }
    }
    let spread = |i: &usize| high[*i] - low[*i];
    (0..DIMENSIONS).max_by(|a, b| spread(a).total_cmp(&spread(b))).unwrap_or(0)
}

/// A search for the nearest records.
pub(super) struct Search<'a, F, G> {
    /// Number of records.
    pub(super) count: usize,
    /// Gives the split before a leaf.
    pub(super) split: F,
    /// Gives the pose of a record.
    pub(super) pose: G,
    pub(super) metric: &'a Metric,
    /// Number of neighbours to find.
    pub(super) wanted: usize,
}

/// Position (metres) and rotation (unit quaternion x, y, z, w) of a record.
pub(super) type Pose = ([f32; 3], [f32; 4]);

struct Query {
    point: [f64; DIMENSIONS],
    weights: [f64; DIMENSIONS],
    inverse: DQuat,
}

impl<F: Fn(usize) -> Split, G: Fn(usize) -> Pose> Search<'_, F, G> {
    /// Squared distances and numbers of the nearest records, nearest first.
    pub(super) fn nearest(&self, pose: &Isometry) -> Vec<(f64, usize)> {
        let forward = pose.transform_vector(DVec3::X);
        let place = pose.translation;
        let (m, d) = (self.metric.per_m, self.metric.per_direction);
        let query = Query {
            point: [place.x, place.y, place.z, forward.x, forward.y, forward.z],
            weights: [m, m, m, d, d, d].map(|weight| weight * weight),
            inverse: pose.rotation.conjugate(),
        };
        let mut found = Vec::with_capacity(self.wanted + 1);
        if self.wanted > 0 && self.count > 0 {
            self.descend(&query, (0, leaves(self.count)), [0.0; DIMENSIONS], &mut found);
        }
        found
    }

    /// Searches the run of the leaves from `first` up to `end`.
    ///
    /// `off` is the squared and weighted distance of the query from the run's box along each dimension.
    fn descend(
        &self,
        query: &Query,
        (first, end): (usize, usize),
        off: [f64; DIMENSIONS],
        found: &mut Vec<(f64, usize)>,
    ) {
        if end - first < 2 {
            (first * LEAF..(end * LEAF).min(self.count)).for_each(|index| self.take(query, index, found));
            return;
        }
        let middle = (first + end) / 2;
        let split = (self.split)(middle);
        let dimension = (split.dimension as usize).min(DIMENSIONS - 1);
        let beyond = query.point[dimension] - f64::from(split.value);
        let (near, far) =
            if beyond < 0.0 { ((first, middle), (middle, end)) } else { ((middle, end), (first, middle)) };
        self.descend(query, near, off, found);
        let mut off = off;
        off[dimension] = beyond * beyond * query.weights[dimension];
        if found.len() < self.wanted || off.iter().sum::<f64>() < found[found.len() - 1].0 {
            self.descend(query, far, off, found);
        }
    }

    /// Inserts a record into `found` if it is among the nearest so far.
    fn take(&self, query: &Query, index: usize, found: &mut Vec<(f64, usize)>) {
        let (place, rotation) = (self.pose)(index);
        let point = point(place, rotation);
        let mut square = 0.0;
        for ((wanted, weight), own) in query.point.iter().zip(query.weights).zip(point) {
            let off = wanted - f64::from(own);
            square += weight * off * off;
        }
        let full = found.len() == self.wanted;
        let worst = if full { found[found.len() - 1].0 } else { f64::INFINITY };
        if square.is_nan() || square >= worst {
            return;
        }
        let [x, y, z, w] = rotation.map(f64::from);
        let turn = query.inverse * DQuat::from_xyzw(x, y, z, w);
        let twist = self.metric.per_roll * twist(turn);
        square += twist * twist;
        if square < worst {
            if full {
                found.pop();
            }
            let at = found.partition_point(|(known, _)| *known <= square);
            found.insert(at, (square, index));
        }
    }
}

/// The twist of a rotation about the viewing direction (x), radians, 0 to pi.
fn twist(turn: DQuat) -> f64 {
    2.0 * libm::atan2(turn.x.abs(), turn.w.abs())
}

impl Metric {
    /// The distance between two poses.
    pub fn distance(&self, a: &Isometry, b: &Isometry) -> f64 {
        let metres = self.per_m * a.translation.distance(b.translation);
        let chord = self.per_direction * a.transform_vector(DVec3::X).distance(b.transform_vector(DVec3::X));
        let twist = self.per_roll * twist(a.rotation.conjugate() * b.rotation);
        libm::sqrt(metres * metres + chord * chord + twist * twist)
    }

    /// Whether two poses are at least this distance apart. The positions alone usually decide, which is quick.
    pub fn is_apart(&self, a: &Isometry, b: &Isometry, distance: f64) -> bool {
        let square = distance * distance;
        let metres = self.per_m * self.per_m * a.translation.distance_squared(b.translation);
        metres >= square || self.distance(a, b) >= distance
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::tests::record_at;
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_tree_finds_what_a_look_at_all_finds(
            poses in proptest::collection::vec((-3.0..3.0f64, -2.0..2.0f64, 0.4..0.6f64, -3.1..3.1f64), 0..400),
            x in -4.0..4.0f64, y in -3.0..3.0f64, yaw in -3.1..3.1f64, wanted in 1..12usize,
            per_m in 0.1..3.0f64, per_direction in 0.0..2.0f64, per_roll in 0.0..1.0f64,
        ) {
            let mut records: Vec<Record> = poses.iter().map(|(x, y, z, yaw)| record_at(*x, *y, *z, *yaw)).collect();
            let splits = build(&mut records);
            let metric = Metric { per_m, per_direction, per_roll };
            let pose = record_at(x, y, 0.5, yaw).pose();
            let search = Search {
                count: records.len(),
                split: |i: usize| splits[i],
                pose: |i: usize| (records[i].place, records[i].rotation),
                metric: &metric,
                wanted,
            };
            let found: Vec<f64> = search.nearest(&pose).iter().map(|(square, _)| square.sqrt()).collect();
            let mut all: Vec<f64> = records.iter().map(|record| metric.distance(&pose, &record.pose())).collect();
            all.sort_by(f64::total_cmp);
            all.truncate(wanted);
            prop_assert_eq!(found.len(), all.len());
            for (found, all) in found.iter().zip(all) {
                prop_assert!((found - all).abs() < 1e-5, "{} {}", found, all);
            }
        }
    }
}
