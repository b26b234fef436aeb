//! AVX2: eight places at a time, each pixel's four channels together. Same sums as the plain path.

use core::arch::x86_64::*;

use super::super::camera::CELL;
use super::super::raster::Raster;
use super::{ONE, Pixels, WEIGHT_BITS};

const LANES: usize = 8;

/// # Safety
/// The processor must have AVX2, and `image` `width` x `height` pixels, at least two each way.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn read_cell(image: &Raster, us: &[f32; CELL * CELL], vs: &[f32; CELL * CELL]) -> Pixels {
    let mut pixels = [[0u8; 4]; CELL * CELL];
    let (width, height) = (image.width as i32, image.height as i32);
    let (one, half) = (_mm256_set1_ps(ONE as f32), _mm256_set1_ps(0.5));
    let (right, bottom) = (_mm256_set1_ps((width - 1) as f32), _mm256_set1_ps((height - 1) as f32));
    let zero = _mm256_setzero_ps();
    for ((us, vs), out) in us.chunks_exact(LANES).zip(vs.chunks_exact(LANES)).zip(pixels.chunks_exact_mut(LANES)) {
        // SAFETY: both chunks hold eight floats.
        let (u, v) = unsafe { (_mm256_loadu_ps(us.as_ptr()), _mm256_loadu_ps(vs.as_ptr())) };
        // False for NaN.
        let within =
            |x, last| _mm256_and_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(x, zero), _mm256_cmp_ps::<_CMP_LE_OQ>(x, last));
        let inside = _mm256_and_ps(within(u, right), within(v, bottom));
        let seen = _mm256_movemask_ps(inside);
        if seen == 0 {
            continue;
        }
        // What is outside reads the first pixel, and is left out below.
        let fixed = |x| _mm256_cvttps_epi32(_mm256_add_ps(_mm256_mul_ps(_mm256_and_ps(x, inside), one), half));
        let (u, v) = (fixed(u), fixed(v));
        let whole =
            |x, most: i32| _mm256_min_epi32(_mm256_srli_epi32::<{ WEIGHT_BITS as i32 }>(x), _mm256_set1_epi32(most));
        let (column, row) = (whole(u, width - 2), whole(v, height - 2));
        let rest = |x, whole| _mm256_sub_epi32(x, _mm256_slli_epi32::<{ WEIGHT_BITS as i32 }>(whole));
        let index = _mm256_add_epi32(_mm256_mullo_epi32(row, _mm256_set1_epi32(width)), column);
        let (indices, fus, fvs) = (lanes(index), lanes(rest(u, column)), lanes(rest(v, row)));
        for lane in (0..LANES).filter(|lane| seen >> lane & 1 == 1) {
            // SAFETY: column and row are at most two less than the image's sides, so that both pairs lie in it.
            out[lane] = unsafe { one_pixel(image, indices[lane] as usize, fus[lane], fvs[lane]) };
        }
    }
    pixels
}

#[target_feature(enable = "avx2")]
fn lanes(vector: __m256i) -> [i32; LANES] {
    let mut lanes = [0; LANES];
    // SAFETY: the array holds eight words.
    unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast(), vector) };
    lanes
}

/// # Safety
/// `index` and the next pixel, and both below them, must be pixels of the image.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn one_pixel(image: &Raster, index: usize, fu: i32, fv: i32) -> [u8; 4] {
    // SAFETY: two pixels of four bytes each, which the caller vouches for.
    let pair = |at: usize| unsafe { _mm_loadl_epi64(image.pixels.as_ptr().add(at).cast()) };
    let four = _mm_unpacklo_epi64(pair(index), pair(index + image.width));
    // Left and right of each channel beside each other: r r g g b b a a, upper then lower.
    let beside = _mm_setr_epi8(0, 4, 1, 5, 2, 6, 3, 7, 8, 12, 9, 13, 10, 14, 11, 15);
    let one = ONE as i32;
    let across = _mm_maddubs_epi16(_mm_shuffle_epi8(four, beside), _mm_set1_epi16(((one - fu) | fu << 8) as i16));
    let below = _mm_unpacklo_epi16(across, _mm_unpackhi_epi64(across, across));
    let sum = _mm_madd_epi16(below, _mm_set1_epi32((one - fv) | fv << 16));
    let rounded = _mm_srli_epi32::<{ 2 * WEIGHT_BITS as i32 }>(_mm_add_epi32(sum, _mm_set1_epi32(one * one / 2)));
    let words = _mm_packus_epi32(rounded, rounded);
    _mm_cvtsi128_si32(_mm_packus_epi16(words, words)).to_le_bytes()
}
