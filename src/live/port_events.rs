//! Health of the serial ports of a running recorder.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::devices::mavlink::PortCounts;
use crate::devices::serial::{LineStatus, Trouble};

/// State of one serial port; part of `realitysim recorder status`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Port {
    /// Why the port is not open, if it is not.
    pub closed: Option<String>,
    /// What is wrong with the data on it, while it is open.
    pub trouble: Option<PortTrouble>,
    #[serde(flatten)]
    pub line: Option<LineStatus>,
    /// The fault that `trouble` describes.
    #[serde(skip)]
    fault: Option<Trouble>,
    /// Counts of the last seconds, one entry each, the newest last.
    #[serde(skip)]
    history: VecDeque<PortCounts>,
}

/// A lasting fault of an open port.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PortTrouble {
    /// `silent`, `no_messages`, `echo`, `unusable`, `lost` or `noisy`.
    pub cause: String,
    pub said: String,
}

/// Seconds that a fault must last until it is reported: a heartbeat comes once a second.
const MIN_TROUBLE_S: usize = 3;
/// Seconds without a fault until it is reported as over, so that a marginal line does not fill the journal.
const MIN_QUIET_S: usize = 10;

impl Port {
    /// Sets whether the port is open, or why not. Returns whether this changed.
    pub fn set_closed(&mut self, closed: Option<String>) -> bool {
        let news = self.closed != closed;
        self.closed = closed;
        (self.trouble, self.fault) = (None, None);
        self.history.clear();
        news
    }

    /// Takes the port's counts, once a second. Returns the changes to report.
    pub fn update(&mut self, line: LineStatus) -> Vec<PortUpdate> {
        let mut news = self.restarted_clocks(&line);
        let last = self.fault.take();
        let found = self.trouble_within(MIN_TROUBLE_S, &line).or_else(|| {
            let lasting = self.trouble_within(MIN_QUIET_S, &line)?;
            last.as_ref().is_some_and(|last| lasting.is_like(last)).then_some(lasting)
        });
        if self.history.len() >= MIN_QUIET_S {
            self.history.pop_front();
        }
        self.history.push_back(line.counts.clone());
        self.line = Some(line);

        match (&last, &found) {
            (Some(last), Some(now)) if now.is_like(last) => {}
            (_, Some(now)) => {
                news.push(PortUpdate { event: now.cause(), said: format!("{now}: {}", now.remedy()) });
            }
            (Some(_), None) => news.push(PortUpdate { event: "recovered", said: "all is well again".to_owned() }),
            (None, None) => {}
        }
        self.trouble = (found.as_ref())
            .map(|trouble| PortTrouble { cause: trouble.cause().to_owned(), said: trouble.to_string() });
        self.fault = found;
        news
    }

    /// Reports the senders whose clock has restarted since the last counts.
    fn restarted_clocks(&self, now: &LineStatus) -> Vec<PortUpdate> {
        let known = self.line.iter().flat_map(|line| &line.clocks);
        let began = known.filter_map(|before| {
            let now = now.clocks.iter().find(|now| (now.sender, now.base) == (before.sender, before.base))?;
            (now.clock.restarts > before.clock.restarts).then(|| {
                let (system, component) = (now.sender.system, now.sender.component);
                let said =
                    format!("the clock of {system}.{component} has jumped: it was set, or its device has started anew");
                PortUpdate { event: "clock_jump", said }
            })
        });
        began.collect()
    }

    /// Fault over the last `seconds`; `None` until `MIN_TROUBLE_S` seconds of counts are there.
    fn trouble_within(&self, seconds: usize, now: &LineStatus) -> Option<Trouble> {
        let enough = self.history.len() >= MIN_TROUBLE_S;
        let at = self.history.len().saturating_sub(seconds);
        let found = Trouble::since(self.history.get(at).filter(|_| enough)?, &now.counts)?;
        // A device that restarts also restarts its message numbers, so one second with missing messages is no lossy line.
        let counts: Vec<u64> = self.history.iter().map(|counts| counts.lost).chain([now.counts.lost]).collect();
        let seconds_with_losses = counts.windows(2).filter(|pair| pair[1] > pair[0]).count();
        let is_once = matches!(found, Trouble::Lost { .. }) && seconds_with_losses < 2;
        (!is_once).then_some(found)
    }

