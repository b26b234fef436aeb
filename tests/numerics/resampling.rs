//! Residual resampling in integers: nothing is lost, nobody is favoured.

use realitysim::localization::random::{Purpose, Stream};
use realitysim::localization::resampling::{Copies, MAX_PARTICLES, residual};
use realitysim::localization::weights::normalise;

use realitysim_test_support::measured::largest_error;

fn draw(log_weights: &[f64], draws: usize, seed: u64) -> Vec<u32> {
    let mut copies = Copies::default();
    residual(&normalise(log_weights), draws, &mut Stream::new(seed, Purpose::Resampling, 0, 0, 0), &mut copies);
    copies.counts
}

/// What two libraries do, and their numbers.
#[test]
fn rounded_residuals_lose_copies_and_favour_the_first() {
    let lost = |count: &u32| f64::from(*count) * (1.0 / f64::from(*count)) < 1.0;
    assert_eq!((1..=1000).filter(lost).count(), 82);
    // w - floor(N w) in place of N w - floor(N w): the cumulative sum starts above 1, so that all draws find index 0.
    let weights = [0.55, 0.15, 0.10, 0.20];
    let residuals = weights.map(|w: f64| w - (4.0 * w).floor());
    let sum: f64 = residuals.iter().sum();
    assert!(residuals[0] / sum > 1.0, "always (4, 0, 0, 0)");
    let mut seen = [0u32; 4];
    for seed in 0..100 {
        let counts = draw(&weights.map(f64::ln), 4, seed);
        assert!(counts[0] >= 2 && counts.iter().sum::<u32>() == 4);
        seen.iter_mut().zip(counts).for_each(|(seen, count)| *seen += count);
    }
    assert!(seen.iter().all(|count| *count > 0), "{seen:?}");
}

/// One extra copy is one multinomial draw, so its chi-square is exact: 99.9 % of seeds' worth below 29.6 (10 degrees).
#[test]
fn where_one_copy_is_drawn_the_counts_pass_a_chi_square_test() {
    const SEEDS: u64 = 20_000;
    // Eleven weights whose remainders sum to one copy: 1.0 + 0.09, 0.09, 0.09, ...
    let mut weights = [1.0 / 11.0; 11];
    weights[0] = 1.0 + 1.0 / 11.0;
    let logs = weights.map(f64::ln);
    let mut extra = [0u32; 11];
    for seed in 0..SEEDS {
        let counts = draw(&logs, 2, seed);
        assert!(counts[0] >= 1);
        for (index, (extra, count)) in extra.iter_mut().zip(counts).enumerate() {
            *extra += count - u32::from(index == 0);
        }
    }
    assert_eq!(extra.iter().sum::<u32>() as u64, SEEDS);
    let expected = SEEDS as f64 / 11.0;
    let chi_square: f64 = extra.iter().map(|n| (f64::from(*n) - expected).powi(2) / expected).sum();
    largest_error(chi_square, 5e0, "chi-square, 10 degrees of freedom");
}

/// With many extra copies the counts depend on each other; each alone is a coin of known odds.
#[test]
fn where_many_copies_are_drawn_each_count_averages_to_its_weight() {
    const SEEDS: u64 = 4000;
    const DRAWS: usize = 64;
    let logs: Vec<f64> = (0..100).map(|i| -f64::from(i * 31 % 50) / 9.0).collect();
    let sum: f64 = logs.iter().map(|log| log.exp()).sum();
    let mut totals = vec![0u64; logs.len()];
    for seed in 0..SEEDS {
        for (total, count) in totals.iter_mut().zip(draw(&logs, DRAWS, seed)) {
            *total += u64::from(count);
        }
    }
    let deviations = totals.iter().zip(&logs).map(|(total, log)| {
        let wanted = DRAWS as f64 * log.exp() / sum;
        let odds = wanted.fract();
        let sigma = (SEEDS as f64 * odds * (1.0 - odds)).sqrt();
        (*total as f64 - SEEDS as f64 * wanted).abs() / sigma
    });
    // The largest of 100 normal deviations is below 4 in 99.4 % of all cases.
    largest_error(deviations.fold(0.0, f64::max), 4e0, "standard deviations, the largest of 100");
}

#[test]
fn tiny_first_and_last_weights_are_not_kept_by_habit() {
    let mut logs = vec![0.0; 100];
    (logs[0], logs[99]) = (f64::ln(1e-3), f64::ln(1e-3));
    let (mut first, mut last) = (0, 0);
    for seed in 0..20_000 {
        let counts = draw(&logs, 100, seed);
        (first, last) = (first + counts[0], last + counts[99]);
        assert_eq!(counts.iter().sum::<u32>(), 100);
    }
    // 100 x 0.001 / 98.002 of 20 000: 20.4.
    assert!((5..45).contains(&first) && (5..45).contains(&last), "{first} {last}");
}

/// u += 1 / N in f32 has drifted by whole particles at the end; index times S in integers cannot.
#[test]
fn evenly_spaced_places_do_not_drift() {
    const COUNT: usize = 3 << 20;
    let step = 1.0f32 / COUNT as f32;
    let naive = (0..COUNT).fold(0.0f32, |sum, _| sum + step);
    assert!((1.0 - naive).abs() > 1000.0 * step, "{naive}");
    for seed in [1, 2] {
        let counts = draw(&vec![-7.25; COUNT], COUNT - 1, seed);
        assert!(counts.iter().all(|count| *count <= 1));
        assert_eq!(counts.iter().sum::<u32>() as usize, COUNT - 1);
        let few = draw(&vec![-7.25; COUNT], 1 << 10, seed);
        let places: Vec<usize> = (0..COUNT).filter(|i| few[*i] > 0).collect();
        assert_eq!(places.len(), 1 << 10);
        assert!(places.windows(2).all(|pair| pair[1] - pair[0] == 3 << 10), "evenly spaced to the last");
    }
}

#[test]
fn the_largest_set_keeps_one_copy_each() {
    let counts = draw(&vec![-0.3; MAX_PARTICLES], MAX_PARTICLES, 3);
    assert!(counts.iter().all(|count| *count == 1));
}

#[test]
fn one_particle_stands_for_all() {
    assert_eq!(draw(&[-12.0], 800, 1), vec![800]);
    let mut logs = vec![f64::NEG_INFINITY; 800];
    logs[3] = -1e6;
    let counts = draw(&logs, 800, 1);
    assert_eq!((counts[3], counts.iter().sum::<u32>()), (800, 800));
}
