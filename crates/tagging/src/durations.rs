//! How long frames took: quantiles of any number of durations in fixed memory.

use super::report::Quantiles;

/// Counts in bins of equal ratio: a quantile is right to 1 %, the maximum is exact.
#[derive(Clone, Debug)]
pub struct Durations {
    bins: Vec<u64>,
    count: u64,
    max_ms: f64,
}

/// The first bin's lower end; what is shorter counts there.
const LEAST_MS: f64 = 1e-3;
/// From the lower end of a bin to its upper: its middle is less than 1 % from either.
const RATIO: f64 = 1.02;
/// Up to an hour and more; what is longer counts in the last.
const BINS: usize = 1120;

impl Default for Durations {
    fn default() -> Self {
        Self { bins: vec![0; BINS], count: 0, max_ms: 0.0 }
    }
}

impl Durations {
    pub fn note(&mut self, milliseconds: f64) {
        // What is no number or below zero becomes the least.
        let bin = libm::log(milliseconds.max(LEAST_MS) / LEAST_MS) / libm::log(RATIO);
        self.bins[(bin as usize).min(BINS - 1)] += 1;
        self.count += 1;
        self.max_ms = self.max_ms.max(milliseconds);
    }

    pub fn quantiles(&self) -> Quantiles {
        Quantiles { p50: self.quantile(0.5), p99: self.quantile(0.99), max: self.max_ms }
    }

    /// The middle of the bin that holds the value of this rank, as a ratio.
    fn quantile(&self, share: f64) -> f64 {
        let rank = (self.count.saturating_sub(1) as f64 * share).round() as u64;
        let mut below = 0;
        for (bin, count) in self.bins.iter().enumerate() {
            below += count;
            if below > rank {
                let middle = LEAST_MS * libm::pow(RATIO, bin as f64 + 0.5);
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
        assert!(odd.p50 <= 1.01 * LEAST_MS && odd.max == 1e12, "{odd:?}");
    }
}
