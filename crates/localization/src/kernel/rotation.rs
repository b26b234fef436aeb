//! Sine, cosine and rounding for one pose, as exact as a rotation in 16 bits can tell: each pose needs one of them for all its
//! points, and `libm`'s are more exact and slower than that.

use core::f64::consts::{FRAC_2_PI, FRAC_PI_2};

/// Angles beyond are left to `libm`.
const FARTHEST: f64 = 1e4;

/// Within 1e-11 of the true ones (tested). NaN and infinities give NaN.
#[inline(always)]
pub(super) fn sin_cos(angle: f64) -> (f64, f64) {
    // NaN fails.
    let near = angle.abs() < FARTHEST;
    if !near {
        return libm::sincos(angle);
    }
    let quarters = round(angle * FRAC_2_PI);
    let r = angle - f64::from(quarters) * FRAC_PI_2;
    let s = r * r;
    // Taylor's, which ends below 1e-11 within an eighth of a turn.
    let sin = r
        * (1.0 + s * (-1.0 / 6.0 + s * (1.0 / 120.0 + s * (-1.0 / 5040.0 + s * (1.0 / 362_880.0 - s / 39_916_800.0)))));
    let cos = 1.0
        + s * (-0.5
            + s * (1.0 / 24.0
                + s * (-1.0 / 720.0 + s * (1.0 / 40_320.0 + s * (-1.0 / 3_628_800.0 + s / 479_001_600.0)))));
    let (sin, cos) = if quarters & 1 == 0 { (sin, cos) } else { (cos, -sin) };
    if quarters & 2 == 0 { (sin, cos) } else { (-sin, -cos) }
}

/// The nearest whole number modulo 2^32, of values below 2^51; halves go to the even neighbour.
#[inline(always)]
pub(super) fn round(value: f64) -> i32 {
    // Adding pushes everything behind the point out of the mantissa.
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    (value + SHIFT).to_bits() as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sine_and_cosine_are_those_of_libm(angle in prop_oneof![-10.0..10.0f64, -2e4..2e4f64]) {
            let ((sin, cos), exact) = (sin_cos(angle), libm::sincos(angle));
            prop_assert!((sin - exact.0).abs() < 1e-11 && (cos - exact.1).abs() < 1e-11, "{sin} {cos} {exact:?}");
        }

        #[test]
        fn rounding_is_to_the_nearest_modulo_2_to_the_32(value in -1e15..1e15f64) {
            let exact = libm::round(value);
            prop_assume!((value - libm::trunc(value)).abs() != 0.5);
            prop_assert_eq!(round(value), exact as i64 as i32);
        }
    }
}
