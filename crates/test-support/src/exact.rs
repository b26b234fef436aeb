//! Numbers of 256 bits, the oracle of formulas: functions of them are rounded correctly. The unit tests of the crate share
//! it.

use dashu_float::{FBig, round::mode::HalfEven};

pub type Exact = FBig<HalfEven, 2>;

const BITS: usize = 256;

pub fn exact(value: f64) -> Exact {
    Exact::try_from(value).expect("a finite number").with_precision(BITS).value()
}

pub fn rounded(value: &Exact) -> f64 {
    value.to_f64().value()
}
