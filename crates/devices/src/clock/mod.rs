//! What time it is by the host's clock when a device's clock says something else.
//!
//! Pure: the host's time is an argument. Two sources, the better one counts: questions and answers (TIMESYNC), and, for a
//! device that does not answer, the times at which its messages arrive. Both follow a drift of up to `MAX_DRIFT`, forget
//! what is old, and begin anew when the device's clock was set or the device has started again.

mod arrivals;
mod delay;
mod exchanges;
#[cfg(test)]
mod tests;

use serde::Serialize;

pub use delay::{Delay, DelayError, Turn, estimate};

use arrivals::Arrivals;
use exchanges::Exchanges;

/// Host minus device as a straight line in the device's time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Line {
    at_device_ns: i64,
    offset_ns: f64,
    /// Seconds of offset per second of device time.
    drift: f64,
    /// The offset is this far from the truth at most, as far as one can know, at `at_device_ns`.
    uncertainty_ns: f64,
    /// Of `drift`.
    drift_uncertainty: f64,
}

impl Line {
    fn at(&self, device_ns: i64) -> Offset {
        let away_ns = device_ns.saturating_sub(self.at_device_ns) as f64;
        Offset {
            offset_ns: (self.offset_ns + self.drift * away_ns) as i64,
            uncertainty_ns: (self.uncertainty_ns + self.drift_uncertainty * away_ns.abs()) as i64,
        }
    }
}

/// Host time minus device time, and how far that may be from the truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offset {
    pub offset_ns: i64,
    pub uncertainty_ns: i64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// Questions and answers.
    Timesync,
    /// Arrival times only: a delay that every message has cannot be seen.
    Arrivals,
}

/// For people and logs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ClockStatus {
    pub source: Source,
    pub offset_ns: i64,
    pub uncertainty_ns: i64,
    pub drift_ppm: f64,
    /// Times that the clock was set or its device started anew.
    pub restarts: u64,
    pub exchanges: u64,
}

/// Of one device and one of its clocks.
#[derive(Clone, Debug, Default)]
pub struct DeviceClock {
    exchanges: Exchanges,
    arrivals: Arrivals,
    newest_device_ns: Option<i64>,
    restarts: u64,
}

/// A quartz is right to 50 ppm, a bad oscillator to 100, and the host's own has an error too.
const MAX_DRIFT: f64 = 300e-6;
/// A clock that goes back by more than this was set, or its device has started anew. Messages of several kinds are not
/// always sent in the order of their stamps.
const RESTART_NS: i64 = 1_000_000_000;

impl DeviceClock {
    /// A message with the device's stamp (the earliest that it can mean) has arrived; `host_ns` is when its first byte can have
    /// left at the latest, which is the arrival less the time on the wire. The stamp may have been rounded down by
    /// `resolution_ns`.
    pub fn arrived(&mut self, device_ns: i64, resolution_ns: i64, host_ns: i64) {
        if self.newest_device_ns.is_some_and(|newest| newest.saturating_sub(device_ns) > RESTART_NS) {
            self.restart();
        }
        if !self.arrivals.push(device_ns, resolution_ns, host_ns) {
            self.restart();
            self.arrivals.push(device_ns, resolution_ns, host_ns);
        }
        self.note(device_ns);
    }

    /// The device answered at `device_ns` a question that was sent at `sent_ns` and whose answer came at `received_ns`.
    /// Answers from the future or to questions too long ago are left out.
    pub fn exchanged(&mut self, sent_ns: i64, device_ns: i64, received_ns: i64) {
        let went_back = self.newest_device_ns.is_some_and(|newest| newest.saturating_sub(device_ns) > RESTART_NS);
        if went_back {
            self.restart();
        }
        if !self.exchanges.push(sent_ns, device_ns, received_ns) {
            self.restart();
            self.exchanges.push(sent_ns, device_ns, received_ns);
        }
        self.note(device_ns);
    }

    /// The best that is known; none before anything was heard.
    pub fn offset(&self, device_ns: i64) -> Option<Offset> {
        let (line, _) = self.line()?;
        Some(line.at(device_ns))
    }

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

    fn line(&self) -> Option<(Line, Source)> {
        let newest = self.newest_device_ns?;
        let exchanged = self.exchanges.line(newest).map(|line| (line, Source::Timesync));
        exchanged.or_else(|| self.arrivals.line().map(|line| (line, Source::Arrivals)))
    }

    fn note(&mut self, device_ns: i64) {
        self.newest_device_ns = Some(self.newest_device_ns.map_or(device_ns, |newest| newest.max(device_ns)));
    }

    fn restart(&mut self) {
        self.restarts += 1;
        self.newest_device_ns = None;
        self.arrivals = Arrivals::default();
        self.exchanges.forget();
    }
}
