//! How long frames take, in units of a fixed loop: a figure that holds on a slow machine and on a busy one.

use std::hint::black_box;
use std::time::Instant;

use crate::agent::{Footage, FootageOptions, ReplayError};
use crate::config::Settings;
use crate::evaluation::statistics::quantile;

/// Words of the loop's table: 256 KiB, of which a core's own caches hold some.
const TABLE: usize = 1 << 16;
/// Look-ups of one loop: a millisecond or two.
const LOOKUPS: usize = 1 << 19;
/// The best of so many passes over the frames counts: what disturbs the machine only ever adds.
const PASSES: usize = 2;

/// 99 of 100 frames take no longer than this many times the calibration loop, of which 99 of 100 runs count as well:
/// they alternate with the frames, so that whatever else the machine does slows both.
pub fn p99_ratio(options: &FootageOptions, settings: &Settings) -> Result<f64, ReplayError> {
    let footage = Footage::load(options, &mut |_, _| ())?;
    let settings = Settings { field: footage.settings().field.clone(), ..settings.clone() };
    let loop_table = Calibration::new();
    let mut best = f64::INFINITY;
    for _ in 0..PASSES {
        let mut loops_ms = Vec::with_capacity(footage.frames());
        let attempts = footage.try_out(&settings, &mut |_| loops_ms.push(loop_table.run_ms()))?;
        let mut frames_ms: Vec<f64> =
            attempts.iter().filter(|attempt| attempt.seen).map(|attempt| attempt.tag.elapsed_ms).collect();
        frames_ms.sort_by(f64::total_cmp);
        loops_ms.sort_by(f64::total_cmp);
        best = best.min(quantile(&frames_ms, 0.99) / quantile(&loops_ms, 0.99));
    }
    Ok(best)
}

/// Like the filter's kernel: look-ups at places that depend on each other, integer sums. Part of every figure that was
/// ever stated: never change it.
struct Calibration {
    table: Vec<u32>,
}

impl Calibration {
    fn new() -> Self {
        let table = (0..TABLE as u32).map(|index| index.wrapping_mul(0x9E37_79B9) ^ (index >> 7)).collect();
        Self { table }
    }

    fn run_ms(&self) -> f64 {
        let started = Instant::now();
        let mut place = 1u32;
        for _ in 0..LOOKUPS {
            place = place.wrapping_mul(0x0019_660D).wrapping_add(self.table[place as usize >> 16]);
        }
        black_box(place);
        started.elapsed().as_secs_f64() * 1e3
    }
}
