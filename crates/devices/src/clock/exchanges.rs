//! Estimates a clock's offset from questions and answers.
//!
//! An answer is written between question and receipt, which bounds the offset: received - device >= offset >= sent - device.
//! The middle of the bounds is wrong by at most half the round trip, so quick exchanges have the largest weights.

use std::collections::VecDeque;

use super::{Line, MAX_DRIFT};

/// Recent exchanges, and the line that they give.
#[derive(Clone, Debug, Default)]
pub(super) struct Exchanges {
    recent: VecDeque<Exchange>,
    line: Option<Line>,
    /// Number of exchanges in a row that the line cannot explain.
    contradictions: u32,
    /// Number of exchanges that were ever used.
    total: u64,
}

/// One question with its answer.
#[derive(Clone, Copy, Debug)]
struct Exchange {
    device_ns: i64,
    /// Middle of the bounds of host time minus device time.
    offset_ns: i64,
    round_trip_ns: i64,
}

/// Largest number of exchanges kept: half a minute at a few a second.
const MAX_EXCHANGES: usize = 120;
/// Span of device time that exchanges are kept for, nanoseconds. The drift of a warming board is not constant for longer.
const MEMORY_NS: i64 = 60_000_000_000;
/// Longest round trip of an exchange that is kept, nanoseconds: a slower answer says too little.
const MAX_ROUND_TRIP_NS: i64 = 200_000_000;
/// Smallest number of exchanges that give a line. With fewer, arrivals are used.
const MIN_EXCHANGES: usize = 3;
/// Number of exchanges in a row, unexplained by the line, that show that the device's clock was set.
const CONTRADICTIONS_FOR_RESTART: u32 = 3;
/// Standard deviation of what scheduling on either side adds to the quickest exchange, nanoseconds.
const SLACK_NS: f64 = 50_000.0;
/// Time without an answer after which arrivals are used instead, nanoseconds.
const SILENT_NS: i64 = 30_000_000_000;

impl Exchanges {
    /// Takes an exchange. Returns false if this and those before it show that the clock has been set.
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
            if self.contradictions >= CONTRADICTIONS_FOR_RESTART {
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
        self.line = (self.recent.len() >= MIN_EXCHANGES).then(|| fit(&self.recent)).flatten();
        true
    }

    /// Returns the line; `None` with too few exchanges, or if the last one is long ago.
    pub fn line(&self, now_device_ns: i64) -> Option<Line> {
        let last = self.recent.back()?;
        self.line.filter(|_| now_device_ns.saturating_sub(last.device_ns) < SILENT_NS)
    }

    /// Returns the number of exchanges that were ever used.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Forgets all but the total.
    pub fn forget(&mut self) {
        *self = Self { total: self.total, ..Self::default() };
    }
}

/// Fits a line by weighted least squares, with a prior that the drift is 0.
fn fit(recent: &VecDeque<Exchange>) -> Option<Line> {
    let last = *recent.back()?;
    let quickest = recent.iter().map(|exchange| exchange.round_trip_ns).min()? as f64;
    let (mut w, mut wx, mut wy, mut wxx, mut wxy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for exchange in recent {
        // The time by which an exchange took longer than the quickest may all have been spent on one way.
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
    // Prior of the drift: 0, with a standard deviation of a third of the largest drift.
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
        // It cannot be known how the quickest round trip is divided between there and back.
        uncertainty_ns: quickest / 2.0 + 3.0 * sigma,
        drift_uncertainty: 3.0 * drift_sigma,
    })
}
