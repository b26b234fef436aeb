//! Weights stay logarithms until the last moment.

use realitysim::geometry::Pose2;
use realitysim::localization::estimate::estimate;
use realitysim::localization::particles::{Particles, Spread};
use realitysim::localization::random::{Purpose, Stream};
use realitysim::localization::weights::{normalise, pairwise_sum};

use realitysim_test_support::exact::{exact, rounded};
use realitysim_test_support::measured::largest_error;

#[test]
fn three_hundred_points_at_three_sigma_do_not_underflow() {
    let worst = -1626.0;
    // The product of 300 likelihoods, and of as few as 141 (f64) or 20 (f32) at a floor of 0.005, is 0.
    assert_eq!(f64::exp(worst), 0.0);
    assert_eq!(0.005f64.powi(141), 0.0);
    assert!(0.005f64.powi(140) > 0.0);
    assert_eq!(0.005f32.powi(20), 0.0);
    let weights = normalise(&[worst, worst + f64::ln(2.0), worst - 2000.0]);
    assert!((weights.shares[1] - 2.0 / 3.0).abs() < 1e-12 && weights.shares[2] == 0.0, "{weights:?}");
    assert!(!weights.degenerate && weights.best == 1);
}

/// A factor on all weights is a summand of their logarithms.
#[test]
fn scaling_all_weights_changes_nothing() {
    let logs: Vec<f64> = (0..500).map(|i| f64::from(i * 7919 % 1031) / -64.0).collect();
    let alone = normalise(&logs);
    for offset in [-1e6, 1e6, -1e9, 3.0] {
        let shifted = normalise(&logs.iter().map(|log| log + offset).collect::<Vec<_>>());
        assert_eq!((&shifted.shares, shifted.best), (&alone.shares, alone.best), "{offset}");
        assert!((shifted.evidence - alone.evidence - offset).abs() <= 1e-6, "{offset}");
    }
}

#[test]
fn a_set_without_any_usable_weight_has_a_finite_estimate_and_says_so() {
    let poses: Vec<Pose2> = (0..50).map(|i| Pose2::new(0.01 * f64::from(i), 0.0, 0.001 * f64::from(i))).collect();
    for bad in [f64::NEG_INFINITY, f64::NAN] {
        let particles = Particles { poses: poses.clone(), log_weights: vec![bad; 50] };
        let found = estimate(&particles, &normalise(&particles.log_weights));
        assert!(found.degenerate && found.best.is_finite() && found.effective_sample_size == 50.0);
        assert!(found.pose_covariance().cholesky().is_some());
    }
}

/// Its evidence was minus infinity, in every tag of a robot that nobody had told where it stands.
#[test]
fn a_set_of_no_particles_has_finite_numbers() {
    let found = estimate(&Particles::default(), &normalise(&[]));
    assert_eq!((found.evidence, found.effective_sample_size, found.spread_m, found.degenerate), (0.0, 0.0, 0.0, true));
    assert!(found.best == Pose2::default() && found.pose_covariance().cholesky().is_some());
}

/// Rounding made the two halves differ in the last bit.
#[test]
fn the_covariance_of_particles_is_symmetric_to_the_last_bit() {
    for seed in 0..20 {
        let mut particles =
            Particles::around(Pose2::new(1.0, -0.5, 0.3), Spread { xy_m: 0.1, yaw_rad: 0.1 }, 97, seed, 1);
        particles.log_weights.iter_mut().enumerate().for_each(|(index, log)| *log = -(index as f64) / 7.0);
        let found = estimate(&particles, &normalise(&particles.log_weights));
        assert_eq!(found.covariance, found.covariance.transpose(), "{seed}");
        assert_eq!(found.pose_covariance(), found.pose_covariance().transpose(), "{seed}");
    }
}

#[test]
fn one_usable_weight_among_unusable_ones_takes_all() {
    let weights = normalise(&[f64::NAN, -5e8, f64::NEG_INFINITY, f64::NAN]);
    assert_eq!(
        (weights.shares.as_slice(), weights.best, weights.degenerate),
        ([0.0, 1.0, 0.0, 0.0].as_slice(), 1, false)
    );
    assert_eq!((weights.effective_sample_size, weights.evidence), (1.0, -5e8 - f64::ln(4.0)));
}

/// 1 / (1 - sum of squares), the factor of an unbiased covariance, is infinite here, and times a covariance of 0 no number.
#[test]
fn one_dominant_particle_has_a_positive_definite_covariance() {
    let mut log_weights = vec![-2000.0; 800];
    log_weights[17] = 0.0;
    let poses = (0..800).map(|i| Pose2::new(f64::from(i) * 1e-3, 0.2, 0.1)).collect();
    let weights = normalise(&log_weights);
    let squares: f64 = weights.shares.iter().map(|share| share * share).sum();
    assert!((0.0 / (1.0 - squares)).is_nan());
    let found = estimate(&Particles { poses, log_weights }, &weights);
    assert_eq!((found.best.x, found.effective_sample_size, found.spread_m), (0.017, 1.0, 0.0));
    let covariance = found.pose_covariance();
    assert!(covariance.cholesky().is_some() && covariance == covariance.transpose());
}

