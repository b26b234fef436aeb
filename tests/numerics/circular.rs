//! Angles have no ends, and a field looks the same from both goals.

use core::f64::consts::PI;

use realitysim::geometry::{Pose2, wrap_angle};
use realitysim::localization::estimate::estimate;
use realitysim::localization::particles::{Particles, Spread};
use realitysim::localization::weights::normalise;

use realitysim_test_support::exact::{Exact, exact, rounded};
use realitysim_test_support::measured::largest_error;

fn estimate_of(particles: &Particles) -> realitysim::localization::Estimate {
    estimate(particles, &normalise(&particles.log_weights))
}

const SPREAD: Spread = Spread { xy_m: 0.02, yaw_rad: 0.03 };

#[test]
fn a_cloud_across_plus_and_minus_pi_is_as_narrow_as_elsewhere() {
    let cloud = |yaw: f64| {
        let mut particles = Particles::around(Pose2::new(1.0, 0.5, yaw), SPREAD, 800, 4, 1);
        // The cloud is judged about its best particle: make that the middle one.
        particles.poses[0] = Pose2::new(1.0, 0.5, wrap_angle(yaw));
        particles.log_weights[0] = 1e-9;
        particles
    };
    let plain: f64 = cloud(PI).poses.iter().map(|pose| pose.yaw).sum::<f64>() / 800.0;
    assert!(plain.abs() < 0.3, "the plain mean looks the other way: {plain}");
    let (across, elsewhere) = (estimate_of(&cloud(PI)), estimate_of(&cloud(0.5)));
    assert!((across.spread_yaw_rad - elsewhere.spread_yaw_rad).abs() < 1e-12 && across.spread_yaw_rad < 0.035);
    assert_eq!(across.best.yaw, PI);
}

/// Two clouds of the same weight: their mean is at midfield, where nobody is.
#[test]
fn mirrored_clouds_are_not_averaged() {
    let here = Particles::around(Pose2::new(2.0, 1.0, 0.4), SPREAD, 400, 4, 1);
    let mut both = here.clone();
    both.poses.extend(here.poses.iter().map(Pose2::mirrored));
    both.log_weights.extend(&here.log_weights);
    both.log_weights[400 + 17] = 0.3;
    let mean = both.poses.iter().map(|pose| pose.x).sum::<f64>() / 800.0;
    assert!(mean.abs() < 1e-12, "{mean}");
    let found = estimate_of(&both);
    assert_eq!(found.best, both.poses[400 + 17]);
    assert!(found.best.distance(&Pose2::new(-2.0, -1.0, 0.0)) < 0.1);
    assert!(found.spread_m < 0.1 && found.spread_yaw_rad < 0.15, "{found:?}");
}

/// The mean direction of an opposite pair is any angle.
#[test]
fn opposite_directions_have_a_best_one_and_no_mean() {
    let poses = vec![Pose2::new(0.0, 0.0, 0.7), Pose2::new(0.0, 0.0, 0.7 - PI)];
    let (sin, cos) = poses.iter().fold((0.0, 0.0), |(s, c), p| (s + p.yaw.sin(), c + p.yaw.cos()));
    assert!(f64::hypot(sin, cos) < 1e-15, "no direction");
    let found = estimate_of(&Particles { poses, log_weights: vec![-1.0, -1.5] });
    assert_eq!((found.best.yaw, found.spread_yaw_rad), (0.7, 0.0));
}

#[test]
fn angles_are_wrapped_to_the_half_open_circle() {
    let pi = Exact::pi(256);
    let mut largest = 0.0f64;
    for i in -4000..4000 {
        let angle = f64::from(i) * 0.037 + f64::from(i % 7) * 1e-9;
        let wrapped = wrap_angle(angle);
        assert!(wrapped > -PI && wrapped <= PI, "{angle} {wrapped}");
        let turns = ((exact(angle) - exact(wrapped)) / (&pi + &pi)).round();
        largest = largest.max(rounded(&(exact(angle) - exact(wrapped) - turns * (&pi + &pi))).abs());
    }
    assert_eq!((wrap_angle(PI), wrap_angle(-PI), wrap_angle(3.0 * PI)), (PI, PI, PI));
    assert!(wrap_angle(f64::NAN).is_nan() && wrap_angle(1e300).abs() <= 2.0 * PI);
    largest_error(largest, 3e-14, "rad, within 24 turns");
}
