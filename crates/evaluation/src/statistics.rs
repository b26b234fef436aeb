//! Summary statistics of error samples.

use serde::Serialize;

/// Mean, quantiles and maximum of a sample, in the unit of its values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Arithmetic mean.
    pub mean: f64,
    /// Median.
    pub median: f64,
    /// 95 % quantile.
    pub p95: f64,
    /// Largest value.
    pub max: f64,
}

impl Summary {
    /// Summarizes the finite values; all fields are zero if there are none.
    pub fn of(values: &[f64]) -> Self {
        let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
        if sorted.is_empty() {
            return Self::default();
        }
        sorted.sort_by(f64::total_cmp);
        Self {
            mean: sorted.iter().sum::<f64>() / sorted.len() as f64,
            median: quantile(&sorted, 0.5),
            p95: quantile(&sorted, 0.95),
            max: sorted[sorted.len() - 1],
        }
    }
}

/// Returns the quantile `share` (0 to 1) of sorted values, 0 if there are none.
///
/// Interpolates linearly between the two nearest values: type 7 of Hyndman and Fan (1996), as NumPy does.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let rank = share * last as f64;
    let low = rank.floor() as usize;
    let high = (low + 1).min(last);
    sorted[low] + (sorted[high] - sorted[low]) * (rank - low as f64)
}

/// Root mean square; 0 of nothing.
pub fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0usize), |(sum, count), value| (sum + value * value, count + 1));
    libm::sqrt(sum / count.max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn summaries_agree_with_numpy() {
        let s = Summary::of(&[4.0, 1.0, f64::NAN, 2.0, 10.0]);
        assert_eq!((s.mean, s.median, s.max), (4.25, 3.0, 10.0));
        assert!((s.p95 - 9.1).abs() < 1e-12);
        assert_eq!(Summary::of(&[]), Summary::default());
    }
}
