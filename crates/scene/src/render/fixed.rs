//! Fast conversions of texture coordinates to fixed point and of colours to bytes, without checks of the range.

/// Bits of the fraction of a fixed-point coordinate.
pub(super) const FRACTION_BITS: u32 = 6;
/// 1.0 in fixed point.
pub(super) const ONE: u32 = 1 << FRACTION_BITS;

/// 1.5 * 2^23. After adding it to a float, the lowest bits of the sum hold the rounded integer.
const MAGIC: f32 = 12_582_912.0;

/// Integer part (modulo 2^16) and fraction (of [`ONE`]) of a coordinate.
///
/// The result is exact to 1/64 for |x| < 65536. Beyond that it is a wrong texel.
#[inline]
pub(super) fn fixed(x: f32) -> (u32, u32) {
    let bits = (x * ONE as f32 + MAGIC).to_bits();
    (bits << 10 >> (10 + FRACTION_BITS), bits % ONE)
}

/// The nearest integer from 0 to 255. The value must not be below 0.
#[inline]
pub(super) fn byte(value: f32) -> u8 {
    (value.min(255.0) + MAGIC).to_bits() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splits_into_texel_and_fraction() {
        assert_eq!(fixed(0.0), (0, 0));
        assert_eq!(fixed(5.25), (5, 16));
        assert_eq!(fixed(1023.5), (1023, 32));
        // Negative coordinates wrap like those of a tile whose side is a power of two.
        assert_eq!((fixed(-0.25).0 % 1024, fixed(-0.25).1), (1023, 48));
        assert_eq!(fixed(-1024.0).0 % 1024, 0);
    }

    #[test]
    fn bytes_round_and_saturate() {
        let all = [-1e-6, 0.4, 0.6, 127.5001, 254.6, 300.0].map(byte);
        assert_eq!(all, [0, 0, 1, 128, 255, 255]);
    }
}
