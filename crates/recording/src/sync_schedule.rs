//! When the disk is asked to confirm what was written, and how much a power cut can cost.
//!
//! An entry is confirmed one interval after it came, at the next sync. A late or slow sync delays others: entries
//! that came since it was due wait for it, and then for the next one. Let I be the interval, and S the longest time
//! from when a sync was due, or could begin after the one before, until the disk had everything. Then no entry is
//! older than max(I, S) + S when the disk has confirmed it. For this a sync includes everything that came before it
//! was noticed to be due, even what is still queued.

use std::time::Duration;

/// Schedule of syncs and its statistics. Times are those of the storage's clock.
pub(super) struct SyncSchedule {
    interval: Duration,
    /// When the last sync ended that included everything due.
    ended: Duration,
    due: Option<Due>,
    /// Whether the disk has refused since then: the delay of a refusal does not count as a stall.
    is_disturbed: bool,
    worst_stall: Duration,
    worst_unsynced: Duration,
}

/// A sync that is due and has not yet ended.
struct Due {
    /// Since when it is due.
    since: Duration,
    /// When it was noticed to be due: everything that came before has to be included.
    noticed: Duration,
    /// Whether everything that came before is written.
    is_whole: bool,
}

impl SyncSchedule {
    pub fn new(interval: Duration) -> Self {
        Self {
            interval,
            ended: Duration::ZERO,
            due: None,
            is_disturbed: false,
            worst_stall: Duration::ZERO,
            worst_unsynced: Duration::ZERO,
        }
    }

    /// Time until a sync is due; `oldest` is when the oldest entry came that is not confirmed.
    pub fn time_to_sync(&self, oldest: Option<Duration>, now: Duration) -> Duration {
        oldest.map_or(self.interval, |oldest| (oldest + self.interval).saturating_sub(now))
    }

    /// Whether to sync now: a sync is due, and the `next` entry that is still queued came after that was noticed.
    pub fn is_due(&mut self, oldest: Option<Duration>, next: Option<Duration>, now: Duration) -> bool {
        let Some(oldest) = oldest else { return false };
        let due = match &mut self.due {
            Some(due) => due,
            None if now < oldest + self.interval => return false,
            None => {
                let since = self.ended.max(oldest + self.interval);
                self.due.insert(Due { since, noticed: now, is_whole: false })
            }
        };
        due.is_whole = next.is_none_or(|next| next >= due.noticed);
        due.is_whole
    }

    /// Notes that the disk has confirmed what was written; the oldest entry of it came at `oldest`.
    pub fn confirmed(&mut self, oldest: Duration, now: Duration) {
        self.worst_unsynced = self.worst_unsynced.max(now.saturating_sub(oldest));
        let since = self.due.as_ref().map_or_else(|| self.ended.max(oldest + self.interval), |due| due.since);
        if !self.is_disturbed {
            self.worst_stall = self.worst_stall.max(now.saturating_sub(since));
        }
        if self.due.as_ref().is_some_and(|due| due.is_whole) {
            self.due = None;
            self.ended = now;
            self.is_disturbed = false;
        }
    }

    /// Notes that the disk has refused; what it has not confirmed is written again.
    pub fn failed(&mut self) {
        self.due = None;
        self.is_disturbed = true;
    }

    /// Longest time from when a sync was due, or could begin, until the disk had everything, ms: waiting for the
    /// processor, writing and syncing, without the times at which the disk refused.
    pub fn worst_stall_ms(&self) -> f64 {
        self.worst_stall.as_secs_f64() * 1e3
    }

    /// Greatest age of an entry when the disk confirmed it, ms.
    pub fn worst_unsynced_ms(&self) -> f64 {
        self.worst_unsynced.as_secs_f64() * 1e3
    }

    /// Upper bound of what a power cut costs, ms, given the worst stall so far.
    pub fn loss_bound_ms(&self) -> f64 {
        loss_bound_ms(self.interval.as_secs_f64() * 1e3, self.worst_stall_ms())
    }
}

