//! The offset from questions and answers.
//!
//! An answer that was written between question and receipt bounds the offset hard: received - device >= offset >= sent -
//! device. Its middle is off by at most half the round trip, and quick ones are hardly off at all, so they count most.

use std::collections::VecDeque;

use super::{Line, MAX_DRIFT};

#[derive(Clone, Debug, Default)]
pub(super) struct Exchanges {
    recent: VecDeque<Exchange>,
    line: Option<Line>,
    /// In a row, exchanges that the line cannot explain.
    contradictions: u32,
    total: u64,
}

#[derive(Clone, Copy, Debug)]
struct Exchange {
    device_ns: i64,
    /// Middle of the bounds.
    offset_ns: i64,
    round_trip_ns: i64,
}

/// Memory in exchanges, at a few a second half a minute.
const MAX_EXCHANGES: usize = 120;
/// Memory in time: over longer the drift of a warming board is no straight line.
const MEMORY_NS: i64 = 60_000_000_000;
/// An answer that took longer says too little to be kept.
const MAX_ROUND_TRIP_NS: i64 = 200_000_000;
/// Before this many the offset is that of the arrivals.
const ENOUGH: usize = 3;
/// This many in a row that cannot be true mean that the device's clock was set.
const CONTRADICTIONS: u32 = 3;
/// What scheduling on either side adds to the quickest exchange, standard deviation.
const SLACK_NS: f64 = 50_000.0;
/// Without an answer for so long the arrivals know better.
const SILENT_NS: i64 = 30_000_000_000;

impl Exchanges {
    /// False if this and those before it show that the clock has been set: nothing of before holds.
    pub fn push(&mut self, sent_ns: i64, device_ns: i64, received_ns: i64) -> bool {
        let round_trip_ns = received_ns.saturating_sub(sent_ns);
        if !(0..=MAX_ROUND_TRIP_NS).contains(&round_trip_ns) {
            return true;
        }
        let Some(offset_ns) = sent_ns.checked_add(round_trip_ns / 2).and_then(|middle| middle.checked_sub(device_ns))
        else {
            return true;
        };
        if let Some(line) = &self.line {
            let predicted = line.at(device_ns);
            let off = offset_ns.saturating_sub(predicted.offset_ns).saturating_abs();
            let explained =
                off <= (round_trip_ns / 2).saturating_add(predicted.uncertainty_ns).saturating_add(1_000_000);
            self.contradictions = if explained { 0 } else { self.contradictions + 1 };
            if self.contradictions >= CONTRADICTIONS {
                return false;
            }
            if !explained {
                return true;
            }
        }
        self.total += 1;
        self.recent.push_back(Exchange { device_ns, offset_ns, round_trip_ns });
        let oldest = device_ns.saturating_sub(MEMORY_NS);
        while self.recent.len() > MAX_EXCHANGES || self.recent.front().is_some_and(|first| first.device_ns < oldest) {
            self.recent.pop_front();
        }
        self.line = (self.recent.len() >= ENOUGH).then(|| fit(&self.recent)).flatten();
        true
    }

    pub fn line(&self, now_device_ns: i64) -> Option<Line> {
        let last = self.recent.back()?;
        self.line.filter(|_| now_device_ns.saturating_sub(last.device_ns) < SILENT_NS)
    }

    pub fn total(&self) -> u64 {
        self.total
    }

    pub fn forget(&mut self) {
        *self = Self { total: self.total, ..Self::default() };
    }
}

/// Weighted least squares with a drift that is 0 unless the data say otherwise.
fn fit(recent: &VecDeque<Exchange>) -> Option<Line> {
    let last = *recent.back()?;
    let quickest = recent.iter().map(|exchange| exchange.round_trip_ns).min()? as f64;
    let (mut w, mut wx, mut wy, mut wxx, mut wxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for exchange in recent {
        // What an exchange took longer than the quickest may all have been on one way.
        let sigma = SLACK_NS + (exchange.round_trip_ns as f64 - quickest) / 2.0;
        let weight = 1.0 / (sigma * sigma);
        let x = exchange.device_ns.saturating_sub(last.device_ns) as f64;
        let y = exchange.offset_ns.saturating_sub(last.offset_ns) as f64;
        w += weight;
        wx += weight * x;
        wy += weight * y;
        wxx += weight * x * x;
        wxy += weight * x * y;
    }
    // The drift before anything is known: 0, standard deviation a third of the largest.
    let prior = 9.0 / (MAX_DRIFT * MAX_DRIFT);
    let determinant = w * (wxx + prior) - wx * wx;
    let drift = ((w * wxy - wx * wy) / determinant).clamp(-MAX_DRIFT, MAX_DRIFT);
    let offset = (wy - drift * wx) / w;
    let sigma = libm::sqrt((wxx + prior) / determinant);
    let drift_sigma = libm::sqrt(w / determinant);
    Some(Line {
        at_device_ns: last.device_ns,
        offset_ns: last.offset_ns as f64 + offset,
        drift,
        // Nothing can tell how the quickest way is shared between there and back.
        uncertainty_ns: quickest / 2.0 + 3.0 * sigma,
        drift_uncertainty: 3.0 * drift_sigma,
    })
}
