//! Reads the clocks of the host.

use rustix::time::{ClockId, clock_gettime};

/// Returns the monotonic clock (`CLOCK_MONOTONIC`), nanoseconds. The kernel stamps frames by it, and it is never set.
pub fn monotonic_ns() -> i64 {
    nanoseconds(ClockId::Monotonic)
}

/// Returns UTC minus [`monotonic_ns`] at this moment, nanoseconds.
///
/// It is read once at the start of a session, because the clock may be set later.
pub fn utc_offset_ns() -> i64 {
    // UTC is read between two reads of the monotonic clock. An interruption makes the pair wide; the narrowest of five counts.
    let mut best = (i64::MAX, 0);
    for _ in 0..5 {
        let (before, utc, after) = (monotonic_ns(), nanoseconds(ClockId::Realtime), monotonic_ns());
        best = best.min((after - before, utc - (before + (after - before) / 2)));
    }
    best.1
}

/// Reads a clock, nanoseconds.
fn nanoseconds(clock: ClockId) -> i64 {
    let time = clock_gettime(clock);
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}
