//! Sine, cosine and rounding for one pose, as exact as a rotation in 16 bits needs.
//!
//! Each pose needs them once for all its points; those of `libm` are more exact than necessary, and slower.

use core::f64::consts::{FRAC_2_PI, FRAC_PI_2};

/// Larger angles are left to `libm`, radians.
const ANGLE_LIMIT_RAD: f64 = 1e4;

/// Sine and cosine of an angle in radians, within 1e-11 of the true values (tested). NaN and infinities give NaN.
#[inline(always)]
pub(super) fn sin_cos(angle: f64) -> (f64, f64) {
    // NaN fails.
    let near = angle.abs() < ANGLE_LIMIT_RAD;
    if !near {
        return libm::sincos(angle);
    }
    let quarters = round(angle * FRAC_2_PI);
    let r = angle - f64::from(quarters) * FRAC_PI_2;
    let s = r * r;
    // Taylor series, whose remainder is below 1e-11 within an eighth of a turn.
    let sin = r
        * (1.0 + s * (-1.0 / 6.0 + s * (1.0 / 120.0 + s * (-1.0 / 5040.0 + s * (1.0 / 362_880.0 - s / 39_916_800.0)))));
    let cos = 1.0
        + s * (-0.5
            + s * (1.0 / 24.0
                + s * (-1.0 / 720.0 + s * (1.0 / 40_320.0 + s * (-1.0 / 3_628_800.0 + s / 479_001_600.0)))));
    let (sin, cos) = if quarters & 1 == 0 { (sin, cos) } else { (cos, -sin) };
    if quarters & 2 == 0 { (sin, cos) } else { (-sin, -cos) }
}

/// Rounds a value below 2^51 to the nearest integer modulo 2^32; halves go to the even neighbour.
#[inline(always)]
pub(super) fn round(value: f64) -> i32 {
    // Adding this number pushes the fraction out of the mantissa.
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
