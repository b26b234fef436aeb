//! The host's clocks.

use rustix::time::{ClockId, clock_gettime};

/// Of the kernel's frames too; never set.
pub fn monotonic_ns() -> i64 {
    nanoseconds(ClockId::Monotonic)
}

/// UTC minus [`monotonic_ns`], now. Read once at the start of a session: the clock may be set later.
pub fn utc_offset_ns() -> i64 {
    // The middle of three reads: an interruption between two of them is seen as a wide pair, the narrowest counts.
    let mut best = (i64::MAX, 0);
    for _ in 0..5 {
        let (before, utc, after) = (monotonic_ns(), nanoseconds(ClockId::Realtime), monotonic_ns());
        best = best.min((after - before, utc - (before + (after - before) / 2)));
    }
    best.1
}

fn nanoseconds(clock: ClockId) -> i64 {
    let time = clock_gettime(clock);
    time.tv_sec.saturating_mul(1_000_000_000).saturating_add(time.tv_nsec)
}
