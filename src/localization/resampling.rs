//! Residual resampling, exact: weights become integers, so that counts add up by construction and no rounding can
//! bias them.
//!
//! Weight i becomes q_i = round(2^40 w_i / w_max), S = sum q_i. Particle i is copied n_i = floor(N q_i / S) times; the
//! R = N - sum n_i copies that remain are drawn on the remainders r_i = N q_i - n_i S, whose sum is exactly R S, at
//! evenly spaced places (systematic), so that each count is n_i or n_i + 1.

use super::random::Stream;

const ONE: f64 = (1u64 << 40) as f64;
/// 2^40 times more particles than this would not fit 64 bits.
pub const MAX_PARTICLES: usize = 1 << 23;

/// How often each particle is copied; the counts sum to `draws`. All weights zero or unusable count as equal.
pub fn residual(log_weights: &[f64], draws: usize, stream: &mut Stream) -> Vec<u32> {
    assert!(log_weights.len() <= MAX_PARTICLES && draws <= MAX_PARTICLES, "at most 2^23 particles");
    if log_weights.is_empty() {
        return Vec::new();
    }
    let quanta = quantised(log_weights);
    let total: u64 = quanta.iter().sum();
    let mut counts = Vec::with_capacity(quanta.len());
    let mut remainders = Vec::with_capacity(quanta.len());
    for quantum in &quanta {
        let wanted = draws as u128 * u128::from(*quantum);
        counts.push((wanted / u128::from(total)) as u32);
        remainders.push((wanted % u128::from(total)) as u64);
    }
    // One more copy wherever the running sum of remainders passes offset, offset + S, offset + 2 S, ...
    let mut next = u128::from(stream.below(total));
    let mut sum = 0u128;
    for (count, remainder) in counts.iter_mut().zip(&remainders) {
        sum += u128::from(*remainder);
        if sum > next {
            *count += 1;
            next += u128::from(total);
        }
    }
    counts
}

fn quantised(log_weights: &[f64]) -> Vec<u64> {
    let clean = |value: f64| if value.is_nan() { f64::NEG_INFINITY } else { value };
    let highest = log_weights.iter().map(|value| clean(*value)).fold(f64::NEG_INFINITY, f64::max);
    log_weights
        .iter()
        .map(|value| {
            let value = clean(*value);
            if value == highest { ONE as u64 } else { (ONE * libm::exp(value - highest) + 0.5) as u64 }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;
    use proptest::prelude::*;

    fn stream(seed: u64) -> Stream {
        Stream::new(seed, Purpose::Resampling, 0, 0, 0)
    }

    #[test]
    fn equal_weights_give_one_copy_each() {
        for n in 1..=4096 {
            assert!(residual(&vec![-3.7; n], n, &mut stream(n as u64)).iter().all(|count| *count == 1), "{n}");
        }
    }

    #[test]
    fn counts_average_to_the_weights() {
        // The case in which a well-known library always returns (4, 0, 0, 0).
        let shares = [0.55, 0.15, 0.10, 0.20];
        let logs = shares.map(f64::ln);
        let runs = 20_000;
        let mut sums = [0u32; 4];
        for seed in 0..runs {
            for (sum, count) in sums.iter_mut().zip(residual(&logs, 4, &mut stream(seed))) {
                *sum += count;
            }
        }
        for (sum, share) in sums.iter().zip(shares) {
            let mean = f64::from(*sum) / runs as f64;
            assert!((mean - 4.0 * share).abs() < 0.02, "{mean} against {}", 4.0 * share);
        }
    }

    #[test]
    fn unusable_weights_count_as_equal() {
        for bad in [f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(residual(&[bad; 5], 5, &mut stream(1)), vec![1; 5]);
        }
        assert_eq!(residual(&[f64::INFINITY, 0.0, f64::NAN], 6, &mut stream(1)), vec![6, 0, 0]);
    }

    proptest! {
        #[test]
        fn counts_add_up_and_keep_the_whole_part(logs in proptest::collection::vec(-50.0..0.0f64, 1..80), draws in 0usize..300, seed in any::<u64>()) {
            let counts = residual(&logs, draws, &mut stream(seed));
            prop_assert_eq!(counts.iter().sum::<u32>() as usize, draws);
            let sum: f64 = logs.iter().map(|x| x.exp()).sum();
            for (count, log) in counts.iter().zip(&logs) {
                let wanted = draws as f64 * log.exp() / sum;
                prop_assert!(f64::from(*count) >= (wanted - 1e-6).floor() && f64::from(*count) <= (wanted + 1e-6).floor() + 1.0);
            }
        }
    }
}
