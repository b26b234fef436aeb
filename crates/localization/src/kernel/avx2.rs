//! The AVX2 path: eight points side by side.

use core::arch::x86_64::*;
use std::sync::LazyLock;

use super::{CELL_BIT, FULL, LANES, LAST, Placement, word};
use realitysim_vision::ground::SIDE;

/// How the table is read. Which way is faster depends on the processor; the bits are the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LookUp {
    /// By the gather instruction.
    Gather,
    /// By one load for each lane.
    Loads,
}

impl LookUp {
    /// The faster way on this processor.
    pub(super) fn of_this_processor() -> Self {
        static CHOSEN: LazyLock<LookUp> = LazyLock::new(LookUp::chosen);
        *CHOSEN
    }

    /// Chooses the gather instruction on Intel processors with AVX-VNNI (Alder Lake, Sapphire Rapids and later), where it takes two thirds
    /// of the time of single loads. Earlier ones are patched against "Gather Data Sampling" (INTEL-SA-00828), which makes gathers
    /// several times slower, and AMD's gather one element at a time.
    fn chosen() -> Self {
        #[allow(unused_unsafe, reason = "older compilers require `unsafe` here")]
        // SAFETY: every x86-64 processor has `cpuid`.
        let vendor = unsafe { __cpuid(0) };
        let is_intel = [vendor.ebx, vendor.edx, vendor.ecx].map(u32::to_le_bytes).as_flattened() == b"GenuineIntel";
        if is_intel && std::arch::is_x86_feature_detected!("avxvnni") { Self::Gather } else { Self::Loads }
    }
}

/// Sums the interpolated levels of groups of points.
///
/// # Safety
/// The processor must have AVX2 and `quads` must hold SIDE x SIDE words.
pub(super) unsafe fn sum(look_up: LookUp, quads: &[u32], groups: &[[[i16; 2]; LANES]], placement: Placement) -> u64 {
    // SAFETY: as the caller says.
    unsafe {
        match look_up {
            LookUp::Gather => sum_with::<true>(quads, groups, placement),
            LookUp::Loads => sum_with::<false>(quads, groups, placement),
        }
    }
}

/// [`sum`] for one way of reading the table.
///
/// # Safety
/// As for [`sum`].
#[target_feature(enable = "avx2")]
unsafe fn sum_with<const GATHER: bool>(quads: &[u32], groups: &[[[i16; 2]; LANES]], p: Placement) -> u64 {
    let pair = |low: i16, high: i16| _mm256_set1_epi32(i32::from(low) & 0xffff | i32::from(high) << 16);
    let (to_u, to_v) = (pair(p.cos, p.sin), pair(-p.sin, p.cos));
    let (u0, v0) = (_mm256_set1_epi32(p.u0), _mm256_set1_epi32(p.v0));
    let shift = _mm_cvtsi32_si128(p.shift as i32);
    let (last, side) = (_mm256_set1_epi32(LAST), _mm256_set1_epi32(SIDE as i32));
    // Shuffles that copy the byte with the six fraction bits to all four bytes of a lane, and to the lower byte of each pair.
    let bytes = |of_word: i32| {
        let (a, b) = (of_word, of_word + 0x0404_0404);
        let (c, d) = (of_word + 0x0808_0808, of_word + 0x0c0c_0c0c);
        _mm256_setr_epi32(a, b, c, d, a, b, c, d)
    };
    let (to_four, to_two) = (bytes(0x0101_0101), bytes(0x8001_8001u32 as i32));
    let (within_four, within_two) = (_mm256_set1_epi8(FULL as i8), _mm256_set1_epi16(FULL as i16));
    let (flip_four, flip_two) = (_mm256_set1_epi16(FULL as i16), _mm256_set1_epi32(FULL));
    let mut sums = _mm256_setzero_si256();
    for group in groups {
        // SAFETY: a group is eight pairs of 16 bits.
        let places = unsafe { _mm256_loadu_si256(group.as_ptr().cast()) };
        let u = _mm256_add_epi32(_mm256_madd_epi16(places, to_u), u0);
        let v = _mm256_add_epi32(_mm256_madd_epi16(places, to_v), v0);
        let u = _mm256_min_epu32(_mm256_srl_epi32(u, shift), last);
        let v = _mm256_min_epu32(_mm256_srl_epi32(v, shift), last);
        let (column, row) = (_mm256_srli_epi32::<{ CELL_BIT as i32 }>(u), _mm256_srli_epi32::<{ CELL_BIT as i32 }>(v));
        let index = _mm256_add_epi32(_mm256_madd_epi16(row, side), column);
        // SAFETY: column and row lie in 0..SIDE, so every index lies in the table.
        let quad = unsafe { if GATHER { gather(quads, index) } else { load(quads, index) } };
        let of_u = _mm256_xor_si256(_mm256_and_si256(_mm256_shuffle_epi8(u, to_four), within_four), flip_four);
        let of_v = _mm256_xor_si256(_mm256_and_si256(_mm256_shuffle_epi8(v, to_two), within_two), flip_two);
        sums = _mm256_add_epi32(sums, _mm256_madd_epi16(_mm256_maddubs_epi16(quad, of_u), of_v));
    }
    let mut lanes = [0u32; LANES];
    // SAFETY: `lanes` holds eight words.
    unsafe { _mm256_storeu_si256(lanes.as_mut_ptr().cast(), sums) };
    lanes.iter().map(|lane| u64::from(*lane)).sum()
}

/// Reads eight words by the gather instruction.
///
/// # Safety
/// The processor must have AVX2 and every lane of `index` lie in `quads`.
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn gather(quads: &[u32], index: __m256i) -> __m256i {
    // SAFETY: as the caller says.
    unsafe { _mm256_i32gather_epi32::<4>(quads.as_ptr().cast(), index) }
}

/// Reads eight words by single loads.
///
/// # Safety
/// As for [`gather`].
#[target_feature(enable = "avx2")]
#[inline]
unsafe fn load(quads: &[u32], index: __m256i) -> __m256i {
    let (low, high) = (_mm256_castsi256_si128(index), _mm256_extracti128_si256::<1>(index));
    let (ab, cd) = (_mm_cvtsi128_si64(low) as u64, _mm_extract_epi64::<1>(low) as u64);
    let (ef, gh) = (_mm_cvtsi128_si64(high) as u64, _mm_extract_epi64::<1>(high) as u64);
    // SAFETY: as the caller says. (The `map` of an array would be a call of code compiled without AVX2.)
    unsafe {
        _mm256_setr_epi32(
            word(quads, ab),
            word(quads, ab >> 32),
            word(quads, cd),
            word(quads, cd >> 32),
            word(quads, ef),
            word(quads, ef >> 32),
            word(quads, gh),
            word(quads, gh >> 32),
        )
    }
}