/// Upper bound of what a power cut costs, ms, given the sync interval and the disk's worst stall, ms.
pub fn loss_bound_ms(sync_interval_ms: f64, worst_stall_ms: f64) -> f64 {
    sync_interval_ms.max(worst_stall_ms) + worst_stall_ms
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use proptest::prelude::*;

    use super::*;

    const fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn a_sync_is_due_an_interval_after_the_first_entry_and_takes_the_queue() {
        let mut schedule = SyncSchedule::new(ms(500));
        assert_eq!(schedule.time_to_sync(None, ms(7000)), ms(500));
        assert_eq!(schedule.time_to_sync(Some(ms(6900)), ms(7000)), ms(400));
        assert!(!schedule.is_due(None, None, ms(7000)) && !schedule.is_due(Some(ms(6900)), None, ms(7399)));
        assert!(!schedule.is_due(Some(ms(6900)), Some(ms(7390)), ms(7410)), "that came before it was due");
        assert!(!schedule.is_due(Some(ms(6900)), Some(ms(7409)), ms(7450)), "or before anybody saw it");
        assert!(schedule.is_due(Some(ms(6900)), Some(ms(7410)), ms(7460)));
        schedule.confirmed(ms(6900), ms(7480));
        assert_eq!(
            (schedule.worst_stall_ms(), schedule.worst_unsynced_ms(), schedule.loss_bound_ms()),
            (80.0, 580.0, 580.0)
        );
    }

    #[test]
    fn the_time_a_disk_refuses_is_not_its_pace() {
        let mut schedule = SyncSchedule::new(ms(500));
        assert!(schedule.is_due(Some(ms(100)), None, ms(600)));
        schedule.failed();
        assert!(schedule.is_due(Some(ms(100)), None, ms(30_000)));
        schedule.confirmed(ms(100), ms(30_010));
        assert_eq!((schedule.worst_stall_ms(), schedule.worst_unsynced_ms()), (0.0, 29_910.0));
        assert!(schedule.is_due(Some(ms(30_010)), None, ms(30_510)));
        schedule.confirmed(ms(30_010), ms(30_515));
        assert_eq!(schedule.worst_stall_ms(), 5.0);
    }

    proptest! {
        /// Simulates a writer that takes one entry after the other, asks the disk early when `batch` of them are
        /// written, and is delayed anywhere.
        #[test]
        fn nothing_is_ever_older_than_the_bound(
            between in prop::collection::vec(0u64..700, 10..200),
            held_up in prop::collection::vec(prop_oneof![8 => 0u64..5, 2 => 0u64..60, 1 => 0u64..2500], 1..100),
            batch in 1usize..60,
        ) {
            let mut coming: VecDeque<Duration> = between.iter().scan(0, |at, more| { *at += more; Some(ms(*at)) }).collect();
            let mut held_up = held_up.into_iter().cycle();
            let mut held = move || ms(held_up.next().unwrap());
            let mut schedule = SyncSchedule::new(ms(500));
            let (mut now, mut kept) = (ms(0), VecDeque::new());
            while !coming.is_empty() || !kept.is_empty() {
                now += held();
                match coming.front() {
                    Some(taken) if *taken <= now => {
                        kept.push_back(coming.pop_front().unwrap());
                        now += held();
                    }
                    Some(taken) => now = (*taken).min(now + schedule.time_to_sync(kept.front().copied(), now)),
                    None => now += schedule.time_to_sync(kept.front().copied(), now),
                }
                let next = coming.front().copied().filter(|taken| *taken <= now);
                if schedule.is_due(kept.front().copied(), next, now) || kept.len() >= batch {
                    now += held();
                    schedule.confirmed(kept[0], now);
                    kept.clear();
                    let (oldest, bound) = (schedule.worst_unsynced_ms(), schedule.loss_bound_ms());
                    prop_assert!(oldest <= bound + 1e-6, "{oldest} is above {bound}");
                }
            }
        }
    }
}
