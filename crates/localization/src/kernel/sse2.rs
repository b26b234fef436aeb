//! The SSE2 path, which every x86-64 processor has: four points side by side.

use core::arch::x86_64::*;

use super::{CELL_BIT, FRACTION_BIT, FULL, LANES, LAST, Placement, word};
use realitysim_vision::ground::SIDE;

/// Sums the interpolated levels of groups of points.
///
/// # Safety
/// `quads` must hold SIDE x SIDE words.
#[target_feature(enable = "sse2")]
pub(super) unsafe fn sum(quads: &[u32], groups: &[[[i16; 2]; LANES]], p: Placement) -> u64 {
    let pair = |low: i16, high: i16| _mm_set1_epi32(i32::from(low) & 0xffff | i32::from(high) << 16);
    let (to_u, to_v) = (pair(p.cos, p.sin), pair(-p.sin, p.cos));
    let (u0, v0) = (_mm_set1_epi32(p.u0), _mm_set1_epi32(p.v0));
    let shift = _mm_cvtsi32_si128(p.shift as i32);
    let (last, side) = (_mm_set1_epi32(LAST), _mm_set1_epi32(SIDE as i32));
    let (zero, full) = (_mm_setzero_si128(), _mm_set1_epi32(FULL));
    let on_table = |cells: __m128i| {
        let cells = _mm_srl_epi32(cells, shift);
        let beyond = _mm_cmpgt_epi32(cells, last);
        _mm_or_si128(_mm_and_si128(beyond, last), _mm_andnot_si128(beyond, cells))
    };
    // The weight of a cell in the lower half of each word, that of the next cell in the upper half.
    let weights = |cells: __m128i| {
        let far = _mm_and_si128(_mm_srli_epi32::<{ FRACTION_BIT as i32 }>(cells), full);
        _mm_xor_si128(_mm_or_si128(far, _mm_slli_epi32::<16>(far)), full)
    };
    let mut sums = zero;
    for places in groups.as_flattened().as_chunks::<4>().0 {
        // SAFETY: four pairs of 16 bits.
        let places = unsafe { _mm_loadu_si128(places.as_ptr().cast()) };
        let u = on_table(_mm_add_epi32(_mm_madd_epi16(places, to_u), u0));
        let v = on_table(_mm_add_epi32(_mm_madd_epi16(places, to_v), v0));
        let (column, row) = (_mm_srli_epi32::<{ CELL_BIT as i32 }>(u), _mm_srli_epi32::<{ CELL_BIT as i32 }>(v));
        let index = _mm_add_epi32(_mm_madd_epi16(row, side), column);
        let low = _mm_cvtsi128_si64(index) as u64;
        let high = _mm_cvtsi128_si64(_mm_unpackhi_epi64(index, index)) as u64;
        // SAFETY: column and row lie in 0..SIDE, so every index lies in the table.
        let quad = unsafe {
            _mm_setr_epi32(word(quads, low), word(quads, low >> 32), word(quads, high), word(quads, high >> 32))
        };
        let (of_u, of_v) = (weights(u), weights(v));
        let low = _mm_madd_epi16(_mm_unpacklo_epi8(quad, zero), _mm_unpacklo_epi32(of_u, of_u));
        let high = _mm_madd_epi16(_mm_unpackhi_epi8(quad, zero), _mm_unpackhi_epi32(of_u, of_u));
        sums = _mm_add_epi32(sums, _mm_madd_epi16(_mm_packs_epi32(low, high), of_v));
    }
    let mut lanes = [0u32; 4];
    // SAFETY: `lanes` holds four words.
    unsafe { _mm_storeu_si128(lanes.as_mut_ptr().cast(), sums) };
    lanes.iter().map(|lane| u64::from(*lane)).sum()
}
