//! Reads a half-resolution image at every cell of the ground table.
//!
//! Values are interpolated bilinearly, the two surface bits are those of the nearest pixel. The AVX2 path gives the same bits as the
//! plain path.

// The AVX2 path gathers pixels without checks; the size of the image is checked once.
#![allow(unsafe_code)]

use super::WorkingScale;
use super::ground::SIDE;
use super::ground_map::{BLOCK, BLOCKS, GroundMap};

/// A half-resolution image of at least 2 x 2 pixels, row by row, with the surface in the two lowest bits of each value.
pub(super) struct SampledImage<'a> {
    pub(super) image: &'a [i16],
    pub(super) width: usize,
    pub(super) height: usize,
}

/// Number of cells that are read together. They lie in one row, across a pair of blocks, so that they are written together.
const LANES: usize = 8;

/// Reads the image at each cell into `shown`, row by row. Cells that the camera does not see keep their value.
pub(super) fn read(reading: &SampledImage, map: &GroundMap, to_working: WorkingScale, shown: &mut [i16]) {
    // The AVX2 path reads without further checks, and counts pixels in 32 bits.
    assert!(reading.width >= 2 && reading.height >= 2, "each cell is read from 2 x 2 pixels");
    assert_eq!(Some(reading.image.len()), reading.width.checked_mul(reading.height), "the image has another size");
    assert!(i32::try_from(reading.image.len()).is_ok(), "the image has more pixels than 32 bits count");
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the processor has AVX2; the image has the stated size, which is at least 2 x 2.
        return unsafe { x86::read(reading, map, to_working, shown) };
    }
    for_each_eight(map, to_working, shown, |us, vs| plain(reading, us, vs));
}

/// Calls `eight` with the half-resolution pixel coordinates of eight cells at a time, and stores what it returns.
#[inline(always)]
fn for_each_eight(
    map: &GroundMap,
    to_working: WorkingScale,
    shown: &mut [i16],
    eight: impl Fn(&[f32; LANES], &[f32; LANES]) -> [i16; LANES],
) {
    // Half-resolution coordinates: pixel i covers working pixels 2i and 2i + 1.
    let scale = (to_working.factor * 0.5) as f32;
    let offset = (to_working.offset * 0.5 - 0.25) as f32;
    let (mut us, mut vs) = ([0.0f32; LANES], [0.0f32; LANES]);
    for block_row in 0..BLOCKS {
        // A pair of blocks has eight cells in each row.
        for block_column in (0..BLOCKS).step_by(LANES / BLOCK) {
            let pair = [map.corners(block_row, block_column), map.corners(block_row, block_column + 1)];
            if pair.iter().all(Option::is_none) {
                continue;
            }
            let pair = pair.map(|corners| corners.map(|corners| corners.map(|c| c.map(|x| x * scale + offset))));
            let first = block_row * BLOCK * SIDE + block_column * BLOCK;
            for row in 0..BLOCK {
                let down = row as f32 * (1.0 / BLOCK as f32);
                for (half, corners) in pair.iter().enumerate() {
                    let Some([a, b, c, d]) = corners else { continue };
                    let between = |i: usize| {
                        let (left, right) = (a[i] + (c[i] - a[i]) * down, b[i] + (d[i] - b[i]) * down);
                        (left, (right - left) * (1.0 / BLOCK as f32))
                    };
                    let ((u, du), (v, dv)) = (between(0), between(1));
                    for column in 0..BLOCK {
                        us[half * BLOCK + column] = u + du * column as f32;
                        vs[half * BLOCK + column] = v + dv * column as f32;
                    }
                }
                let values = eight(&us, &vs);
                let cells = &mut shown[first + row * SIDE..][..LANES];
                match pair {
                    [Some(_), Some(_)] => cells.copy_from_slice(&values),
                    [Some(_), None] => cells[..BLOCK].copy_from_slice(&values[..BLOCK]),
                    _ => cells[BLOCK..].copy_from_slice(&values[BLOCK..]),
                }
            }
        }
    }
}

/// Interpolates at eight pixel coordinates, without vector instructions.
fn plain(reading: &SampledImage, us: &[f32; LANES], vs: &[f32; LANES]) -> [i16; LANES] {
    let SampledImage { image, width, height } = *reading;
    let (last_u, last_v) = ((width - 1) as f32, (height - 1) as f32);
    core::array::from_fn(|lane| {
        let (u, v) = (clamped(us[lane], last_u), clamped(vs[lane], last_v));
        let (iu, iv) = ((u as usize).min(width - 2), (v as usize).min(height - 2));
        let (fu, fv) = (u - iu as f32, v - iv as f32);
        let at = iv * width + iu;
        let (upper, lower) = ([image[at], image[at + 1]], [image[at + width], image[at + width + 1]]);
        let nearest = if fv >= 0.5 { lower } else { upper }[usize::from(fu >= 0.5)];
        // The surface bits, which are not masked here, add less than a quarter of a gray level.
        let blend = |pair: [i16; 2]| f32::from(pair[0]) + (f32::from(pair[1]) - f32::from(pair[0])) * fu;
        let (upper, lower) = (blend(upper), blend(lower));
        ((upper + (lower - upper) * fv) as i16 & !3) | (nearest & 3)
    })
}

