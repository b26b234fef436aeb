//! What a running agent does in a second, and how well: rates, time used, how many tags are valid.

use std::collections::VecDeque;

use serde::Serialize;

use crate::recording::Counts;
use crate::ros2::messages::FrameTag;
use crate::tagging::durations::Durations;

/// A second, by the counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Rates {
    pub captured_hz: f64,
    pub written_hz: f64,
    pub tagged_hz: f64,
}

/// Milliseconds from the decoded image to the tag.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct BudgetUse {
    /// As configured; 0: none.
    pub budget_ms: f64,
    pub p50_ms: f64,
    pub p99_ms: f64,
    pub max_ms: f64,
}

/// Of the last frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Validity {
    pub frames: usize,
    pub valid: usize,
}

/// Of the last frames, as [`Validity`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct FilterUse {
    /// On average.
    pub particles: f64,
    /// Share of the frames for which time was up before the filter was done.
    pub capped: f64,
    /// Of the particles of the last frame: standard deviation of their place.
    pub spread_m: f64,
}

#[derive(Clone, Copy, Debug)]
struct Recent {
    valid: bool,
    capped: bool,
    particles: u32,
    spread_m: f64,
}

#[derive(Debug, Default)]
pub struct Meters {
    read: Option<(i64, Counts)>,
    rates: Rates,
    durations: Durations,
    recent: VecDeque<Recent>,
}

/// Frames that shares and means are of.
const RECENT: usize = 100;

impl Meters {
    pub fn tagged(&mut self, tag: &FrameTag) {
        self.durations.note(tag.elapsed_ms);
        let FrameTag { valid, capped, particles, spread_m, .. } = *tag;
        self.recent.push_back(Recent { valid, capped, particles, spread_m });
        if self.recent.len() > RECENT {
            self.recent.pop_front();
        }
    }

    /// Once a second.
    pub fn counted(&mut self, now_ns: i64, counts: &Counts) {
        if let Some((then_ns, then)) = &self.read {
            let seconds = now_ns.saturating_sub(*then_ns) as f64 * 1e-9;
            let rate =
                |now: u64, then: u64| if seconds > 0.0 { now.saturating_sub(then) as f64 / seconds } else { 0.0 };
            self.rates = Rates {
                captured_hz: rate(counts.captured, then.captured),
                written_hz: rate(counts.written, then.written),
                tagged_hz: rate(counts.tagged, then.tagged),
            };
        }
        self.read = Some((now_ns, counts.clone()));
    }

    pub fn rates(&self) -> Rates {
        self.rates
    }

    pub fn budget(&self, budget_ms: f64) -> BudgetUse {
        let times = self.durations.quantiles();
        BudgetUse { budget_ms, p50_ms: times.p50, p99_ms: times.p99, max_ms: times.max }
    }

    pub fn validity(&self) -> Validity {
        Validity { frames: self.recent.len(), valid: self.recent.iter().filter(|recent| recent.valid).count() }
    }

    pub fn filter(&self) -> FilterUse {
        let frames = self.recent.len().max(1) as f64;
        FilterUse {
            particles: self.recent.iter().map(|recent| u64::from(recent.particles)).sum::<u64>() as f64 / frames,
            capped: self.recent.iter().filter(|recent| recent.capped).count() as f64 / frames,
            spread_m: self.recent.back().map_or(0.0, |recent| recent.spread_m),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_of_the_last_second_and_validity_of_the_last_hundred_frames() {
        let mut meters = Meters::default();
        let counts = |captured, written, tagged| Counts { captured, written, tagged, ..Counts::default() };
        meters.counted(0, &counts(100, 90, 80));
        meters.counted(2_000_000_000, &counts(160, 120, 100));
        assert_eq!(meters.rates(), Rates { captured_hz: 30.0, written_hz: 15.0, tagged_hz: 10.0 });
        // Another session counts from zero.
        meters.counted(3_000_000_000, &counts(10, 5, 0));
        assert_eq!(meters.rates(), Rates::default());
        for number in 0..150 {
            let (valid, particles, spread_m) = (number >= 100, 100 + number % 2, 0.01 * f64::from(number));
            let capped = number % 4 == 0;
            meters.tagged(&FrameTag { valid, capped, particles, spread_m, elapsed_ms: 7.0, ..FrameTag::default() });
        }
        assert_eq!(meters.filter(), FilterUse { particles: 100.5, capped: 0.25, spread_m: 1.49 });
        assert_eq!(meters.validity(), Validity { frames: 100, valid: 50 });
        let budget = meters.budget(20.0);
        assert!((budget.p99_ms - 7.0).abs() < 0.1 && budget.budget_ms == 20.0 && budget.max_ms == 7.0, "{budget:?}");
    }
}
