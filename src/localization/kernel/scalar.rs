//! The plain path, and the definition of what the others compute.

use super::{LANES, LAST, Placement};
use crate::vision::ground::SIDE;

pub(super) fn sum(quads: &[u32], xs: &[f32], ys: &[f32], p: Placement) -> [f32; LANES] {
    let mut sums = [0.0f32; LANES];
    let (xs, _) = xs.as_chunks::<LANES>();
    let (ys, _) = ys.as_chunks::<LANES>();
    for (xs, ys) in xs.iter().zip(ys) {
        // All places first, then all lookups: only the latter cannot be done side by side.
        let (mut index, mut fu, mut fv) = ([0i32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        for lane in 0..LANES {
            let (x, y) = (xs[lane], ys[lane]);
            let u = clamped((x * p.cos + y * p.sin) + p.u0);
            let v = clamped((y * p.cos - x * p.sin) + p.v0);
            // SAFETY: after clamping both lie in 0..SIDE, and NaN is 0.
            let (column, row) = unsafe { (u.to_int_unchecked::<i32>(), v.to_int_unchecked::<i32>()) };
            (fu[lane], fv[lane]) = (u - column as f32, v - row as f32);
            index[lane] = row * SIDE as i32 + column;
        }
        let quad: [u32; LANES] = core::array::from_fn(|lane| quads[index[lane] as usize]);
        for lane in 0..LANES {
            let byte = |shift: u32| ((quad[lane] >> shift) & 255) as i32 as f32;
            let upper = byte(0) + (byte(8) - byte(0)) * fu[lane];
            let lower = byte(16) + (byte(24) - byte(16)) * fu[lane];
            sums[lane] += upper + (lower - upper) * fv[lane];
        }
    }
    sums
}

/// To the table, NaN to 0; the table's rim reads neutral, so that outside is neutral too.
fn clamped(value: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < LAST { value } else { LAST }
}
