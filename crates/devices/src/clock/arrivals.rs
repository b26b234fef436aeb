//! Estimates a clock's offset from the arrival times of messages alone.
//!
//! A message never arrives before it was sent, so host time minus device time at arrival is the offset plus a delay, never
//! less. The offset is therefore the line that lies below all of these points and nearest to them: an edge of their lower
//! convex hull, the one over the middle of the times (S. B. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew
//! from network delay measurements", INFOCOM 1999). A delay that all messages share cannot be told from an offset.

use std::collections::VecDeque;

use super::{Line, MAX_DRIFT};

/// Recent arrivals, and the line that they give.
#[derive(Clone, Debug, Default)]
pub(super) struct Arrivals {
    /// The quickest arrival of each stretch of time, by device time.
    points: VecDeque<Point>,
    line: Option<Line>,
    /// Resolution of the coarsest stamps. Their rounding error can stay the same for long and then looks like an offset.
    resolution_ns: i64,
    /// Late arrivals in a row at the end, if there are any.
    late: Option<Late>,
}

/// Arrivals in a row that are too late for the line.
#[derive(Clone, Copy, Debug)]
struct Late {
    /// Host time of the arrival since which they do not catch up.
    host_ns: i64,
    /// How late that arrival was.
    by_ns: i64,
    /// Number of arrivals from it on.
    count: u32,
}

/// One arrival.
#[derive(Clone, Copy, Debug)]
struct Point {
    device_ns: i64,
    /// Host time minus device time: offset plus delay.
    apparent_ns: i64,
}

/// Length of the stretches of time of each of which one point is kept, nanoseconds.
const STRETCH_NS: i64 = 250_000_000;
/// Span of device time that points are kept for, nanoseconds.
const MEMORY_NS: i64 = 60_000_000_000;
/// Largest number of points kept: one for each stretch of the memory.
const MAX_POINTS: usize = 241;
/// Shortest span of time from which a drift is estimated, nanoseconds.
const SLOPE_FROM_NS: i64 = 5_000_000_000;
/// A message that is too early or too late by more than this, nanoseconds, is of a clock that was set.
const SET_NS: i64 = 1_000_000_000;
/// Number of late messages in a row, without catching up, that show that the clock was set.
///
/// Messages can also be late because the line or the recorder stood still; those catch up.
const LATE_FOR_RESTART: u32 = 20;
/// The least time that these must span, nanoseconds.
const LATE_FOR_RESTART_NS: i64 = 1_000_000_000;
/// A message that is less late by at least this, nanoseconds, catches up; less may be chance.
const CATCHES_UP_NS: i64 = 50_000_000;
/// Time for which even the quickest message may have waited for the host's scheduler, nanoseconds.
const SLACK_NS: f64 = 200_000.0;

impl Late {
    /// Adds an arrival that is late by `by_ns`, or begins anew with it if it has caught up.
    fn after(before: Option<Self>, host_ns: i64, by_ns: i64) -> Self {
        match before {
            Some(late) if by_ns > late.by_ns.saturating_sub(CATCHES_UP_NS) => Self { count: late.count + 1, ..late },
            _ => Self { host_ns, by_ns, count: 1 },
        }
    }

    /// Returns whether the clock must have been set.
    fn is_of_another_clock(&self, host_ns: i64) -> bool {
        self.count >= LATE_FOR_RESTART && host_ns.saturating_sub(self.host_ns) >= LATE_FOR_RESTART_NS
    }
}

impl Arrivals {
    /// Takes an arrival. Returns false if the clock has been set, so that nothing known before holds.
    pub fn push(&mut self, device_ns: i64, resolution_ns: i64, host_ns: i64) -> bool {
        self.resolution_ns = self.resolution_ns.max(resolution_ns);
        let apparent_ns = host_ns.saturating_sub(device_ns);
        if let Some(line) = &self.line {
            let above = apparent_ns.saturating_sub(line.at(device_ns).offset_ns);
            if above < -SET_NS {
                return false;
            }
            self.late = (above > SET_NS).then(|| Late::after(self.late, host_ns, above));
            if self.late.is_some_and(|late| late.is_of_another_clock(host_ns)) {
                return false;
            }
        }
        let point = Point { device_ns, apparent_ns };
        match self.points.back_mut() {
            Some(last) if device_ns.div_euclid(STRETCH_NS) <= last.device_ns.div_euclid(STRETCH_NS) => {
                if apparent_ns >= last.apparent_ns {
                    return true;
                }
                // The point keeps its position in the order of times.
                let device_ns = last.device_ns.max(device_ns);
                *last = Point { device_ns, apparent_ns };
            }
            _ => self.points.push_back(point),
        }
        let oldest = device_ns.saturating_sub(MEMORY_NS);
        while self.points.len() > MAX_POINTS || self.points.front().is_some_and(|first| first.device_ns < oldest) {
            self.points.pop_front();
        }
        self.line = fit(&self.points, self.resolution_ns);
        true
    }

    /// Returns the line; `None` before the first arrival.
    pub fn line(&self) -> Option<Line> {
        self.line
    }
}

/// Fits a line below the points.
fn fit(points: &VecDeque<Point>, resolution_ns: i64) -> Option<Line> {
    let (first, last) = (points.front()?, points.back()?);
    let x = |point: &Point| point.device_ns.saturating_sub(last.device_ns) as f64;
    let y = |point: &Point| point.apparent_ns.saturating_sub(last.apparent_ns) as f64;
    let span_ns = last.device_ns.saturating_sub(first.device_ns);
    let drift = if span_ns < SLOPE_FROM_NS { 0.0 } else { slope_of_middle_edge(points, x, y) };
    // The line lies below all points, even if its slope was limited.
    let offset = points.iter().map(|point| y(point) - drift * x(point)).fold(f64::INFINITY, f64::min);
    let mut delays: Vec<f64> = points.iter().map(|point| y(point) - drift * x(point) - offset).collect();
    delays.sort_by(f64::total_cmp);
    let typical = delays[delays.len() / 2];
    Some(Line {
        at_device_ns: last.device_ns,
        offset_ns: last.apparent_ns as f64 + offset,
        drift,
        // If the quickest arrivals of the stretches differ by this much, the quickest of all may have waited for as long.
        uncertainty_ns: typical + resolution_ns as f64 + SLACK_NS,
        drift_uncertainty: if span_ns < SLOPE_FROM_NS {
            MAX_DRIFT
        } else {
            typical.max(100_000.0) / span_ns as f64 * 2.0
        },
    })
}

/// Returns the slope of the lower hull's edge over the middle of the times.
fn slope_of_middle_edge(points: &VecDeque<Point>, x: impl Fn(&Point) -> f64, y: impl Fn(&Point) -> f64) -> f64 {
    let mut hull: Vec<(f64, f64)> = Vec::with_capacity(points.len());
    for point in points {
        let next = (x(point), y(point));
        while let [.., a, b] = hull[..] {
            let turns_left = (b.0 - a.0) * (next.1 - a.1) - (b.1 - a.1) * (next.0 - a.0) > 0.0;
            if turns_left {
                break;
            }
            hull.pop();
        }
        hull.push(next);
    }
    let middle = points.iter().map(&x).sum::<f64>() / points.len() as f64;
    let edge = hull.windows(2).find(|edge| edge[1].0 >= middle);
    let slope = edge.map_or(0.0, |edge| (edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0));
    if slope.is_finite() { slope.clamp(-MAX_DRIFT, MAX_DRIFT) } else { 0.0 }
}
