//! How long frames take, in units of a fixed loop: a figure that holds on a slow machine and on a busy one.

use std::time::Instant;

use crate::cpu_yardstick::Calibration;
use crate::statistics::quantile;
use realitysim_config::Settings;
use realitysim_tagging::{FrameCache, FrameCacheOptions, ReplayError};

/// The best of so many passes over the frames counts: what disturbs the machine only ever adds.
const PASSES: usize = 2;

/// 99 of 100 frames take no longer than this many times the calibration loop, of which 99 of 100 runs count as well:
/// they alternate with the frames, so that whatever else the machine does slows both.
pub fn p99_ratio(options: &FrameCacheOptions, settings: &Settings) -> Result<f64, ReplayError> {
    let footage = FrameCache::load(options, &mut |_, _| ())?;
    let settings = Settings { field: footage.settings().field.clone(), ..settings.clone() };
    let calibration = Calibration::new();
    let mut best = f64::INFINITY;
    for _ in 0..PASSES {
        let mut loops_ms = Vec::with_capacity(footage.frames());
        let attempts = footage.try_out(&settings, &mut |_| {
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
