//! A fixed loop: what something takes in units of it holds on a slow machine and on a busy one.

use std::hint::black_box;

/// What the loop takes on the machine of docs/scenes.md. Limits in people's files are in its milliseconds: never change it.
pub const REFERENCE_MS: f64 = 2.5;
/// Words of the loop's table: 256 KiB, of which a core's own caches hold some.
const TABLE: usize = 1 << 16;
/// Look-ups of one loop: a millisecond or two.
const LOOKUPS: usize = 1 << 19;

/// Like the filter's kernel: look-ups at places that depend on each other, integer sums. Part of every figure that was
/// ever stated: never change it.
pub(super) struct Calibration {
    table: Vec<u32>,
}

impl Calibration {
    pub(super) fn new() -> Self {
        let table = (0..TABLE as u32).map(|index| index.wrapping_mul(0x9E37_79B9) ^ (index >> 7)).collect();
        Self { table }
    }

    pub(super) fn run(&self) {
        let mut place = 1u32;
        for _ in 0..LOOKUPS {
            place = place.wrapping_mul(0x0019_660D).wrapping_add(self.table[place as usize >> 16]);
        }
        black_box(place);
    }
}
