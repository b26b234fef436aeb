//! Normalisation of log weights, without underflow and for any input.

/// Normalised weights of a set of particles.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Weights {
    /// Weights scaled so that their sum is 1.
    pub shares: Vec<f64>,
    /// Weights scaled so that the largest is 1.
    pub relative: Vec<f64>,
    /// Index of the largest weight.
    pub best: usize,
    /// Effective sample size, 1 / sum of squared shares: between 1 and the number of particles.
    pub effective_sample_size: f64,
    /// Natural logarithm of the mean of the raw weights.
    pub evidence: f64,
    /// Whether no weight was usable, so that all were taken as equal.
    pub degenerate: bool,
    /// Number of log weights that are NaN or +inf, which no likelihood can be.
    pub unusable: usize,
}

/// Normalises natural logarithms of weights.
///
/// NaN counts as weight 0. Weights of +inf share the whole weight equally.
pub fn normalise(log_weights: &[f64]) -> Weights {
    let mut weights = Weights::default();
    normalise_into(log_weights, &mut weights);
    weights
}

/// [`normalise`] into the buffers of `weights`.
pub fn normalise_into(log_weights: &[f64], weights: &mut Weights) {
    let count = log_weights.len();
    let Weights { shares, relative, best, effective_sample_size, evidence, degenerate, unusable } = weights;
    *unusable = log_weights.iter().filter(|value| value.is_nan() || **value == f64::INFINITY).count();
    let clean = |value: f64| if value.is_nan() { f64::NEG_INFINITY } else { value };
    let highest = log_weights.iter().map(|value| clean(*value)).fold(f64::NEG_INFINITY, f64::max);
    *degenerate = highest == f64::NEG_INFINITY;
    shares.clear();
    relative.clear();
    if *degenerate {
        relative.resize(count, 1.0);
        shares.resize(count, 1.0 / count.max(1) as f64);
        (*best, *effective_sample_size) = (0, count as f64);
        // An empty set gives no evidence for or against anything.
        *evidence = if count == 0 { 0.0 } else { f64::NEG_INFINITY };
        return;
    }
    relative.extend(log_weights.iter().map(|value| {
        let value = clean(*value);
        // Avoids exp(inf - inf), which is NaN.
        if value == highest { 1.0 } else { libm::exp(value - highest) }
    }));
    let sum = pairwise_sum(relative);
    shares.extend(relative.iter().map(|relative| relative / sum));
    *best = log_weights.iter().position(|value| *value == highest).unwrap_or(0);
    *effective_sample_size = 1.0 / pairwise_sum_of(shares, |share| share * share);
    *evidence = if highest == f64::INFINITY { highest } else { highest + libm::log(sum / count as f64) };
}

/// Sums by halves down to 64 values, so that the rounding error grows with log n instead of n.
pub fn pairwise_sum(values: &[f64]) -> f64 {
    pairwise_sum_of(values, |value| value)
}

/// [`pairwise_sum`] of a function of the values.
fn pairwise_sum_of(values: &[f64], of: impl Fn(f64) -> f64 + Copy) -> f64 {
    if values.len() <= 64 {
        return values.iter().map(|value| of(*value)).sum();
    }
    let (left, right) = values.split_at(values.len() / 2);
    pairwise_sum_of(left, of) + pairwise_sum_of(right, of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn without_a_usable_weight_all_are_equal() {
        for bad in [f64::NEG_INFINITY, f64::NAN] {
            let w = normalise(&[bad; 4]);
            assert!(w.degenerate);
            assert_eq!(w.shares, vec![0.25; 4]);
        }
        assert!(normalise(&[]).shares.is_empty());
    }

    #[test]
    fn nan_is_impossible_and_infinity_is_best() {
        assert_eq!(normalise(&[f64::NAN, 0.0]).shares, vec![0.0, 1.0]);
        let w = normalise(&[f64::INFINITY, 0.0, f64::INFINITY]);
        assert_eq!((w.shares, w.best), (vec![0.5, 0.0, 0.5], 0));
    }

    #[test]
    fn each_weight_that_is_no_likelihood_is_counted() {
        let (nan, inf) = (f64::NAN, f64::INFINITY);
        for (logs, unusable) in [
            (&[nan, 0.0, inf, -3.0][..], 2),
            (&[nan, nan][..], 2),
            (&[-inf, 0.0, -1e300, 1e300][..], 0),
            (&[-inf; 3][..], 0),
            (&[][..], 0),
        ] {
            assert_eq!(normalise(logs).unusable, unusable, "{logs:?}");
        }
    }

    proptest! {
        #[test]
        fn an_offset_changes_nothing(logs in proptest::collection::vec(-2000.0..0.0f64, 1..50), offset in prop_oneof![Just(-1e6), Just(1e6)]) {
            // Rounded to what survives the offset, so that both sides see the same numbers.
            let logs: Vec<f64> = logs.iter().map(|x| (x * 1024.0).round() / 1024.0).collect();
            let shifted: Vec<f64> = logs.iter().map(|x| x + offset).collect();
            prop_assert_eq!(normalise(&logs).shares, normalise(&shifted).shares);
        }

        #[test]
        fn shares_sum_to_one(logs in proptest::collection::vec(-1e4..1e4f64, 1..200)) {
            let w = normalise(&logs);
            prop_assert!((w.shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!(w.effective_sample_size >= 1.0 - 1e-12 && w.effective_sample_size <= logs.len() as f64 + 1e-9);
        }
    }
}