    /// The present fault in words, if there is one.
    pub fn problem(&self) -> Option<&str> {
        self.closed.as_deref().or(self.trouble.as_ref().map(|trouble| trouble.said.as_str()))
    }
}

/// A change of a port that is logged and told.
#[derive(Clone, Debug, PartialEq)]
pub struct PortUpdate {
    pub event: &'static str,
    pub said: String,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::devices::mavlink::FrameCounts;

    fn line(bytes: u64, frames: u64, lost: u64) -> LineStatus {
        let frames = FrameCounts { bytes, frames, ..FrameCounts::default() };
        LineStatus { counts: PortCounts { frames, lost, ..PortCounts::default() }, ..LineStatus::default() }
    }

    fn events(port: &mut Port, lines: impl IntoIterator<Item = LineStatus>) -> Vec<Option<&'static str>> {
        lines.into_iter().map(|line| port.update(line).pop().map(|news| news.event)).collect()
    }

    #[test]
    fn silence_of_a_device_is_reported_once_and_so_is_its_end() {
        let mut port = Port::default();
        assert!(!port.set_closed(None));
        let spoke = (1..=5).map(|second| line(1_000 * second, 10 * second, 0));
        assert_eq!(events(&mut port, spoke), [None; 5]);
        assert_eq!(events(&mut port, vec![line(5_000, 50, 0); 5]), [None, None, Some("silent"), None, None]);
        assert_eq!(port.problem(), Some("silent"));
        assert_eq!(events(&mut port, [line(6_000, 60, 0)]), [Some("recovered")]);
        assert_eq!(port.problem(), None);
        assert!(port.set_closed(Some("gone".to_owned())) && !port.set_closed(Some("gone".to_owned())));
        assert_eq!(port.problem(), Some("gone"));
    }

    #[test]
    fn a_line_that_loses_now_and_then_is_reported_once() {
        let mut port = Port::default();
        let (mut frames, mut lost) = (0, 0);
        let lines: Vec<LineStatus> = (0..60)
            .map(|second| {
                frames += 97;
                lost += if second % 3 == 0 { 12 } else { 0 };
                line(frames * 50, frames, lost)
            })
            .collect();
        let told: Vec<&str> = events(&mut port, lines).into_iter().flatten().collect();
        assert_eq!(told, ["lost"]);
        let quiet = (1..=11).map(|second| line((frames + 97 * second) * 50, frames + 97 * second, lost));
        let told: Vec<&str> = events(&mut port, quiet).into_iter().flatten().collect();
        assert_eq!(told, ["recovered"]);
    }

    #[test]
    fn a_restarted_device_is_reported_as_that_and_not_as_losses() {
        use crate::devices::clock::{ClockStatus, Source};
        use crate::devices::mavlink::{Sender, TimeBase};
        use crate::devices::serial::SenderClock;
        let mut port = Port::default();
        let clock = |restarts| SenderClock {
            sender: Sender { system: 1, component: 1 },
            base: TimeBase::Boot,
            clock: ClockStatus {
                source: Source::Timesync,
                offset_ns: 0,
                uncertainty_ns: 0,
                drift_ppm: 0.0,
                restarts,
                exchanges: 9,
            },
        };
        let mut told = Vec::new();
        for second in 1..30 {
            let (lost, restarts) = if second > 12 { (139, 1) } else { (0, 0) };
            let line = LineStatus { clocks: vec![clock(restarts)], ..line(5_000 * second, 100 * second, lost) };
            told.extend(port.update(line).into_iter().map(|news| news.event));
        }
        assert_eq!(told, ["clock_jump"]);
    }
}
