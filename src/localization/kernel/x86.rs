//! AVX2. Same operations in the same order as the plain path.

use core::arch::x86_64::*;

use super::{LANES, LAST, Placement};
use crate::vision::ground::SIDE;

/// # Safety
/// The processor must have AVX2 and `quads` must hold SIDE x SIDE words.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn avx2(quads: &[u32], xs: &[f32], ys: &[f32], p: Placement) -> [f32; LANES] {
    let (cos, sin) = (_mm256_set1_ps(p.cos), _mm256_set1_ps(p.sin));
    let (u0, v0) = (_mm256_set1_ps(p.u0), _mm256_set1_ps(p.v0));
    let (zero, last) = (_mm256_setzero_ps(), _mm256_set1_ps(LAST));
    let side = _mm256_set1_epi32(SIDE as i32);
    let byte_mask = _mm256_set1_epi32(255);
    let mut sums = _mm256_setzero_ps();
    for (xs, ys) in xs.chunks_exact(LANES).zip(ys.chunks_exact(LANES)) {
        // SAFETY: both chunks hold eight floats.
        let (x, y) = unsafe { (_mm256_loadu_ps(xs.as_ptr()), _mm256_loadu_ps(ys.as_ptr())) };
        let u = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(x, cos), _mm256_mul_ps(y, sin)), u0);
        let v = _mm256_add_ps(_mm256_sub_ps(_mm256_mul_ps(y, cos), _mm256_mul_ps(x, sin)), v0);
        // Of a NaN and a number these return the second operand: the number.
        let u = _mm256_min_ps(_mm256_max_ps(u, zero), last);
        let v = _mm256_min_ps(_mm256_max_ps(v, zero), last);
        let (column, row) = (_mm256_cvttps_epi32(u), _mm256_cvttps_epi32(v));
        let fu = _mm256_sub_ps(u, _mm256_cvtepi32_ps(column));
        let fv = _mm256_sub_ps(v, _mm256_cvtepi32_ps(row));
        let index = _mm256_add_epi32(_mm256_mullo_epi32(row, side), column);
        // SAFETY: column and row lie in 0..SIDE after the clamping, so every index lies in the table.
        let quad = unsafe { _mm256_i32gather_epi32::<4>(quads.as_ptr().cast(), index) };
        let a = _mm256_cvtepi32_ps(_mm256_and_si256(quad, byte_mask));
        let b = _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32::<8>(quad), byte_mask));
        let c = _mm256_cvtepi32_ps(_mm256_and_si256(_mm256_srli_epi32::<16>(quad), byte_mask));
        let d = _mm256_cvtepi32_ps(_mm256_srli_epi32::<24>(quad));
        let upper = _mm256_add_ps(a, _mm256_mul_ps(_mm256_sub_ps(b, a), fu));
        let lower = _mm256_add_ps(c, _mm256_mul_ps(_mm256_sub_ps(d, c), fu));
        let value = _mm256_add_ps(upper, _mm256_mul_ps(_mm256_sub_ps(lower, upper), fv));
        sums = _mm256_add_ps(sums, value);
    }
    let mut lanes = [0.0f32; LANES];
    // SAFETY: `lanes` holds eight floats.
    unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), sums) };
    lanes
}
