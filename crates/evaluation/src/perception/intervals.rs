//! Estimates of rates with the intervals that hold the true ones in 95 of 100 cases.

use serde::Serialize;

/// An estimate, and the interval that holds what is estimated in 95 of 100 cases.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

/// The 97.5 % quantile of the normal distribution.
const Z: f64 = 1.959_963_985;

impl Interval {
    /// The share of `count` among `of`, with Wilson's score interval (1927). `None` of nothing.
    pub fn share(count: usize, of: usize) -> Option<Self> {
        let n = (of > 0).then_some(of as f64)?;
        let share = count as f64 / n;
        let (scale, centre) = (1.0 / (1.0 + Z * Z / n), share + Z * Z / (2.0 * n));
        let half = Z * libm::sqrt(share * (1.0 - share) / n + Z * Z / (4.0 * n * n));
        let end = |value: f64| (scale * value).clamp(0.0, 1.0);
        // Rounding must not put the estimate outside.
        Some(Self { value: share, low: end(centre - half).min(share), high: end(centre + half).max(share) })
    }

    /// The mean of a Poisson process of which `count` events were seen in `of` trials, with Byar's interval (Rothman and Boice 1979).
    /// `None` of no trial.
    pub fn rate(count: usize, of: usize) -> Option<Self> {
        let trials = (of > 0).then_some(of as f64)?;
        let cubed = |n: f64, z: f64| n * libm::pow((1.0 - 1.0 / (9.0 * n) + z / (3.0 * libm::sqrt(n))).max(0.0), 3.0);
        let n = count as f64;
        let low = if count == 0 { 0.0 } else { cubed(n, -Z) };
        Some(Self { value: n / trials, low: low / trials, high: cubed(n + 1.0, Z) / trials })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The figures are of statsmodels 0.14 (`proportion_confint(method="wilson")`) and of Garwood's exact interval.
    #[test]
    fn intervals_agree_with_published_ones() {
        let near = |found: f64, known: f64, within: f64| assert!((found - known).abs() < within, "{found} {known}");
        let share = Interval::share(8, 10).unwrap();
        near(share.low, 0.490_16, 1e-5);
        near(share.high, 0.943_32, 1e-5);
        let rate = Interval::rate(10, 5).unwrap();
        near(rate.low, 4.795 / 5.0, 0.01);
        near(rate.high, 18.39 / 5.0, 0.01);
        assert_eq!((Interval::share(0, 0), Interval::rate(3, 0)), (None, None));
    }

    proptest! {
        #[test]
        fn an_estimate_lies_in_its_interval(of in 1..100_000usize, part in 0.0..=1.0f64) {
            let count = (part * of as f64) as usize;
            for found in [Interval::share(count, of), Interval::rate(count, of)] {
                let Interval { value, low, high } = found.unwrap();
                prop_assert!(0.0 <= low && low <= value && value <= high && high.is_finite());
            }
        }
    }
}
