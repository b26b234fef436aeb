//! SSE2 and AVX2. Same operations in the same order as the plain path.

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

/// Every x86-64 processor has SSE2. It cannot gather: the four words are loaded one by one.
pub(super) fn sse2(quads: &[u32], xs: &[f32], ys: &[f32], p: Placement) -> [f32; LANES] {
    let mut lanes = [0.0f32; LANES];
    for half in 0..2 {
        // SAFETY: SSE2 is part of x86-64.
        let sums = unsafe { sse2_half(quads, xs, ys, p, 4 * half) };
        lanes[4 * half..4 * half + 4].copy_from_slice(&sums);
    }
    lanes
}

#[target_feature(enable = "sse2")]
fn sse2_half(quads: &[u32], xs: &[f32], ys: &[f32], p: Placement, first: usize) -> [f32; 4] {
    let (cos, sin) = (_mm_set1_ps(p.cos), _mm_set1_ps(p.sin));
    let (u0, v0) = (_mm_set1_ps(p.u0), _mm_set1_ps(p.v0));
    let (zero, last) = (_mm_setzero_ps(), _mm_set1_ps(LAST));
    let byte_mask = _mm_set1_epi32(255);
    let mut sums = _mm_setzero_ps();
    for (xs, ys) in xs.chunks_exact(LANES).zip(ys.chunks_exact(LANES)) {
        let (xs, ys) = (&xs[first..first + 4], &ys[first..first + 4]);
        // SAFETY: both slices hold four floats.
        let (x, y) = unsafe { (_mm_loadu_ps(xs.as_ptr()), _mm_loadu_ps(ys.as_ptr())) };
        let u = _mm_add_ps(_mm_add_ps(_mm_mul_ps(x, cos), _mm_mul_ps(y, sin)), u0);
        let v = _mm_add_ps(_mm_sub_ps(_mm_mul_ps(y, cos), _mm_mul_ps(x, sin)), v0);
        let u = _mm_min_ps(_mm_max_ps(u, zero), last);
        let v = _mm_min_ps(_mm_max_ps(v, zero), last);
        let (column, row) = (_mm_cvttps_epi32(u), _mm_cvttps_epi32(v));
        let fu = _mm_sub_ps(u, _mm_cvtepi32_ps(column));
        let fv = _mm_sub_ps(v, _mm_cvtepi32_ps(row));
        let (mut columns, mut rows) = ([0i32; 4], [0i32; 4]);
        // SAFETY: both arrays hold four words.
        unsafe {
            _mm_storeu_si128(columns.as_mut_ptr().cast(), column);
            _mm_storeu_si128(rows.as_mut_ptr().cast(), row);
        }
        let word = |lane: usize| quads[rows[lane] as usize * SIDE + columns[lane] as usize] as i32;
        let quad = _mm_set_epi32(word(3), word(2), word(1), word(0));
        let a = _mm_cvtepi32_ps(_mm_and_si128(quad, byte_mask));
        let b = _mm_cvtepi32_ps(_mm_and_si128(_mm_srli_epi32::<8>(quad), byte_mask));
        let c = _mm_cvtepi32_ps(_mm_and_si128(_mm_srli_epi32::<16>(quad), byte_mask));
        let d = _mm_cvtepi32_ps(_mm_srli_epi32::<24>(quad));
        let upper = _mm_add_ps(a, _mm_mul_ps(_mm_sub_ps(b, a), fu));
        let lower = _mm_add_ps(c, _mm_mul_ps(_mm_sub_ps(d, c), fu));
        let value = _mm_add_ps(upper, _mm_mul_ps(_mm_sub_ps(lower, upper), fv));
        sums = _mm_add_ps(sums, value);
    }
    let mut lanes = [0.0f32; 4];
    // SAFETY: `lanes` holds four floats.
    unsafe { _mm_storeu_ps(lanes.as_mut_ptr(), sums) };
    lanes
}
