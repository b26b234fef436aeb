//! Exact residual resampling: weights become integers, so that counts add up by construction and no rounding can bias them.
//!
//! Weight i becomes q_i = round(2^40 w_i / w_max), S = sum q_i. Particle i is copied n_i = floor(N q_i / S) times; the
//! R = N - sum n_i copies that remain are drawn by systematic sampling on the remainders r_i = N q_i - n_i S, whose sum
//! is exactly R S. Each count is therefore n_i or n_i + 1.

use super::random::Stream;
use super::weights::Weights;

/// Integer weight of the best particle.
const ONE: f64 = (1u64 << 40) as f64;
/// Largest number of particles: the sum of more weights of 40 bits each would not fit 64 bits.
pub const MAX_PARTICLES: usize = 1 << 23;

/// Number of copies of each particle, with the buffer of its computation.
#[derive(Clone, Debug, Default)]
pub struct Copies {
    /// How often each particle is copied.
    pub counts: Vec<u32>,
    /// Integer weights.
    integer_weights: Vec<u64>,
}

/// Draws `draws` particles by their weights, with one random number of `stream`. The counts in `copies` sum to `draws`.
pub fn residual(weights: &Weights, draws: usize, stream: &mut Stream, copies: &mut Copies) {
    assert!(weights.relative.len() <= MAX_PARTICLES && draws <= MAX_PARTICLES, "at most 2^23 particles");
    let Copies { counts, integer_weights } = copies;
    quantise(weights, integer_weights);
    counts.clear();
    if !integer_weights.is_empty() {
        let total = integer_weights.iter().sum();
        count(integer_weights, total, draws, stream.below(total), counts);
    }
}

/// Converts relative weights to integers, 2^40 for the best particle.
fn quantise(weights: &Weights, integer_weights: &mut Vec<u64>) {
    integer_weights.clear();
    integer_weights.extend(weights.relative.iter().map(|relative| (ONE * relative + 0.5) as u64));
}

/// Counts the copies of each particle. `offset` is the first of the evenly spaced sampling places, in 0..`total`.
fn count(integer_weights: &[u64], total: u64, draws: usize, offset: u64, counts: &mut Vec<u32>) {
    // One more copy wherever the running sum of remainders passes offset, offset + S, offset + 2 S, ...
    let mut next = u128::from(offset);
    let mut sum = 0u128;
    counts.extend(integer_weights.iter().map(|integer_weight| {
        // 23 bits times 41 bits fit into 64.
        let wanted = draws as u64 * integer_weight;
        sum += u128::from(wanted % total);
        let one_more = sum > next;
        if one_more {
            next += u128::from(total);
        }
        (wanted / total) as u32 + u32::from(one_more)
    }));
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::super::weights::normalise;
    use super::*;
    use proptest::prelude::*;

    fn counts(log_weights: &[f64], draws: usize, stream: &mut Stream) -> Vec<u32> {
        let mut copies = Copies::default();
        residual(&normalise(log_weights), draws, stream, &mut copies);
        copies.counts
    }

    fn quantised(log_weights: &[f64]) -> Vec<u64> {
        let mut integer_weights = Vec::new();
        quantise(&normalise(log_weights), &mut integer_weights);
        integer_weights
    }

    fn stream(seed: u64) -> Stream {
        Stream::new(seed, Purpose::Resampling, 0, 0, 0)
    }

    #[test]
    fn equal_weights_give_one_copy_each() {
        for n in 1..=4096 {
            assert!(counts(&vec![-3.7; n], n, &mut stream(n as u64)).iter().all(|count| *count == 1), "{n}");
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
            for (sum, count) in sums.iter_mut().zip(counts(&logs, 4, &mut stream(seed))) {
                *sum += count;
            }
        }
        for (sum, share) in sums.iter().zip(shares) {
            let mean = f64::from(*sum) / runs as f64;
            assert!((mean - 4.0 * share).abs() < 0.02, "{mean} against {}", 4.0 * share);
        }
    }

    /// In floating point, ten times 0.1 sum to less than 1, and a draw beyond that sum finds no particle. Integer sums are exact.
    #[test]
    fn the_first_and_the_last_place_find_their_particle() {
        let tenths = (0..10).fold(0.0, |sum, _| sum + 0.1);
        assert!(tenths < 1.0, "{tenths}");
        for particles in 1..200u64 {
            let logs: Vec<f64> = (0..particles).map(|i| -((i * 37 % 11) as f64) / 3.0).collect();
            let integer_weights = quantised(&logs);
            let total: u64 = integer_weights.iter().sum();
            for draws in [1, 7, particles as usize, 1000] {
                for offset in [0, 1, total / 2, total - 1] {
                    let mut counts = Vec::new();
                    count(&integer_weights, total, draws, offset, &mut counts);
                    assert_eq!(counts.iter().sum::<u32>() as usize, draws, "{particles} {draws} {offset}");
                }
            }
        }
    }

    /// The mean number of copies over all offsets is exactly N q / S, where q is the integer weight: only rounding to q makes an error.
    #[test]
    fn expected_counts_are_the_weights() {
        use realitysim_test_support::exact::{exact, rounded};
        const DRAWS: usize = 800;
        let logs: Vec<f64> = (0..DRAWS).map(|i| -40.0 * stream(i as u64).uniform().powi(3)).collect();
        let integer_weights = quantised(&logs);
        let total: u64 = integer_weights.iter().sum();
        let shares: Vec<_> = logs.iter().map(|log| exact(*log).exp()).collect();
        let sum = shares.iter().fold(exact(0.0), |sum, share| sum + share);
        let errors = integer_weights.iter().zip(&shares).map(|(integer_weight, share)| {
            // Integers of 40 bits are exact in f64.
            let expected = exact(DRAWS as f64) * exact(*integer_weight as f64) / exact(total as f64);
            rounded(&(expected - exact(DRAWS as f64) * share / &sum)).abs()
        });
        let largest = errors.fold(0.0, f64::max);
        realitysim_test_support::measured::largest_error(largest, 2e-12, "copies");
    }

    #[test]
    fn unusable_weights_count_as_equal() {
        for bad in [f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(counts(&[bad; 5], 5, &mut stream(1)), vec![1; 5]);
        }
        assert_eq!(counts(&[f64::INFINITY, 0.0, f64::NAN], 6, &mut stream(1)), vec![6, 0, 0]);
    }

    proptest! {
        #[test]
        fn counts_add_up_and_keep_the_whole_part(logs in proptest::collection::vec(-50.0..0.0f64, 1..80), draws in 0usize..300, seed in any::<u64>()) {
            let counts = counts(&logs, draws, &mut stream(seed));
            prop_assert_eq!(counts.iter().sum::<u32>() as usize, draws);
            let sum: f64 = logs.iter().map(|x| x.exp()).sum();
            for (count, log) in counts.iter().zip(&logs) {
                let wanted = draws as f64 * log.exp() / sum;
                prop_assert!(f64::from(*count) >= (wanted - 1e-6).floor() && f64::from(*count) <= (wanted + 1e-6).floor() + 1.0);
            }
        }
    }
}
