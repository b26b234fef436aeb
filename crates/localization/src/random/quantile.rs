//! Quantiles of the normal distribution: Wichura, "Algorithm AS 241", Applied Statistics 37 (1988), PPND16, relative
//! error about 1e-16. For six probabilities of seven it needs neither a logarithm nor a root.

use realitysim_geometry::multiversioned;

/// Coefficients of numerator and denominator for probabilities near one half.
const CENTRE: ([f64; 8], [f64; 8]) = (
    [
        3.387_132_872_796_366_5,
        133.141_667_891_784_38,
        1_971.590_950_306_551_3,
        13_731.693_765_509_46,
        45_921.953_931_549_87,
        67_265.770_927_008_7,
        33_430.575_583_588_13,
        2_509.080_928_730_122_7,
    ],
    [
        1.0,
        42.313_330_701_600_91,
        687.187_007_492_057_9,
        5_394.196_021_424_751,
        21_213.794_301_586_597,
        39_307.895_800_092_71,
        28_729.085_735_721_943,
        5_226.495_278_852_854,
    ],
);
/// Coefficients of numerator and denominator between centre and tails.
const SIDES: ([f64; 8], [f64; 8]) = (
    [
        1.423_437_110_749_683_5,
        4.630_337_846_156_546,
        5.769_497_221_460_691,
        3.647_848_324_763_204_5,
        1.270_458_252_452_368_4,
        0.241_780_725_177_450_6,
        0.022_723_844_989_269_184,
        7.745_450_142_783_414e-4,
    ],
    [
        1.0,
        2.053_191_626_637_759,
        1.676_384_830_183_803_8,
        0.689_767_334_985_1,
        0.148_103_976_427_480_08,
        0.015_198_666_563_616_457,
        5.475_938_084_995_345e-4,
        1.050_750_071_644_416_9e-9,
    ],
);
/// Coefficients of numerator and denominator in the far tails.
const TAILS: ([f64; 8], [f64; 8]) = (
    [
        6.657_904_643_501_103,
        5.463_784_911_164_114,
        1.784_826_539_917_291_3,
        0.296_560_571_828_504_87,
        0.026_532_189_526_576_124,
        0.001_242_660_947_388_078_4,
        2.711_555_568_743_487_6e-5,
        2.010_334_399_292_288_1e-7,
    ],
    [
        1.0,
        0.599_832_206_555_888,
        0.136_929_880_922_735_8,
        0.014_875_361_290_850_615,
        7.868_691_311_456_133e-4,
        1.846_318_317_510_054_8e-5,
        1.421_511_758_316_446e-7,
        2.044_263_103_389_939_7e-15,
    ],
);

/// Distance from one half up to which a probability is central: its quantile is a plain ratio of polynomials.
const CENTRE_REACH: f64 = 0.425;
const CENTRE_REACH_SQUARED: f64 = 0.180_625;

/// The value that a standard normal number stays below with probability `p`, 0 < p < 1.
pub(super) fn normal(p: f64) -> f64 {
    if is_central(p) { central(p) } else { outer(p) }
}

/// [`normal`] of many probabilities, with the same bits: central ones are computed by vector instructions.
pub(super) fn normals<const N: usize>(ps: &[f64; N]) -> [f64; N] {
    let mut normals = multiversioned!(const N: usize, |ps: &[f64; N]| -> [f64; N] {
        let mut normals = [0.0; N];
        for (normal, p) in normals.iter_mut().zip(ps) {
            *normal = central(*p);
        }
        normals
    });
    // A branch on `is_central` would be mispredicted one time of seven, so the indices are collected without one.
    let (mut outer_ones, mut count) = ([0u16; N], 0);
    for (index, p) in ps.iter().enumerate() {
        outer_ones[count] = index as u16;
        count += usize::from(!is_central(*p));
    }
    for index in outer_ones[..count].iter().map(|index| usize::from(*index)) {
        normals[index] = outer(ps[index]);
    }
    normals
}

#[inline(always)]
fn is_central(p: f64) -> bool {
    (p - 0.5).abs() <= CENTRE_REACH
}

/// The quantile of a central probability.
#[inline(always)]
fn central(p: f64) -> f64 {
    let off = p - 0.5;
    off * ratio(&CENTRE, CENTRE_REACH_SQUARED - off * off)
}

/// The quantile of a probability that is not central.
fn outer(p: f64) -> f64 {
    let off = p - 0.5;
    let tail = libm::sqrt(-libm::log(if off < 0.0 { p } else { 1.0 - p }));
    let size = if tail <= 5.0 { ratio(&SIDES, tail - 1.6) } else { ratio(&TAILS, tail - 5.0) };
    size.copysign(off)
}

/// The ratio of two polynomials in `x`.
#[inline(always)]
fn ratio((above, below): &([f64; 8], [f64; 8]), x: f64) -> f64 {
    let polynomial = |coefficients: &[f64; 8]| coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c);
    polynomial(above) / polynomial(below)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_at_a_time_are_the_same_bits() {
        let ps: [f64; 257] = core::array::from_fn(|i| (i as f64 + 0.5) / 257.0);
        assert_eq!(normals(&ps).map(f64::to_bits), ps.map(|p| normal(p).to_bits()));
    }

    #[test]
    fn the_distribution_function_takes_quantiles_back() {
        let below = |x: f64| 0.5 * libm::erfc(-x / core::f64::consts::SQRT_2);
        let mut worst = 0.0f64;
        for i in 1..20_000 {
            let p = f64::from(i) / 20_000.0;
            worst = worst.max((below(normal(p)) - p).abs() / p.min(1.0 - p));
        }
        for exponent in 5..=11 {
            let p = libm::pow(10.0, f64::from(-exponent));
            worst = worst.max((below(normal(p)) - p).abs() / p);
            // Not exactly antisymmetric, since 1 - p is rounded.
            assert!((normal(p) + normal(1.0 - p)).abs() < 1e-4, "{p}");
        }
        assert!(worst < 1e-12, "{worst}");
        assert_eq!(normal(0.5), 0.0);
    }
}
