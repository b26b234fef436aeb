//! Stores the recent past of one measurement, and interpolates it at any time.

use std::collections::VecDeque;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use realitysim_geometry::{Isometry, Physical, Pose2, wrap_angle};

/// A value that can be interpolated between two samples.
pub trait Interpolate: Copy + Physical {
    /// Returns the value at `fraction` of the way from `self` (0) to `other` (1).
    fn interpolate(&self, other: &Self, fraction: f64) -> Self;
}

/// Recent samples of a measurement in the order of their stamps, whatever the order in which they came.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct History<T> {
    /// Stamp in nanoseconds, and value.
    samples: VecDeque<(i64, T)>,
    /// The farthest that a sample has come behind the newest, nanoseconds.
    disorder_ns: i64,
    /// A sample from long before the newest. It is too late unless the next one shows that the clock was set back.
    stray: Option<(i64, T)>,
}

/// Span of time that samples are kept for, nanoseconds: no frame waits this long.
pub const KEEP_NS: i64 = 5_000_000_000;
/// Largest number of samples kept, whatever their rate: five seconds at 4 kHz.
const KEEP_SAMPLES: usize = 20_000;
/// A sample that is older than the newest by at most this, nanoseconds, is sorted in. Two older ones in a row mean that
/// the clock was set back, and all samples before them are dropped.
const RESET_NS: i64 = 1_000_000_000;
/// Largest distance of two samples that are interpolated, nanoseconds. Beyond it the nearer one is taken.
const BRIDGE_NS: i64 = 500_000_000;

/// Longest gap between samples that a rate is integrated over, nanoseconds.
const GAP_NS: i64 = 100_000_000;

/// What became of a sample that was pushed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pushed {
    /// It is stored.
    Taken,
    /// A sample of the same time is stored already; this one is dropped.
    Known,
    /// No robot can have measured it: see [`Physical`].
    Impossible,
    /// It is more than a second older than the newest; it is dropped.
    TooLate,
    /// The clock was set back. This sample and the one before, which seemed too late, are the new beginning.
    ClockSetBack,
}

/// A value at a time that was asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T> {
    /// The value, interpolated or that of the nearest sample.
    pub value: T,
    /// Distance in time of the sample that was taken, nanoseconds; 0 if the value is interpolated.
    pub age_ns: i64,
}

impl<T> Default for History<T> {
    fn default() -> Self {
        Self { samples: VecDeque::new(), disorder_ns: 0, stray: None }
    }
}

impl<T: Physical> Physical for History<T> {
    fn is_possible(&self) -> bool {
        self.samples.iter().chain(&self.stray).all(|(_, value)| value.is_possible())
    }
}

impl<T: Interpolate> History<T> {
    /// Stores a sample, unless it is impossible or too late, and forgets old ones.
    pub fn push(&mut self, stamp_ns: i64, value: T) -> Pushed {
        if !value.is_possible() {
            return Pushed::Impossible;
        }
        let stray = self.stray.take();
        let newest = self.newest_ns().unwrap_or(i64::MIN);
        if stamp_ns > newest {
            self.samples.push_back((stamp_ns, value));
            self.forget_old();
            return Pushed::Taken;
        }
        if stamp_ns >= newest.saturating_sub(RESET_NS) {
            return self.insert_sorted(stamp_ns, value);
        }
        match stray {
            Some(stray) if stamp_ns > stray.0 && stamp_ns - stray.0 <= RESET_NS => {
                *self = Self { samples: [stray, (stamp_ns, value)].into(), ..Self::default() };
                Pushed::ClockSetBack
            }
            _ => {
                self.stray = Some((stamp_ns, value));
                Pushed::TooLate
            }
        }
    }

    fn insert_sorted(&mut self, stamp_ns: i64, value: T) -> Pushed {
        let place = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        if self.samples.get(place).is_some_and(|(stamp, _)| *stamp == stamp_ns) {
            return Pushed::Known;
        }
        self.disorder_ns = self.newest_ns().map_or(0, |newest| self.disorder_ns.max(newest - stamp_ns));
        self.samples.insert(place, (stamp_ns, value));
        self.forget_old();
        Pushed::Taken
    }

    /// Drops samples beyond the span and number that are kept.
    fn forget_old(&mut self) {
        let oldest_kept = self.newest_ns().map_or(i64::MIN, |newest| newest.saturating_sub(KEEP_NS));
        // The last sample before the span stays: a frame just inside the span needs both neighbours.
        while self.samples.len() > KEEP_SAMPLES || self.samples.get(1).is_some_and(|(stamp, _)| *stamp < oldest_kept) {
            self.samples.pop_front();
        }
    }

    /// Returns the time up to which nothing is missing, if samples come no later than they have come so far, nanoseconds.
    pub fn settled_ns(&self) -> Option<i64> {
        self.newest_ns().map(|newest| newest - self.disorder_ns)
    }

    fn newest_ns(&self) -> Option<i64> {
        self.newest().map(|(stamp, _)| stamp)
    }

    /// Returns the newest sample with its stamp.
    pub fn newest(&self) -> Option<(i64, T)> {
        self.samples.back().copied()
    }

    /// Returns whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// Returns the stamp of the newest sample that [`at`](Self::at) uses: the first one not before the time, else the last.
    pub fn until(&self, stamp_ns: i64) -> Option<i64> {
        let after = self.samples.partition_point(|(stamp, _)| *stamp < stamp_ns);
        self.samples.get(after).map(|(stamp, _)| *stamp).or(self.newest_ns())
    }