/// Clamps to [0, `last`]; NaN becomes 0.
fn clamped(value: f32, last: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < last { value } else { last }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use core::arch::x86_64::*;

    use super::{GroundMap, LANES, SampledImage, WorkingScale, for_each_eight};

    /// Does the same as [`super::read`].
    ///
    /// # Safety
    /// The processor must have AVX2, and the image `width` x `height` pixels, at least 2 x 2.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn read(reading: &SampledImage, map: &GroundMap, to_working: WorkingScale, shown: &mut [i16]) {
        // SAFETY: guaranteed by the caller.
        for_each_eight(map, to_working, shown, |us, vs| unsafe { eight(reading, us, vs) });
    }

    /// Does the same as [`super::plain`], to the bit.
    ///
    /// # Safety
    /// The processor must have AVX2, and the image `width` x `height` pixels, at least 2 x 2.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn eight(reading: &SampledImage, us: &[f32; LANES], vs: &[f32; LANES]) -> [i16; LANES] {
        let SampledImage { image, width, height } = *reading;
        let zero = _mm256_setzero_ps();
        let (last_u, last_v) = (_mm256_set1_ps((width - 1) as f32), _mm256_set1_ps((height - 1) as f32));
        // SAFETY: both arrays hold eight floats.
        let (u, v) = unsafe { (_mm256_loadu_ps(us.as_ptr()), _mm256_loadu_ps(vs.as_ptr())) };
        // If an operand is NaN, these instructions return the second one, which is a number.
        let u = _mm256_min_ps(_mm256_max_ps(u, zero), last_u);
        let v = _mm256_min_ps(_mm256_max_ps(v, zero), last_v);
        let iu = _mm256_min_epi32(_mm256_cvttps_epi32(u), _mm256_set1_epi32(width as i32 - 2));
        let iv = _mm256_min_epi32(_mm256_cvttps_epi32(v), _mm256_set1_epi32(height as i32 - 2));
        let (fu, fv) = (_mm256_sub_ps(u, _mm256_cvtepi32_ps(iu)), _mm256_sub_ps(v, _mm256_cvtepi32_ps(iv)));
        let at = _mm256_add_epi32(_mm256_mullo_epi32(iv, _mm256_set1_epi32(width as i32)), iu);
        let below = _mm256_add_epi32(at, _mm256_set1_epi32(width as i32));
        // SAFETY: row <= height - 2 and column <= width - 2, so that the pair of pixels at `below` ends within the image.
        let (upper, lower) = unsafe {
            let pixels = image.as_ptr().cast::<i32>();
            (_mm256_i32gather_epi32::<2>(pixels, at), _mm256_i32gather_epi32::<2>(pixels, below))
        };
        let left = |pair: __m256i| _mm256_srai_epi32::<16>(_mm256_slli_epi32::<16>(pair));
        let right = |pair: __m256i| _mm256_srai_epi32::<16>(pair);
        let blend = |pair: __m256i| {
            let (a, b) = (_mm256_cvtepi32_ps(left(pair)), _mm256_cvtepi32_ps(right(pair)));
            _mm256_add_ps(a, _mm256_mul_ps(_mm256_sub_ps(b, a), fu))
        };
        let half = _mm256_set1_ps(0.5);
        let is_lower = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GE_OQ>(fv, half));
        let is_right = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GE_OQ>(fu, half));
        let pair = _mm256_blendv_epi8(upper, lower, is_lower);
        let nearest = _mm256_blendv_epi8(left(pair), right(pair), is_right);
        let (upper, lower) = (blend(upper), blend(lower));
        let value = _mm256_cvttps_epi32(_mm256_add_ps(upper, _mm256_mul_ps(_mm256_sub_ps(lower, upper), fv)));
        let three = _mm256_set1_epi32(3);
        let value = _mm256_or_si256(_mm256_andnot_si256(three, value), _mm256_and_si256(nearest, three));
        let packed = _mm_packs_epi32(_mm256_castsi256_si128(value), _mm256_extracti128_si256::<1>(value));
        let mut values = [0i16; LANES];
        // SAFETY: `values` holds eight words of 16 bits.
        unsafe { _mm_storeu_si128(values.as_mut_ptr().cast(), packed) };
        values
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read_nothing_of(width: usize, height: usize) {
        let image = vec![0; width * height];
        let mut shown = vec![0; SIDE * SIDE];
        read(&SampledImage { image: &image, width, height }, &GroundMap::default(), WorkingScale::new(1), &mut shown);
    }

    #[test]
    #[should_panic(expected = "2 x 2 pixels")]
    fn an_image_of_one_column_is_not_read() {
        read_nothing_of(1, 8);
    }

    #[test]
    #[should_panic(expected = "2 x 2 pixels")]
    fn an_image_of_one_row_is_not_read() {
        read_nothing_of(8, 1);
    }

    proptest! {
        #[test]
        fn both_paths_read_the_same_bits(
            width in 2usize..40, height in 2usize..40, seed in any::<u32>(),
            us in proptest::array::uniform8(-3.0f32..45.0), vs in proptest::array::uniform8(-3.0f32..45.0),
        ) {
            let image: Vec<i16> = (0..width * height)
                .map(|i| (((i as u32).wrapping_mul(2_654_435_761) ^ seed) >> 16) as i16 / 8)
                .collect();
            let reading = SampledImage { image: &image, width, height };
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2, and the image has the stated size.
                prop_assert_eq!(unsafe { x86::eight(&reading, &us, &vs) }, plain(&reading, &us, &vs));
            }
        }
    }
}
