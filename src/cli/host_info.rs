//! The machine that times were measured on, and whether the times can be trusted.

use std::fs;

use crate::localization::{SimdPath, kernel};

/// Number of processors that this program may use; 1 if the system does not tell.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Describes the machine well enough to know what to expect elsewhere.
pub fn describe(path: SimdPath) -> String {
    let cores = cores();
    let path = match kernel::available(path) {
        SimdPath::Avx2 => "AVX2",
        SimdPath::Sse2 => "SSE2",
        SimdPath::Neon => "NEON",
        SimdPath::Scalar | SimdPath::Auto => "no SIMD",
    };
    let architecture = std::env::consts::ARCH.replace('_', "-");
    format!("{cores}-core machine, {architecture} with {path}")
}

/// Seconds for which this thread was ready to run and did not get a processor, if the system tells.
pub fn waited_s() -> Option<f64> {
    let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().nth(1)?.parse::<u64>().ok()? as f64 * 1e-9)
}

/// Share of the time spent waiting beyond which other programs have influenced the times.
const BUSY_SHARE: f64 = 0.05;

/// Returns a warning about times that were measured on a busy machine.
pub fn busy_warning(waited_s: Option<f64>, elapsed_s: f64) -> Option<String> {
    let share = waited_s? / elapsed_s.max(1e-9);
    (share > BUSY_SHARE).then(|| {
        format!(
            "the machine was busy: {:.0} % of the time went into waiting for a processor, so times are too high; measure \
             again when nothing else runs",
            100.0 * share
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_busy_machine_is_warned_of() {
        assert_eq!(busy_warning(None, 1.0), None);
        assert_eq!(busy_warning(Some(0.01), 1.0), None);
        assert!(busy_warning(Some(0.5), 1.0).is_some_and(|text| text.contains("50 %")));
    }
}
