//! Estimates the offset between a device's clock and that of the host.
//!
//! The module is pure: the host's time is an argument. There are two sources, of which the better one is used: questions and
//! answers (TIMESYNC), and, for a device that does not answer, the times at which its messages arrive. Both follow a drift
//! of up to 300 ppm, forget old data, and begin anew when the device's clock was set or the device has restarted.

mod arrivals;
mod delay;
mod exchanges;
#[cfg(test)]
mod tests;

use serde::{Deserialize, Serialize};

pub use delay::{Delay, DelayError, Turn, estimate};

use arrivals::Arrivals;
use exchanges::Exchanges;

/// Host time minus device time as a straight line over device time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Line {
    /// The device time that the offset is given for.
    at_device_ns: i64,
    /// Host time minus device time at `at_device_ns`.
    offset_ns: f64,
    /// Change of the offset, seconds per second of device time.
    drift: f64,
    /// Largest error of the offset at `at_device_ns`, as far as that can be known.
    uncertainty_ns: f64,
    /// Largest error of `drift`, seconds per second.
    drift_uncertainty: f64,
}

impl Line {
    /// Returns the offset at a device time.
    fn at(&self, device_ns: i64) -> Offset {
        let away_ns = device_ns.saturating_sub(self.at_device_ns) as f64;
        Offset {
            offset_ns: (self.offset_ns + self.drift * away_ns) as i64,
            uncertainty_ns: (self.uncertainty_ns + self.drift_uncertainty * away_ns.abs()) as i64,
        }
    }
}

/// The offset between two clocks, and its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offset {
    /// Host time minus device time, nanoseconds.
    pub offset_ns: i64,
    /// Largest error of the offset, as far as that can be known, nanoseconds.
    pub uncertainty_ns: i64,
}

/// What an offset is estimated from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// Questions to the device and its answers.
    Timesync,
    /// Arrival times only: a delay that all messages share cannot be told from an offset.
    Arrivals,
}

impl Source {
    /// Name of the source, as in the status.
    pub fn name(self) -> &'static str {
        match self {
            Source::Timesync => "timesync",
            Source::Arrivals => "arrivals",
        }
    }
}

/// State of a device's clock, for people and logs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockStatus {
    /// What the offset is estimated from.
    pub source: Source,
    /// Host time minus device time, nanoseconds.
    pub offset_ns: i64,
    /// Largest error of the offset, as far as that can be known, nanoseconds.
    pub uncertainty_ns: i64,
    /// Change of the offset, parts per million.
    pub drift_ppm: f64,
    /// Number of times that the clock was set or its device restarted.
    pub restarts: u64,
    /// Number of answers that were used.
    pub exchanges: u64,
}

/// Estimates the offset of one clock of one device.
#[derive(Clone, Debug, Default)]
pub struct DeviceClock {
    exchanges: Exchanges,
    arrivals: Arrivals,
    newest_device_ns: Option<i64>,
    restarts: u64,
}

/// Largest drift of a device's clock against the host's. A quartz is right to 50 ppm, a bad oscillator to 100 ppm, and the
/// host's clock has an error, too.
const MAX_DRIFT: f64 = 300e-6;
/// A clock that goes back by more than this, nanoseconds, was set, or its device has restarted. Smaller steps back are normal:
/// messages of several kinds are not always sent in the order of their stamps.
const RESTART_NS: i64 = 1_000_000_000;

impl DeviceClock {
    /// Takes the arrival of a message.
    ///
    /// `device_ns` is the earliest time that its stamp can mean; the stamp may have been rounded down by `resolution_ns`.
    /// `host_ns` is the latest time at which its first byte can have left, that is, the arrival less the time on the wire.
    pub fn arrived(&mut self, device_ns: i64, resolution_ns: i64, host_ns: i64) {
        if self.newest_device_ns.is_some_and(|newest| newest.saturating_sub(device_ns) > RESTART_NS) {
            self.restart();
        }
        if !self.arrivals.push(device_ns, resolution_ns, host_ns) {
            self.restart();
            self.arrivals.push(device_ns, resolution_ns, host_ns);
        }
        self.remember_newest(device_ns);
    }

    /// Takes an answer that the device gave at `device_ns`, to a question of `sent_ns`, and that came at `received_ns`.
    ///
    /// Answers from the future, and answers that took too long, are left out.
    pub fn exchanged(&mut self, sent_ns: i64, device_ns: i64, received_ns: i64) {
        let went_back = self.newest_device_ns.is_some_and(|newest| newest.saturating_sub(device_ns) > RESTART_NS);
        if went_back {
            self.restart();
        }
        if !self.exchanges.push(sent_ns, device_ns, received_ns) {
            self.restart();
            self.exchanges.push(sent_ns, device_ns, received_ns);
        }
        self.remember_newest(device_ns);
    }

    /// Returns the best estimate of the offset; `None` before anything was heard.
    pub fn offset(&self, device_ns: i64) -> Option<Offset> {
        let (line, _) = self.line()?;
        Some(line.at(device_ns))
    }

    /// Returns the state of the clock; `None` before anything was heard.
    pub fn status(&self) -> Option<ClockStatus> {
        let (line, source) = self.line()?;
        let Offset { offset_ns, uncertainty_ns } = line.at(self.newest_device_ns?);
        Some(ClockStatus {
            source,
            offset_ns,
            uncertainty_ns,
            drift_ppm: line.drift * 1e6,
            restarts: self.restarts,
            exchanges: self.exchanges.total(),
        })
    }

    /// Returns the better line and its source.
    fn line(&self) -> Option<(Line, Source)> {
        let newest = self.newest_device_ns?;
        let exchanged = self.exchanges.line(newest).map(|line| (line, Source::Timesync));
        exchanged.or_else(|| self.arrivals.line().map(|line| (line, Source::Arrivals)))
    }

    fn remember_newest(&mut self, device_ns: i64) {
        self.newest_device_ns = Some(self.newest_device_ns.map_or(device_ns, |newest| newest.max(device_ns)));
    }

    /// Forgets all that was known of the clock.
    fn restart(&mut self) {
        self.restarts += 1;
        self.newest_device_ns = None;
        self.arrivals = Arrivals::default();
        self.exchanges.forget();
    }
}
