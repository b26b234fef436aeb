//! A fixed loop as the unit of processor time: a ratio to it is comparable between slow, fast and busy machines.

use std::hint::black_box;

/// Time of the calibration loop on the machine of docs/reference/scenes.md, milliseconds.
///
/// Limits in files of users are in these milliseconds: the value must never change.
pub const REFERENCE_MS: f64 = 2.5;
/// Number of 32-bit words of the table: 256 KiB, part of which fits the caches of a core.
const TABLE: usize = 1 << 16;
/// Number of look-ups of one run, which takes one or two milliseconds.
const LOOKUPS: usize = 1 << 19;

/// A loop that resembles the kernel of the filter: table look-ups that depend on each other, and integer sums.
///
/// All published ratios are in units of it: it must never change.
pub(super) struct Calibration {
    table: Vec<u32>,
}

impl Calibration {
    pub(super) fn new() -> Self {
        let table = (0..TABLE as u32).map(|index| index.wrapping_mul(0x9E37_79B9) ^ (index >> 7)).collect();
        Self { table }
    }

    /// Runs the loop once.
    pub(super) fn run(&self) {
        let mut place = 1u32;
        for _ in 0..LOOKUPS {
            place = place.wrapping_mul(0x0019_660D).wrapping_add(self.table[place as usize >> 16]);
        }
        black_box(place);
    }
}
