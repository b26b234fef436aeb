//! Tests with simulated devices: the true offset is known and must lie within the uncertainty that the clock states.

use super::*;
use proptest::prelude::*;

/// A device whose clock began at some host time and runs a little too fast or slow.
struct Simulated {
    began_ns: i64,
    ppm: f64,
    noise: u64,
}

impl Simulated {
    fn device_ns(&self, host_ns: i64) -> i64 {
        let up = host_ns - self.began_ns;
        up + (up as f64 * self.ppm * 1e-6) as i64
    }

    fn true_offset(&self, host_ns: i64) -> i64 {
        host_ns - self.device_ns(host_ns)
    }

    /// Draws a number in 0..1 by SplitMix64.
    fn random(&mut self) -> f64 {
        self.noise = self.noise.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.noise ^ (self.noise >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Draws a delay of at least `least_ms`: mostly little more, sometimes much more.
    fn delay_ns(&mut self, least_ms: f64, jitter_ms: f64) -> i64 {
        let tail = -libm::log(1.0 - self.random());
        let burst = if self.random() < 0.05 { 8.0 } else { 1.0 };
        ((least_ms + jitter_ms * tail * burst) * 1e6) as i64
    }
}

const SECOND: i64 = 1_000_000_000;
const START: i64 = 1_000 * SECOND;

/// Asks a question, of which there are four a second; the answer comes with probability `answered`.
fn question(clock: &mut DeviceClock, device: &mut Simulated, host_ns: i64, jitter_ms: f64, answered: f64) {
    if device.random() > answered {
        return;
    }
    let there = device.delay_ns(0.4, jitter_ms);
    let back = device.delay_ns(0.4, jitter_ms);
    let asked = device.device_ns(host_ns + there);
    clock.exchanged(host_ns, asked, host_ns + there + back);
}

fn error_ns(clock: &DeviceClock, device: &Simulated, host_ns: i64) -> (i64, i64) {
    let offset = clock.offset(device.device_ns(host_ns)).expect("heard of");
    (offset.offset_ns - device.true_offset(host_ns), offset.uncertainty_ns)
}

/// How well the clock of a simulated device was known: errors as shares of what they may be.
struct Heard {
    /// Errors of the offset, question by question, after the first half minute.
    errors: Vec<f64>,
    drift_error: f64,
}

/// Checks that no error is larger than the stated uncertainty, apart from a delay that cannot be known.
fn claimed_error_ms(
    clock: &DeviceClock,
    device: &Simulated,
    host_ns: i64,
    least_ms: f64,
) -> Result<f64, TestCaseError> {
    let (error_ns, uncertainty_ns) = error_ns(clock, device, host_ns);
    let beyond_ns = (error_ns - (least_ms * 1e6) as i64).abs();
    prop_assert!(beyond_ns <= uncertainty_ns, "at {host_ns}: {beyond_ns} of {uncertainty_ns} ns");
    Ok(beyond_ns as f64 / 1e6)
}

/// Asks questions for five minutes. Errors are shares of a message's mean delay, even if only a fifth of the questions is answered.
fn by_exchanges(ppm: f64, jitter_ms: f64, answered: f64, noise: u64) -> Result<Heard, TestCaseError> {
    let mut device = Simulated { began_ns: START - 77 * SECOND, ppm, noise };
    let mut clock = DeviceClock::default();
    let mut errors = Vec::new();
    for step in 0..1200 {
        let host_ns = START + step * SECOND / 4;
        question(&mut clock, &mut device, host_ns, jitter_ms, answered);
        if step > 120 {
            errors.push(claimed_error_ms(&clock, &device, host_ns, 0.0)? / (0.3 + 0.7 * jitter_ms));
        }
    }
    let status = clock.status().expect("heard of");
    prop_assert_eq!((status.source, status.restarts), (Source::Timesync, 0));
    Ok(Heard { errors, drift_error: (status.drift_ppm + ppm).abs() / (5.0 + 15.0 * jitter_ms) })
}

/// Sends messages at 100 Hz for two minutes. Errors are counted beyond the least delay, which arrivals cannot show.
fn by_arrivals(ppm: f64, jitter_ms: f64, least_ms: f64, noise: u64) -> Result<Heard, TestCaseError> {
    let mut device = Simulated { began_ns: START - 5 * SECOND, ppm, noise };
    let mut clock = DeviceClock::default();
    let mut errors = Vec::new();
    for step in 0..12_000 {
        let host_ns = START + step * SECOND / 100;
        let delay = device.delay_ns(least_ms, jitter_ms);
        // Stamps are in whole milliseconds, like time_boot_ms.
        let stamp = device.device_ns(host_ns).div_euclid(1_000_000) * 1_000_000;
        clock.arrived(stamp, 1_000_000, host_ns + delay);
        if step > 1_000 && step % 50 == 0 {
            errors.push(claimed_error_ms(&clock, &device, host_ns, least_ms)? / (1.2 + 0.5 * jitter_ms));
        }
    }
    let status = clock.status().expect("heard of");
    prop_assert_eq!((status.source, status.restarts), (Source::Arrivals, 0));
    Ok(Heard { errors, drift_error: (status.drift_ppm + ppm).abs() / 60.0 })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn exchanges_claim_no_more_than_they_know_in_jitter_drift_and_loss(
        ppm in -100.0..100.0f64, jitter_ms in 0.05..3.0f64, answered in 0.2..1.0f64, noise in any::<u64>()
    ) {
        by_exchanges(ppm, jitter_ms, answered, noise)?;
    }

    #[test]
    fn arrivals_claim_no_more_than_they_know_but_for_the_least_delay(
        ppm in -100.0..100.0f64, jitter_ms in 0.05..3.0f64, least_ms in 0.1..2.0f64, noise in any::<u64>()
    ) {
        by_arrivals(ppm, jitter_ms, least_ms, noise)?;
    }

    /// No times that a device and its line may give make the estimate panic.
    #[test]
    fn no_times_make_a_clock_panic(times in prop::collection::vec((any::<i64>(), any::<i64>(), any::<i64>()), 0..60)) {
        let mut clock = DeviceClock::default();
        for (sent, device, received) in times {
            clock.exchanged(sent, device, received);
            clock.arrived(device, 1_000, received);
            clock.arrived(device.wrapping_add(1), 1_000, received);
            let _ = (clock.offset(device), clock.status());
        }
    }
}

/// Tests the accuracy over 60 devices that are the same in each run, because the accuracy on one device is a matter of chance.
#[test]
fn offset_and_drift_are_found_well_in_jitter_drift_and_loss() {
    let (mut offsets, mut drifts) = (Vec::new(), Vec::new());
    let mut generator = Simulated { began_ns: 0, ppm: 0.0, noise: 17 };
    for device in 0..60 {
        let (ppm, jitter_ms) = (200.0 * generator.random() - 100.0, 0.05 + 2.95 * generator.random());
        let exchanges = by_exchanges(ppm, jitter_ms, 0.2 + 0.8 * generator.random(), device);
        let arrivals = by_arrivals(ppm, jitter_ms, 0.1 + 1.9 * generator.random(), device);
        for heard in [exchanges, arrivals] {
            let heard = heard.expect("no error is larger than is claimed");
            offsets.extend(heard.errors);
            drifts.push(heard.drift_error);
        }
    }
    offsets.sort_by(f64::total_cmp);
    assert!(offsets[offsets.len() / 2] < 0.1, "median {}", offsets[offsets.len() / 2]);
    assert!(offsets[offsets.len() * 99 / 100] < 0.7, "99 of 100 below {}", offsets[offsets.len() * 99 / 100]);
    assert!(offsets.iter().all(|&error| error < 1.0), "worst {:?}", offsets.last());
    assert!(drifts.iter().all(|&error| error < 1.0), "worst {drifts:?}");
}

#[test]
fn a_device_that_starts_anew_is_followed_at_once() {
    for with_exchanges in [true, false] {
        let mut device = Simulated { began_ns: START - 300 * SECOND, ppm: 40.0, noise: 3 };
        let mut clock = DeviceClock::default();
        for step in 0..12_000 {
            let host_ns = START + step * SECOND / 100;
            if step == 6_000 {
                device.began_ns = host_ns;
            }
            let delay = device.delay_ns(0.3, 0.2);
            clock.arrived(device.device_ns(host_ns), 1_000, host_ns + delay);
            if with_exchanges && step % 25 == 0 {
                question(&mut clock, &mut device, host_ns, 0.2, 1.0);
            }
            let (error, _) = error_ns(&clock, &device, host_ns);
            assert!(step < 10 || error.abs() < 5_000_000, "{step}: {error}");
        }
        assert_eq!(clock.status().expect("heard of").restarts, 1);
    }
}

#[test]
fn a_clock_that_is_set_forward_is_followed() {
    for with_exchanges in [true, false] {
        let mut device = Simulated { began_ns: START - 300 * SECOND, ppm: 0.0, noise: 4 };
        let mut clock = DeviceClock::default();
        for step in 0..12_000 {
            let host_ns = START + step * SECOND / 100;
            if step == 6_000 {
                device.began_ns -= 3_600 * SECOND;
            }
            let delay = device.delay_ns(0.3, 0.2);
            clock.arrived(device.device_ns(host_ns), 1_000, host_ns + delay);
            if with_exchanges && step % 25 == 0 {
                question(&mut clock, &mut device, host_ns, 0.2, 1.0);
            }
        }
        let (error, _) = error_ns(&clock, &device, START + 120 * SECOND);
        assert!(error.abs() < 2_000_000, "{error}");
        assert_eq!(clock.status().expect("heard of").restarts, 1);
    }
}

/// A hub hangs, or the recorder is not scheduled: all that was sent meanwhile arrives at once, as fast as the line is.
#[test]
fn a_line_that_stands_still_for_seconds_is_no_other_clock() {
    for (with_exchanges, stands_s, apart_ns) in
        [(true, 3, 0), (false, 3, 0), (false, 5, 3_000_000), (true, 2, 5_000_000)]
    {
        let mut device = Simulated { began_ns: START - 300 * SECOND, ppm: 30.0, noise: 7 };
        let mut clock = DeviceClock::default();
        let mut free_ns = 0;
        for step in 0..12_000 {
            let host_ns = START + step * SECOND / 100;
            let stands = (6_000..6_000 + 100 * stands_s).contains(&step);
            let delay = device.delay_ns(0.3, 0.2);
            let goes_on_ns = if stands { START + (60 + stands_s) * SECOND } else { 0 };
            // The messages arrive one after the other.
            let arrives_ns = (host_ns + delay).max(goes_on_ns).max(free_ns);
            free_ns = if step >= 6_000 { arrives_ns + apart_ns } else { 0 };
            clock.arrived(device.device_ns(host_ns), 1_000, arrives_ns);
            if with_exchanges && step % 25 == 0 && !stands {
                question(&mut clock, &mut device, host_ns, 0.2, 1.0);
            }
            let (error, _) = error_ns(&clock, &device, host_ns);
            assert!(step < 100 || error.abs() < 1_500_000, "{stands_s} s, {step}: {error}");
        }
        let status = clock.status().expect("heard of");
        assert_eq!(status.restarts, 0, "{stands_s} s: {status:?}");
    }
}

#[test]
fn without_answers_the_arrivals_go_on() {
    let mut device = Simulated { began_ns: START - 300 * SECOND, ppm: 90.0, noise: 5 };
    let mut clock = DeviceClock::default();
    for step in 0..12_000 {
        let host_ns = START + step * SECOND / 100;
        let delay = device.delay_ns(0.3, 0.2);
        clock.arrived(device.device_ns(host_ns), 1_000, host_ns + delay);
        if step < 3_000 && step % 25 == 0 {
            question(&mut clock, &mut device, host_ns, 0.2, 1.0);
        }
        if step > 100 {
            let (error, uncertainty) = error_ns(&clock, &device, host_ns);
            assert!(error.abs() < 1_000_000, "{step}: {error} of {uncertainty}");
        }
    }
    assert_eq!(clock.status().expect("heard of").source, Source::Arrivals);
}

#[test]
fn one_wild_answer_changes_nothing() {
    let mut device = Simulated { began_ns: START - 300 * SECOND, ppm: 10.0, noise: 6 };
    let mut clock = DeviceClock::default();
    for step in 0..400 {
        let host_ns = START + step * SECOND / 4;
        question(&mut clock, &mut device, host_ns, 0.2, 1.0);
        if step % 50 == 25 {
            // A damaged answer whose checksum is right by chance.
            clock.exchanged(host_ns, device.device_ns(host_ns) + 900_000_000, host_ns + 1_000_000);
        }
    }
    let (error, _) = error_ns(&clock, &device, START + 100 * SECOND);
    assert!(error.abs() < 300_000, "{error}");
    assert_eq!(clock.status().expect("heard of").restarts, 0);
}
