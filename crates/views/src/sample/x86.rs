//! The bilinear kernel for AVX2: eight pixels at a time, the four channels of each together. Same sums as the portable path.

use core::arch::x86_64::*;

use super::super::camera::AREA;
use super::super::raster::Raster;
use super::{ONE, Pixels, WEIGHT_BITS};

const LANES: usize = 8;
const BITS: i32 = WEIGHT_BITS as i32;

/// Reads the pixels of a cell.
///
/// # Safety
/// The processor must have AVX2, and `image` `width` x `height` pixels, at least two each way.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn read_cell(image: &Raster, us: &[f32; AREA], vs: &[f32; AREA]) -> Pixels {
    let mut pixels = [[0u8; 4]; AREA];
    let (width, height) = (image.width as i32, image.height as i32);
    let (one, half) = (_mm256_set1_ps(ONE as f32), _mm256_set1_ps(0.5));
    let (right, bottom) = (_mm256_set1_ps((width - 1) as f32), _mm256_set1_ps((height - 1) as f32));
    let zero = _mm256_setzero_ps();
    for ((us, vs), out) in us.chunks_exact(LANES).zip(vs.chunks_exact(LANES)).zip(pixels.chunks_exact_mut(LANES)) {
        // SAFETY: both chunks hold eight floats.
        let (u, v) = unsafe { (_mm256_loadu_ps(us.as_ptr()), _mm256_loadu_ps(vs.as_ptr())) };
        // The comparison is false for NaN.
        let within =
            |x, last| _mm256_and_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(x, zero), _mm256_cmp_ps::<_CMP_LE_OQ>(x, last));
        let inside = _mm256_and_ps(within(u, right), within(v, bottom));
        if _mm256_movemask_ps(inside) == 0 {
            continue;
        }
        // Coordinates outside read the first pixel and are cleared below.
        let fixed = |x| _mm256_cvttps_epi32(_mm256_add_ps(_mm256_mul_ps(_mm256_and_ps(x, inside), one), half));
        let (u, v) = (fixed(u), fixed(v));
        let whole = |x, most: i32| _mm256_min_epi32(_mm256_srli_epi32::<BITS>(x), _mm256_set1_epi32(most));
        let (column, row) = (whole(u, width - 2), whole(v, height - 2));
        let rest = |x, whole| _mm256_sub_epi32(x, _mm256_slli_epi32::<BITS>(whole));
        let index = _mm256_add_epi32(_mm256_mullo_epi32(row, _mm256_set1_epi32(width)), column);
        // Both weights of a lane side by side: as two words, and as two bytes, twice.
        let beside = |second, bits| {
            _mm256_or_si256(_mm256_sub_epi32(_mm256_set1_epi32(ONE as i32), second), _mm256_sll_epi32(second, bits))
        };
        let (byte, word) = (_mm_cvtsi32_si128(8), _mm_cvtsi32_si128(16));
        let across = beside(rest(u, column), word);
        let down = beside(rest(v, row), byte);
        let down = _mm256_or_si256(down, _mm256_sll_epi32(down, word));
        // SAFETY: column and row are at most the image's sides less two, so that both pairs lie in it.
        let mixed = unsafe { eight_pixels(image, lanes(index), across, down) };
        let mixed = _mm256_and_si256(mixed, _mm256_castps_si256(inside));
        // SAFETY: the chunk holds eight pixels of four bytes.
        unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), mixed) };
    }
    pixels
}

/// The eight 32-bit lanes of a vector.
#[inline]
#[target_feature(enable = "avx2")]
fn lanes(vector: __m256i) -> [i32; LANES] {
    let mut lanes = [0; LANES];
    // SAFETY: the array holds eight words.
    unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast(), vector) };
    lanes
}

/// Reads eight pixels. Pixels 0 to 3 are made in the lower half of the vectors, 4 to 7 in the upper one, two of each at a time.
///
/// # Safety
/// Each index and the next pixel, and both below them, must be pixels of the image.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn eight_pixels(image: &Raster, at: [i32; LANES], across: __m256i, down: __m256i) -> __m256i {
    // SAFETY: two pixels of four bytes each, which the caller guarantees.
    let pair = |at: usize| unsafe { _mm_loadl_epi64(image.pixels.as_ptr().add(at).cast()) };
    let pairs = |first: usize, below: usize| {
        let two = |i: usize| _mm_unpacklo_epi64(pair(at[i] as usize + below), pair(at[i + 1] as usize + below));
        _mm256_set_m128i(two(first + 4), two(first))
    };
    let columns = |first: usize| {
        let (upper, lower) = (pairs(first, 0), pairs(first, image.width));
        (_mm256_unpacklo_epi8(upper, lower), _mm256_unpackhi_epi8(upper, lower))
    };
    let ((first, second), (third, fourth)) = (columns(0), columns(2));
    let low = _mm256_packus_epi32(mixed::<0x00>(first, across, down), mixed::<0x55>(second, across, down));
    let high = _mm256_packus_epi32(mixed::<0xaa>(third, across, down), mixed::<0xff>(fourth, across, down));
    _mm256_packus_epi16(low, high)
}

/// One pixel in each half, from upper and lower bytes side by side, with the weights that `LANE` picks.
#[inline]
#[target_feature(enable = "avx2")]
fn mixed<const LANE: i32>(columns: __m256i, across: __m256i, down: __m256i) -> __m256i {
    let left_beside_right =
        _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15));
    let rows = _mm256_maddubs_epi16(columns, _mm256_shuffle_epi32::<LANE>(down));
    let sums = _mm256_madd_epi16(_mm256_shuffle_epi8(rows, left_beside_right), _mm256_shuffle_epi32::<LANE>(across));
    _mm256_srli_epi32::<{ 2 * BITS }>(_mm256_add_epi32(sums, _mm256_set1_epi32((ONE * ONE / 2) as i32)))
}
