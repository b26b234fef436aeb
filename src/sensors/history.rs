//! The recent past of one measurement, read at any time in between.

use std::collections::VecDeque;

use glam::DQuat;
use serde::{Deserialize, Serialize};

use crate::geometry::{Isometry, Pose2, wrap_angle};

/// Something that can be read between two samples.
pub trait Interpolate: Copy {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self;
    fn is_finite(&self) -> bool;
}

/// Samples in time order, the oldest forgotten.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct History<T> {
    samples: VecDeque<(i64, T)>,
    /// Samples that were not taken: not finite, or not newer than the last.
    refused: u64,
}

/// Older samples are forgotten: no frame waits this long.
const KEEP_NS: i64 = 5_000_000_000;
/// At most this many are kept, whatever their rate: five seconds at 4 kHz.
const KEEP_SAMPLES: usize = 20_000;
/// A clock that goes back by more than this has been set anew: what was before it means nothing any more.
const RESET_NS: i64 = 1_000_000_000;
/// Two samples farther apart than this are not connected by a straight line; the nearer one is taken.
const BRIDGE_NS: i64 = 500_000_000;

/// A value and how old it is: 0 when it lies between two samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T> {
    pub value: T,
    pub age_ns: i64,
}

impl<T> Default for History<T> {
    fn default() -> Self {
        Self { samples: VecDeque::new(), refused: 0 }
    }
}

impl<T: Interpolate> History<T> {
    pub fn push(&mut self, stamp_ns: i64, value: T) {
        if !value.is_finite() {
            self.refused += 1;
            return;
        }
        if let Some(newest) = self.newest_ns() {
            if stamp_ns < newest.saturating_sub(RESET_NS) {
                self.samples.clear();
            } else if stamp_ns <= newest {
                self.refused += 1;
                return;
            }
        }
        self.samples.push_back((stamp_ns, value));
        let oldest_kept = stamp_ns.saturating_sub(KEEP_NS);
        // The last sample before the kept span stays: a frame just inside it needs both neighbours.
        while self.samples.len() > KEEP_SAMPLES || self.samples.get(1).is_some_and(|(stamp, _)| *stamp < oldest_kept) {
            self.samples.pop_front();
        }
    }

    pub fn newest_ns(&self) -> Option<i64> {
        self.samples.back().map(|(stamp, _)| *stamp)
    }

    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The newest sample that [`at`](Self::at) this time looks at: the first that is not before it, else the last.
    pub fn until(&self, stamp_ns: i64) -> Option<i64> {
        let after = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        self.samples.get(after).map(|(stamp, _)| *stamp).or(self.newest_ns())
    }

    /// The value at a time: interpolated, or the nearest sample's outside of what is known.
    pub fn at(&self, stamp_ns: i64) -> Option<Sample<T>> {
        let after = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        let held =
            |(stamp, value): (i64, T)| Sample { value, age_ns: stamp.abs_diff(stamp_ns).min(i64::MAX as u64) as i64 };
        let later = self.samples.get(after).copied();
        let earlier = after.checked_sub(1).and_then(|before| self.samples.get(before)).copied();
        match (earlier, later) {
            (Some((t0, a)), Some((t1, b))) if t1 - t0 <= BRIDGE_NS => {
                let fraction = (stamp_ns - t0) as f64 / (t1 - t0) as f64;
                Some(Sample { value: a.interpolate(&b, fraction), age_ns: 0 })
            }
            (Some(earlier), Some(later)) => {
                Some(held(if stamp_ns - earlier.0 <= later.0 - stamp_ns { earlier } else { later }))
            }
            (earlier, later) => earlier.or(later).map(held),
        }
    }
}

impl Interpolate for Pose2 {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Self {
            x: self.x + (other.x - self.x) * fraction,
            y: self.y + (other.y - self.y) * fraction,
            yaw: wrap_angle(self.yaw + wrap_angle(other.yaw - self.yaw) * fraction),
        }
    }

    fn is_finite(&self) -> bool {
        Pose2::is_finite(self)
    }
}

impl Interpolate for Isometry {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Isometry::interpolate(self, other, fraction)
    }

    fn is_finite(&self) -> bool {
        Isometry::is_finite(self)
    }
}

impl Interpolate for DQuat {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        let turn = |rotation| Isometry::new(rotation, glam::DVec3::ZERO);
        turn(*self).interpolate(&turn(*other), fraction).rotation
    }

    /// A quaternion without a direction is no attitude either.
    fn is_finite(&self) -> bool {
        DQuat::is_finite(*self) && self.length_squared() > 1e-12
    }
}

impl Interpolate for f64 {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        self + (other - self) * fraction
    }

    fn is_finite(&self) -> bool {
        f64::is_finite(*self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_between_samples_and_holds_outside() {
        let mut history = History::default();
        assert_eq!(history.at(5), None::<Sample<f64>>);
        history.push(100, 1.0);
        history.push(200, 3.0);
        assert_eq!(history.at(150), Some(Sample { value: 2.0, age_ns: 0 }));
        assert_eq!(history.at(250), Some(Sample { value: 3.0, age_ns: 50 }));
        assert_eq!(history.at(40), Some(Sample { value: 1.0, age_ns: 60 }));
        assert_eq!([40, 100, 150, 250].map(|stamp| history.until(stamp)), [100, 100, 200, 200].map(Some));
    }

    #[test]
    fn a_gap_is_not_bridged() {
        let mut history = History::default();
        history.push(0, 0.0);
        history.push(3_600_000_000_000, 1.0);
        assert_eq!(history.at(3_599_000_000_000).map(|s| s.value), Some(1.0));
        history.push(3_600_500_000_000, 2.0);
        history.push(3_602_000_000_000, 3.0);
        assert_eq!(history.at(3_600_600_000_000).map(|s| (s.value, s.age_ns)), Some((2.0, 100_000_000)));
    }

    #[test]
    fn equal_earlier_and_broken_samples_are_refused() {
        let mut history = History::default();
        for (stamp, value) in [(100, 1.0), (100, 2.0), (90, 3.0), (110, f64::NAN)] {
            history.push(stamp, value);
        }
        assert_eq!((history.refused(), history.newest_ns()), (3, Some(100)));
    }

    #[test]
    fn a_clock_set_back_starts_over() {
        let mut history = History::default();
        history.push(10_000_000_000, 1.0);
        history.push(0, 2.0);
        assert_eq!(history.at(0), Some(Sample { value: 2.0, age_ns: 0 }));
    }

    #[test]
    fn memory_is_bounded() {
        let mut history = History::default();
        for stamp in 0..100_000 {
            history.push(stamp * 1000, 0.0);
        }
        assert!(history.samples.len() <= KEEP_SAMPLES);
        history.push(i64::MAX, 0.0);
        assert!(history.samples.len() <= 2);
    }

    #[test]
    fn angles_take_the_short_way() {
        let between = Pose2::new(0.0, 0.0, 3.1).interpolate(&Pose2::new(0.0, 0.0, -3.1), 0.5);
        assert!((between.yaw.abs() - core::f64::consts::PI).abs() < 1e-9);
        let a = DQuat::from_rotation_x(0.2);
        assert!(a.interpolate(&-a, 0.5).abs_diff_eq(a, 1e-12), "q and -q are the same rotation");
    }
}
