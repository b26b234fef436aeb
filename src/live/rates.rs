//! Rates, computing time and validity of the running recorder's frames.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::recording::Counts;
use crate::ros2::messages::FrameTag;
use crate::tagging::durations::Durations;

/// Rates over the last second, from the session's counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Rates {
    pub captured_hz: f64,
    pub written_hz: f64,
    pub tagged_hz: f64,
}

/// Time from the decoded image to the tag, milliseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BudgetUse {
    /// Configured budget; 0 without one.
    pub budget_ms: f64,
    pub p50_ms: f64,
    pub p99_ms: f64,
    pub max_ms: f64,
}

/// Valid tags among the last `RECENT_FRAMES` frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Validity {
    pub frames: usize,
    pub valid: usize,
}

/// Effort of the particle filter over the same frames as [`Validity`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FilterUse {
    /// Mean number of particles.
    pub particles: f64,
    /// Share of the frames whose time budget ended before the filter was done.
    pub capped: f64,
    /// Standard deviation of the particles' positions at the last frame, metres.
    pub spread_m: f64,
}

#[derive(Clone, Copy, Debug)]
struct RecentTag {
    valid: bool,
    capped: bool,
    particles: u32,
    spread_m: f64,
}

/// Accumulates what the status shows of rates, time and validity.
#[derive(Debug, Default)]
pub struct Meters {
    last_counts: Option<(i64, Counts)>,
    rates: Rates,
    durations: Durations,
    recent: VecDeque<RecentTag>,
}

/// Frames that shares and means are taken over.
const RECENT_FRAMES: usize = 100;

impl Meters {
    /// Takes a frame's tag.
    pub fn note_tag(&mut self, tag: &FrameTag) {
        self.durations.note(tag.elapsed_ms);
        let FrameTag { valid, capped, particles, spread_m, .. } = *tag;
        self.recent.push_back(RecentTag { valid, capped, particles, spread_m });
        if self.recent.len() > RECENT_FRAMES {
            self.recent.pop_front();
        }
    }

    /// Takes the session's counts, once a second.
    pub fn update_rates(&mut self, now_ns: i64, counts: &Counts) {
        if let Some((then_ns, then)) = &self.last_counts {
            let seconds = now_ns.saturating_sub(*then_ns) as f64 * 1e-9;
            let rate =
                |now: u64, then: u64| if seconds > 0.0 { now.saturating_sub(then) as f64 / seconds } else { 0.0 };
            self.rates = Rates {
                captured_hz: rate(counts.captured, then.captured),
                written_hz: rate(counts.written, then.written),
                tagged_hz: rate(counts.tagged, then.tagged),
            };
        }
        self.last_counts = Some((now_ns, counts.clone()));
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
    fn rates_cover_a_second_and_validity_a_hundred_frames() {
        let mut meters = Meters::default();
        let counts = |captured, written, tagged| Counts { captured, written, tagged, ..Counts::default() };
        meters.update_rates(0, &counts(100, 90, 80));
        meters.update_rates(2_000_000_000, &counts(160, 120, 100));
        assert_eq!(meters.rates(), Rates { captured_hz: 30.0, written_hz: 15.0, tagged_hz: 10.0 });
        // Another session counts from zero.
        meters.update_rates(3_000_000_000, &counts(10, 5, 0));
        assert_eq!(meters.rates(), Rates::default());
        for number in 0..150 {
            let (valid, particles, spread_m) = (number >= 100, 100 + number % 2, 0.01 * f64::from(number));
            let capped = number % 4 == 0;
            meters.note_tag(&FrameTag { valid, capped, particles, spread_m, elapsed_ms: 7.0, ..FrameTag::default() });
        }
        assert_eq!(meters.filter(), FilterUse { particles: 100.5, capped: 0.25, spread_m: 1.49 });
        assert_eq!(meters.validity(), Validity { frames: 100, valid: 50 });
        let budget = meters.budget(20.0);
        assert!((budget.p99_ms - 7.0).abs() < 0.1 && budget.budget_ms == 20.0 && budget.max_ms == 7.0, "{budget:?}");
    }
}
