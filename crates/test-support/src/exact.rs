//! Numbers of 256 bits as an oracle for formulas: each function of them is rounded correctly to that precision.

use dashu_float::{FBig, round::mode::HalfEven};

/// A binary floating point number of 256 bits that rounds half to even.
pub type Exact = FBig<HalfEven, 2>;

/// Precision of an [`Exact`], bits; an `f64` has 53.
const BITS: usize = 256;

/// Converts a number to 256 bits, which loses nothing.
///
/// # Panics
///
/// Panics if the number is infinite or not a number.
pub fn exact(value: f64) -> Exact {
    Exact::try_from(value).expect("a finite number").with_precision(BITS).value()
}

/// Rounds a result to the nearest `f64`.
pub fn rounded(value: &Exact) -> f64 {
    value.to_f64().value()
}
