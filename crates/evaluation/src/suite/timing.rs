//! Time for a frame in units of the calibration loop: a ratio that is comparable between slow, fast and busy machines.

use std::time::Instant;

use crate::cpu_calibration::Calibration;
use crate::statistics::quantile;
use realitysim_config::Settings;
use realitysim_tagging::{FrameCache, FrameCacheOptions, ReplayError};

/// Number of passes over the frames. The best counts: disturbances only add time.
const PASSES: usize = 2;

/// Measures the 99 % quantile of the time for a frame, divided by that of the calibration loop.
///
/// Runs of the loop alternate with the frames, so that whatever else the machine does slows both.
pub fn p99_ratio(options: &FrameCacheOptions, settings: &Settings) -> Result<f64, ReplayError> {
    let cache = FrameCache::load(options, &mut |_, _| ())?;
    let settings = Settings { field: cache.settings().field.clone(), ..settings.clone() };
    let calibration = Calibration::new();
    let mut best = f64::INFINITY;
    for _ in 0..PASSES {
        let mut loops_ms = Vec::with_capacity(cache.frames());
        let attempts = cache.try_out(&settings, &mut |_| {
            let started = Instant::now();
            calibration.run();
            loops_ms.push(started.elapsed().as_secs_f64() * 1e3);
        })?;
        let mut frames_ms: Vec<f64> =
            attempts.iter().filter(|attempt| attempt.seen).map(|attempt| attempt.tag.elapsed_ms).collect();
        frames_ms.sort_by(f64::total_cmp);
        loops_ms.sort_by(f64::total_cmp);
        best = best.min(quantile(&frames_ms, 0.99) / quantile(&loops_ms, 0.99));
    }
    Ok(best)
}