/// Products of weights are gone after a few frames; sums of logarithms keep what tells the particles apart.
#[test]
fn a_hundred_thousand_updates_without_resampling_keep_the_weights() {
    const PARTICLES: usize = 4;
    let (mut logs, mut naive) = ([0.0f64; PARTICLES], [1.0f64; PARTICLES]);
    let mut truth = [exact(0.0), exact(0.0), exact(0.0), exact(0.0)];
    let mut gone_after = None;
    for update in 0..100_000 {
        for (index, (log, truth)) in logs.iter_mut().zip(&mut truth).enumerate() {
            let mut draw = Stream::new(5, Purpose::Start, update, 0, index as u32);
            // Particles that are equally good in the long run: each is the best for a while.
            let likelihood = 20.0 * libm::log(draw.uniform());
            *log += likelihood;
            *truth = &*truth + exact(likelihood);
            naive[index] *= f64::exp(likelihood);
        }
        if naive == [0.0; PARTICLES] {
            gone_after.get_or_insert(update + 1);
        }
        // What an update leaves: only differences count.
        let highest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        logs.iter_mut().for_each(|log| *log -= highest);
    }
    assert!(gone_after.expect("products underflow") < 60, "{gone_after:?}");
    let highest = truth.iter().max().expect("four").clone();
    let errors = logs.iter().zip(&truth).map(|(log, truth)| rounded(&(exact(*log) - (truth - &highest))).abs());
    assert!(normalise(&logs).shares.iter().all(|share| share.is_finite()));
    largest_error(errors.fold(0.0, f64::max), 3e-10, "of a log weight");
}

/// Recovery has to see that all particles fit badly; normalised weights cannot say so, and must not say that more
/// particles are worse.
#[test]
fn evidence_comes_from_raw_weights_and_not_from_the_number_of_particles() {
    let logs: Vec<f64> = (0..500).map(|i| -f64::from(i % 37)).collect();
    let before = normalise(&logs);
    let collapsed = normalise(&logs.iter().map(|log| log + f64::ln(1e-6)).collect::<Vec<_>>());
    let mean = |shares: &[f64]| shares.iter().sum::<f64>() / shares.len() as f64;
    assert!((mean(&collapsed.shares) / mean(&before.shares) - 1.0).abs() < 1e-12, "normalised weights see nothing");
    assert!((collapsed.evidence - before.evidence - f64::ln(1e-6)).abs() < 1e-9);
    let fourfold = normalise(&logs.repeat(4));
    assert!((mean(&fourfold.shares) / mean(&before.shares) - 0.25).abs() < 1e-12, "a spurious collapse");
    assert!((fourfold.evidence - before.evidence).abs() < 1e-12);
}

#[test]
fn a_particle_that_seemed_dead_comes_back() {
    let (dead, alive) = (-3000.0, 0.0);
    assert_eq!(f64::exp(dead) * f64::exp(700.0), 0.0, "0 stays 0");
    assert_eq!(normalise(&[dead, alive]).shares, vec![0.0, 1.0]);
    let later = normalise(&[dead + 3010.0, alive]);
    assert!(later.best == 0 && later.shares[0] > 0.9999);
}

#[test]
fn sums_of_sixteen_million_weights_do_not_drift() {
    const COUNT: usize = 1 << 24;
    let weight = 1.0f32 / 3.0 / COUNT as f32;
    let naive = (0..COUNT).fold(0.0f32, |sum, _| sum + weight);
    assert!((f64::from(naive) / (f64::from(weight) * COUNT as f64) - 1.0).abs() > 0.03, "{naive}");
    let weights = vec![f64::from(weight); COUNT];
    assert_eq!(pairwise_sum(&weights), f64::from(weight) * COUNT as f64);
    let tenths = vec![0.1; 10_000_000];
    let (naive, pairwise): (f64, f64) = (tenths.iter().sum(), pairwise_sum(&tenths));
    let off = |sum: f64| (sum - 1e6).abs() / 1e6;
    assert!(off(naive) > 1e-10, "{naive}");
    largest_error(off(pairwise), 1e-15, "of the sum");
}

/// 1 / sum of squares is between 1 and N, whatever the weights.
#[test]
fn the_effective_sample_size_is_right_in_closed_form() {
    let mut largest = 0.0f64;
    for count in [1usize, 2, 3, 10, 800, 4096] {
        // Weights 1, r, r^2, ...: sum and sum of squares are geometric.
        for ratio in [1.0, 0.999, 0.9, 0.5, 1e-3] {
            let logs: Vec<f64> = (0..count).map(|i| i as f64 * libm::log(ratio)).collect();
            let geometric = |ratio: f64| (0..count).fold(exact(0.0), |sum, i| sum + exact(ratio).powi(i.into()));
            let (sum, squares) = (geometric(ratio), geometric(ratio * ratio));
            let truth = rounded(&(&sum * &sum / squares));
            let found = normalise(&logs).effective_sample_size;
            assert!((1.0 - 1e-12..=count as f64 * (1.0 + 1e-12)).contains(&found), "{found}");
            largest = largest.max((found / truth - 1.0).abs());
        }
    }
    largest_error(largest, 2e-14, "of the size");
}
