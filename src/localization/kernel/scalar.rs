//! The plain path, and the definition of what the others compute.

use super::{LANES, LAST, Placement};
use crate::vision::ground::SIDE;

pub(super) fn sum(quads: &[u32], xs: &[f32], ys: &[f32], p: Placement) -> [f32; LANES] {
    let mut sums = [0.0f32; LANES];
    for (xs, ys) in xs.chunks_exact(LANES).zip(ys.chunks_exact(LANES)) {
        for lane in 0..LANES {
            let (x, y) = (xs[lane], ys[lane]);
            let u = clamped((x * p.cos + y * p.sin) + p.u0);
            let v = clamped((y * p.cos - x * p.sin) + p.v0);
            let (column, row) = (u as i32, v as i32);
            let (fu, fv) = (u - column as f32, v - row as f32);
            let quad = quads[row as usize * SIDE + column as usize];
            let byte = |shift: u32| ((quad >> shift) & 255) as f32;
            let upper = byte(0) + (byte(8) - byte(0)) * fu;
            let lower = byte(16) + (byte(24) - byte(16)) * fu;
            sums[lane] += upper + (lower - upper) * fv;
        }
    }
    sums
}

/// To the table, NaN to 0; the table's rim reads neutral, so that outside is neutral too.
fn clamped(value: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < LAST { value } else { LAST }
}
