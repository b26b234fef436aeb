//! Quantiles of any number of durations in fixed memory.

use super::report::Quantiles;

/// A histogram of durations with bins of equal ratio. Quantiles are right to 1 %, the maximum is exact.
#[derive(Clone, Debug)]
pub struct Durations {
    bins: Vec<u64>,
    count: u64,
    max_ms: f64,
}

/// Lower end of the first bin, milliseconds. Shorter durations count there.
const MIN_MS: f64 = 1e-3;
/// Ratio of the upper to the lower end of a bin, so that its middle is less than 1 % from either end.
const RATIO: f64 = 1.02;
/// Number of bins, which reach beyond one hour. Longer durations count in the last one.
const BINS: usize = 1120;

impl Default for Durations {
    fn default() -> Self {
        Self { bins: vec![0; BINS], count: 0, max_ms: 0.0 }
    }
}

impl Durations {
    /// Counts a duration.
    pub fn note(&mut self, milliseconds: f64) {
        // NaN and negative durations count in the first bin.
        let bin = libm::log(milliseconds.max(MIN_MS) / MIN_MS) / libm::log(RATIO);
        self.bins[(bin as usize).min(BINS - 1)] += 1;
        self.count += 1;
        self.max_ms = self.max_ms.max(milliseconds);
    }

    /// Median, 99th percentile and maximum, milliseconds; 0 if there is no duration.
    pub fn quantiles(&self) -> Quantiles {
        Quantiles { p50: self.quantile(0.5), p99: self.quantile(0.99), max: self.max_ms }
    }

    /// The quantile of this share, milliseconds: the geometric middle of the bin that holds the value of its rank.
    fn quantile(&self, share: f64) -> f64 {
        let rank = (self.count.saturating_sub(1) as f64 * share).round() as u64;
        let mut below = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            below += count;
            if below > rank {
                let middle = MIN_MS * libm::pow(RATIO, bin as f64 + 0.5);
                return middle.min(self.max_ms);
            }
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[f64]) -> Quantiles {
        let mut durations = Durations::default();
        values.iter().for_each(|value| durations.note(*value));
        durations.quantiles()
    }

    #[test]
    fn quantiles_are_right_to_one_percent_and_the_maximum_exactly() {
        // Six decades, shuffled.
        let values: Vec<f64> = (0..9973u64).map(|i| libm::pow(10.0, (i * 4099 % 9973) as f64 / 1662.0 - 2.0)).collect();
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        let found = of(&values);
        for (value, share) in [(found.p50, 0.5), (found.p99, 0.99)] {
            let exact = sorted[(9972.0 * share) as usize];
            assert!((value / exact - 1.0).abs() < 0.012, "{value} is not {exact}");
        }
        assert_eq!(found.max, sorted[9972]);
    }

    #[test]
    fn one_value_is_all_of_them_and_none_is_zero() {
        assert_eq!((of(&[]).p50, of(&[]).max), (0.0, 0.0));
        let one = of(&[7.3]);
        assert!((one.p50 / 7.3 - 1.0).abs() < 0.01 && one.p50 == one.p99 && one.max == 7.3, "{one:?}");
    }

    #[test]
    fn what_no_frame_takes_is_counted_all_the_same() {
        let odd = of(&[f64::NAN, -1.0, 0.0, 1e-9, 1e12]);
        assert!(odd.p50 <= 1.01 * MIN_MS && odd.max == 1e12, "{odd:?}");
    }
}
