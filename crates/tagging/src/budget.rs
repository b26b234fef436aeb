//! The time budget of a frame.
//!
//! A frame that runs out of time weighs fewer poses. The number of poses at which it stopped is stored with its tag, so
//! that a replay stops at the same pose on any machine.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Recorded stops of a budget: from a frame's stamp in nanoseconds to the number of poses after which the clock stopped
/// it, or `None` if it was not stopped.
pub type Decisions = BTreeMap<i64, Option<u32>>;

/// The time budget of all frames, and what has been learnt of how long the end of a frame takes.
#[derive(Clone, Debug, Default)]
pub struct Budget {
    limit: Option<Duration>,
    /// Stops that the agent recorded when it made the log that is replayed.
    decided: Decisions,
    /// Time kept free for the work after the last pose has been weighed, which is mostly refinement.
    reserve: Duration,
    /// Time kept free for the poses that are weighed between two looks at the clock.
    stride: Duration,
}

/// The budget of one frame.
#[derive(Clone, Debug)]
pub struct Allowance {
    until: Until,
    stopped_at: Option<u32>,
    last_asked: Instant,
    longest_stride: Duration,
}

#[derive(Clone, Copy, Debug)]
enum Until {
    /// No limit.
    Forever,
    /// The clock decides.
    Time(Instant),
    /// A recorded decision: stop after this many poses.
    Weighed(u32),
}

/// Factor by which the learnt maxima decay with each frame: half in five seconds at 10 Hz.
const DECAY_PER_FRAME: f64 = 0.986;

impl Budget {
    /// A budget of `limit_ms` milliseconds from the decoded image to the tag; 0 means no limit.
    ///
    /// A decision in `decided` takes precedence over the clock for its frame.
    pub fn new(limit_ms: f64, decided: Decisions) -> Self {
        let limit = (limit_ms > 0.0).then(|| Duration::from_secs_f64(limit_ms * 1e-3));
        Self { limit, decided, reserve: Duration::ZERO, stride: Duration::ZERO }
    }

    /// The allowance of the frame with this stamp, of whose budget `looked_ms` milliseconds have been spent on vision.
    pub fn frame(&mut self, stamp_ns: i64, looked_ms: f64) -> Allowance {
        let now = Instant::now();
        let until = match (self.limit, self.decided.remove(&stamp_ns)) {
            (None, _) | (_, Some(None)) => Until::Forever,
            (_, Some(Some(weighed))) => Until::Weighed(weighed),
            (Some(limit), None) => {
                let looked = Duration::from_secs_f64(looked_ms.max(0.0) * 1e-3);
                Until::Time(now + limit.saturating_sub(looked + self.reserve + self.stride))
            }
        };
        Allowance { until, stopped_at: None, last_asked: now, longest_stride: Duration::ZERO }
    }

    /// Learns from a finished frame how much time to keep free for the next ones.
    pub fn learn(&mut self, allowance: &Allowance) {
        self.reserve = self.reserve.mul_f64(DECAY_PER_FRAME).max(allowance.last_asked.elapsed());
        self.stride = self.stride.mul_f64(DECAY_PER_FRAME).max(allowance.longest_stride);
    }
}

impl Allowance {
    /// Whether the frame may weigh more poses after `weighed` of them. Once it answers no, it always does.
    pub fn has_time(&mut self, weighed: u32) -> bool {
        if self.stopped_at.is_some() {
            return false;
        }
        let go_on = match self.until {
            Until::Forever => true,
            Until::Time(deadline) => {
                let now = Instant::now();
                self.longest_stride = self.longest_stride.max(now.saturating_duration_since(self.last_asked));
                self.last_asked = now;
                now < deadline
            }
            Until::Weighed(stop) => weighed < stop,
        };
        self.stopped_at = (!go_on).then_some(weighed);
        go_on
    }

    /// The number of poses after which the frame was stopped, or `None` if it was not.
    pub fn stopped_at(&self) -> Option<u32> {
        self.stopped_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_limit_nothing_is_stopped() {
        let mut allowance = Budget::new(0.0, Decisions::from([(7, Some(64))])).frame(7, 1e9);
        assert!((0..100).all(|round| allowance.has_time(1 << round.min(31))));
        assert_eq!(allowance.stopped_at(), None);
    }

    #[test]
    fn a_recorded_decision_holds_whatever_the_clock_says() {
        let mut budget = Budget::new(1e-3, Decisions::from([(7, Some(192)), (8, None)]));
        let mut stopped = budget.frame(7, 1e9);
        assert_eq!([64, 128, 192, 256].map(|weighed| stopped.has_time(weighed)), [true, true, false, false]);
        assert_eq!(stopped.stopped_at(), Some(192));
        assert!(budget.frame(8, 1e9).has_time(u32::MAX), "it was not stopped");
        assert!(!budget.frame(9, 1e9).has_time(64), "nothing was recorded: the clock counts");
    }

    #[test]
    fn nothing_is_begun_that_could_not_be_ended_in_time() {
        let mut budget = Budget::new(100.0, Decisions::new());
        let mut first = budget.frame(1, 0.0);
        std::thread::sleep(Duration::from_millis(60));
        assert!(first.has_time(64));
        budget.learn(&first);
        let mut second = budget.frame(2, 0.0);
        std::thread::sleep(Duration::from_millis(50));
        assert!(!second.has_time(64), "another stride of 60 ms ends after 110");
    }

    #[test]
    fn what_a_frame_needs_at_its_end_is_kept_back() {
        let mut budget = Budget::new(50.0, Decisions::new());
        let mut first = budget.frame(1, 0.0);
        assert!(first.has_time(64));
        std::thread::sleep(Duration::from_millis(60));
        budget.learn(&first);
        assert!(!budget.frame(2, 0.0).has_time(64), "the rest alone takes longer than the whole");
    }
}