    /// Returns the value at a time: interpolated, or that of the nearest sample outside of the known span and in gaps.
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

impl History<f64> {
    /// Integrates a rate over a span of time by the trapezoidal rule; the result is in its unit times seconds.
    ///
    /// `None` where the span is not covered, where samples lie farther apart than 0.1 s, or where every sample is exactly
    /// zero, which means that no sensor measures it.
    pub fn integral(&self, from_ns: i64, to_ns: i64) -> Option<f64> {
        if to_ns < from_ns {
            return None;
        }
        let first = self.samples.partition_point(|(stamp, _)| *stamp <= from_ns).checked_sub(1)?;
        let (mut sum, mut measured, mut reached) = (0.0, false, from_ns);
        for ((t0, a), (t1, b)) in self.samples.range(first..).zip(self.samples.range(first + 1..)) {
            if t1 - t0 > GAP_NS {
                return None;
            }
            let until = (*t1).min(to_ns);
            let middle = ((reached - t0) + (until - t0)) as f64 / (2 * (t1 - t0)) as f64;
            sum += a.interpolate(b, middle) * (until - reached) as f64 * 1e-9;
            measured |= *a != 0.0 || *b != 0.0;
            reached = until;
            if reached == to_ns {
                return measured.then_some(sum);
            }
        }
        None
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
}

impl Interpolate for Isometry {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        Isometry::interpolate(self, other, fraction)
    }
}

impl Interpolate for DQuat {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        let turn = |rotation| Isometry::new(rotation, glam::DVec3::ZERO);
        turn(*self).interpolate(&turn(*other), fraction).rotation
    }
}

impl Interpolate for DVec3 {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        self.lerp(*other, fraction)
    }
}

impl Interpolate for f64 {
    fn interpolate(&self, other: &Self, fraction: f64) -> Self {
        self + (other - self) * fraction
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_integrated_between_any_two_times() {
        // A rate that falls linearly: the trapezoids are exact.
        let mut rates = History::default();
        let rate = |t: f64| 3.0 - 4.0 * t;
        for t in (0..=50).rev() {
            rates.push(t * 10_000_000, rate(t as f64 * 0.01));
        }
        let exact = |t: f64| 3.0 * t - 2.0 * t * t;
        for (from, to) in [(0.0, 0.5), (0.013, 0.4999), (0.2, 0.2031), (0.111, 0.112)] {
            let found = rates.integral((from * 1e9) as i64, (to * 1e9) as i64).expect("known");
            assert!((found - (exact(to) - exact(from))).abs() < 1e-12, "{from} to {to}");
        }
        assert_eq!(rates.integral(400_000_000, 510_000_000), None, "not known yet");
        assert_eq!(rates.integral(-1, 100_000_000), None, "not known any more");
        rates.push(700_000_000, 1.0);
        assert_eq!(rates.integral(450_000_000, 650_000_000), None, "a gap");
    }

    #[test]
    fn a_sensor_that_only_ever_says_zero_measures_nothing() {
        let mut rates = History::default();
        (0..10).for_each(|t| assert_eq!(rates.push(t * 10_000_000, 0.0), Pushed::Taken));
        assert_eq!(rates.integral(5_000_000, 80_000_000), None);
    }

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
    fn samples_are_sorted_in_whatever_their_order() {
        let mut history = History::default();
        let pushed = [(0, 0.0), (200, 2.0), (100, 5.0), (100, 7.0), (300, f64::NAN), (50, 1.0)]
            .map(|(stamp, value)| history.push(stamp, value));
        let expected = [Pushed::Taken, Pushed::Taken, Pushed::Taken, Pushed::Known, Pushed::Impossible, Pushed::Taken];
        assert_eq!(pushed, expected);
        assert_eq!([25, 50, 75, 150].map(|stamp| history.at(stamp).unwrap().value), [0.5, 1.0, 3.0, 3.5]);
    }

    #[test]
    fn what_may_still_come_late_is_waited_for() {
        let mut history = History::default();
        assert_eq!(history.settled_ns(), None);
        for (stamp, settled) in [(100, 100), (200, 200), (170, 170), (300, 270), (290, 270), (500, 470)] {
            history.push(stamp, 0.0);
            assert_eq!(history.settled_ns(), Some(settled), "after {stamp}");
        }
    }

    #[test]
    fn one_sample_from_long_ago_is_too_late_and_forgets_nothing() {
        let mut history = History::default();
        for stamp in [5_000, 5_010, 5_020] {
            history.push(stamp * 1_000_000, 1.0);
        }
        let known = history.clone();
        // Each one stands alone between others: a second sender has a wrong clock.
        for stamp in [0, 5_030, 10, 5_040] {
            let pushed = history.push(stamp * 1_000_000, 2.0);
            assert_eq!(pushed, if stamp < 5_000 { Pushed::TooLate } else { Pushed::Taken }, "{stamp}");
        }
        assert_eq!(history.at(5_015_000_000), known.at(5_015_000_000));
        // Two in a row that are not of one clock.
        assert_eq!([900, 30].map(|ms| history.push(ms * 1_000_000, 2.0)), [Pushed::TooLate; 2]);
    }

    #[test]
    fn a_clock_set_back_starts_over() {
        let mut history = History::default();
        history.push(10_000_000_000, 1.0);
        assert_eq!(history.push(0, 2.0), Pushed::TooLate);
        assert_eq!(history.push(10, 3.0), Pushed::ClockSetBack);
        assert_eq!(history.at(5), Some(Sample { value: 2.5, age_ns: 0 }));
        assert_eq!(history.settled_ns(), Some(10));
    }

    #[test]
    fn memory_is_bounded() {
        let mut history = History::default();
        for stamp in 0..100_000 {
            history.push(stamp * 1000, 0.0);
        }
        assert!(history.samples.len() <= KEEP_SAMPLES);
        for stamp in (0..100_000).rev() {
            history.push(99_000_000 + stamp, 0.0);
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
