//! Bilinear reading between pixels, in integers, so that every processor gives the same result.

// Vector instructions, behind a check that the processor has them.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
mod x86;

use super::camera::AREA;
use super::raster::Raster;

/// Weights are multiples of 1/64, finer than any map is accurate.
const WEIGHT_BITS: u32 = 6;
/// A weight of 1.
const ONE: u32 = 1 << WEIGHT_BITS;

/// The pixels of a cell.
pub(super) type Pixels = [[u8; 4]; AREA];

/// Reads at the coordinates `u`, `v` of a cell's pixels. Black and [`super::NOTHING`] outside of the image, and for NaN.
pub(super) fn read_cell(image: &Raster, u: &[f32; AREA], v: &[f32; AREA]) -> Pixels {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        assert!(image.is_readable(), "the vector path reads without further checks");
        // SAFETY: the processor has AVX2, and the image has the pixels that its size says, two or more each way.
        return unsafe { x86::read_cell(image, u, v) };
    }
    core::array::from_fn(|i| read(image, u[i], v[i]))
}

/// Reads one pixel. The vector path computes the same bits.
#[inline]
pub(super) fn read(image: &Raster, u: f32, v: f32) -> [u8; 4] {
    let (right, bottom) = ((image.width - 1) as f32, (image.height - 1) as f32);
    if !(u >= 0.0 && v >= 0.0 && u <= right && v <= bottom) {
        return [0; 4];
    }
    // The values are not negative: adding one half rounds.
    let (u, v) = ((u * ONE as f32 + 0.5) as u32, (v * ONE as f32 + 0.5) as u32);
    let column = (u >> WEIGHT_BITS).min(image.width as u32 - 2);
    let row = (v >> WEIGHT_BITS).min(image.height as u32 - 2);
    let (fu, fv) = (u - (column << WEIGHT_BITS), v - (row << WEIGHT_BITS));
    let at = row as usize * image.width + column as usize;
    let (upper, lower) = (&image.pixels[at..at + 2], &image.pixels[at + image.width..at + image.width + 2]);
    core::array::from_fn(|c| {
        let across = |pair: &[[u8; 4]]| u32::from(pair[0][c]) * (ONE - fu) + u32::from(pair[1][c]) * fu;
        ((across(upper) * (ONE - fv) + across(lower) * fv + ONE * ONE / 2) >> (2 * WEIGHT_BITS)) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{NOTHING, SURE};
    use proptest::prelude::*;

    fn ramp() -> Raster {
        let rgb: Vec<u8> = (0..64u8).flat_map(|i| [i % 8 * 30, i / 8 * 30, 100]).collect();
        Raster::from_rgb(8, 8, &rgb, &[true; 64]).expect("fits")
    }

    fn noise() -> Raster {
        let rgb: Vec<u8> = (0..23 * 17 * 3u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let shows: Vec<bool> = (0..23 * 17).map(|i| i % 7 != 3).collect();
        Raster::from_rgb(23, 17, &rgb, &shows).expect("fits")
    }

    #[test]
    fn what_lies_outside_is_nothing() {
        let image = ramp();
        for (u, v) in [(-0.01, 1.0), (7.01, 1.0), (f32::NAN, 1.0), (3.0, f32::INFINITY), (3.0, f32::NEG_INFINITY)] {
            assert_eq!(read(&image, u, v)[3], NOTHING, "{u} {v}");
        }
        assert_eq!(read(&image, 7.0, 7.0), [210, 210, 100, SURE]);
    }

    proptest! {
        #[test]
        fn a_plane_is_read_exactly(u in 0.0..7.0f32, v in 0.0..7.0f32) {
            let pixel = read(&ramp(), u, v);
            prop_assert!((f32::from(pixel[0]) - 30.0 * u).abs() <= 0.75);
            prop_assert!((f32::from(pixel[1]) - 30.0 * v).abs() <= 0.75);
            prop_assert_eq!([pixel[2], pixel[3]], [100, SURE]);
        }

        #[test]
        fn the_vector_path_reads_the_same_bits(
            places in proptest::collection::vec((-3.0..26.0f32, -3.0..20.0f32), AREA),
            odd in 0..AREA,
        ) {
            let image = noise();
            let mut u: [f32; AREA] = core::array::from_fn(|i| places[i].0);
            let v: [f32; AREA] = core::array::from_fn(|i| places[i].1.round());
            (u[odd], u[(odd + 1) % 64], u[(odd + 2) % 64]) = (f32::NAN, f32::INFINITY, 22.0);
            let plain: Pixels = core::array::from_fn(|i| read(&image, u[i], v[i]));
            prop_assert_eq!(read_cell(&image, &u, &v), plain);
        }
    }
}
