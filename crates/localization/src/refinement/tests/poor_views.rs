//! Tests of views that say little, or are wrong.

use super::*;
use realitysim_test_support::measured::largest_error;

#[test]
fn one_line_in_view_leaves_the_pose_free_along_it_alone() {
    let start = prior(camera(0.0, 0.0, 0.0));
    let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.06, 0.05, 0.004, 0.005, -0.004, 0.03));
    let across = line(DVec3::new(1.2, -1.0, 0.0), DVec3::new(1.2, 1.0, 0.0));
    let measurements = measurements(&truth, &[across], pixel_noise(3));
    let (solution, covariance, condition) = solved(&start, &measurements);
    assert_sound(&start, &solution, &covariance, condition);
    let sigma = |i: usize| covariance[(i, i)].sqrt();
    assert!(sigma(1) > 0.095, "along the line nothing is learnt: {}", sigma(1));
    assert!(sigma(0) < 0.045, "across it much: {}", sigma(0));
    assert!(solution.moved[1].abs() < 0.03, "no jump along it: {}", solution.moved[1]);
    let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
    let values = SymmetricEigen::new(plane).eigenvalues;
    assert!((values.max() / values.min()).sqrt() > 2.0, "{values}");
}

#[test]
fn collinear_points_few_points_and_none_leave_what_was_known() {
    let start = prior(camera(0.0, 0.0, 0.0));
    let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.03, -0.04, 0.004, 0.005, -0.004, 0.02));
    let all = measurements(&truth, &corner(), pixel_noise(4));
    for count in [0, 1, 2, 3, 5] {
        let few: Vec<LineMeasurement> = all.iter().step_by(9).take(count).copied().collect();
        let (solution, covariance, condition) = solved(&start, &few);
        assert_sound(&start, &solution, &covariance, condition);
        if count == 0 {
            assert_eq!((solution.moved, condition), (Vector6::zeros(), 1.0));
            assert!((covariance - start.pose_covariance()).amax() < 1e-15);
        }
    }
    // One ray many times counts like one point.
    let same = vec![all[5]; 400];
    let (solution, covariance, condition) = solved(&start, &same);
    assert_sound(&start, &solution, &covariance, condition);
    let free = SymmetricEigen::new(covariance).eigenvalues;
    assert!(free.max() > 0.009, "{free}");
}

#[test]
fn points_that_all_lie_far_off_are_rejected_and_move_nothing() {
    let start = prior(camera(0.0, 0.0, 0.0));
    // Every ray is 60 px off, to alternating sides: 240 standard deviations.
    let wrong = measurements(&start.map_from_optical, &corner(), |index| if index % 2 == 0 { 60.0 } else { -60.0 });
    let (solution, covariance, condition) = solved(&start, &wrong);
    assert_sound(&start, &solution, &covariance, condition);
    assert_eq!(solution.residuals.fitting, 0);
    assert!(solution.moved.amax() < 0.02, "{}", solution.moved);
    assert!((0..6).all(|i| covariance[(i, i)] > 0.9 * start.covariance[(i, i)]), "{covariance}");
}

#[test]
fn a_field_a_million_metres_away_is_refined_as_well_as_one_here() {
    let far = DVec3::new(1e6, -1e6, 0.0);
    let shift = |pose: Isometry| Isometry::new(pose.rotation, pose.translation + far);
    let start = camera(0.0, 0.0, 0.0);
    let truth = moved_pose(&start, &Vector6::new(0.06, -0.05, 0.004, 0.005, -0.004, 0.03));
    let here = measurements(&truth, &corner(), pixel_noise(5));
    let there: Vec<LineMeasurement> =
        here.iter().map(|measurement| LineMeasurement { point: measurement.point + far, ..*measurement }).collect();
    let (near, near_covariance, _) = solved(&prior(start), &here);
    let (distant, covariance, condition) = solved(&prior(shift(start)), &there);
    assert_sound(&prior(shift(start)), &distant, &covariance, condition);
    assert!((covariance - near_covariance).amax() < 1e-8);
    // At this distance f64 resolves 1e-10 m.
    largest_error((distant.moved - near.moved).amax(), 1e-10, "m or rad at 1e6 m");
}

#[test]
fn weights_that_span_twelve_orders_of_magnitude_leave_the_best_in_charge() {
    let start = prior(camera(0.0, 0.0, 0.0));
    let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.03, -0.04, 0.004, 0.005, -0.004, 0.02));
    let mut all = measurements(&truth, &corner(), |_| 0.0);
    for (index, measurement) in all.iter_mut().enumerate() {
        // Squared, the weights go from 1 down to 1e-12.
        measurement.sigmas = 10f64.powf(6.0 * index as f64 / 44.0);
    }
    for order in [1, -1] {
        if order < 0 {
            all.reverse();
        }
        let (solution, covariance, condition) = solved(&start, &all);
        assert_sound(&start, &solution, &covariance, condition);
        let error = error_between(&moved_pose(&start.map_from_optical, &solution.moved), &truth);
        let information = covariance.try_inverse().expect("regular");
        assert!(error.dot(&(information * error)) < 12.0, "{error}");
    }
}

/// One of two starts lies in a wrong basin; the cost of the lines tells them apart.
#[test]
fn several_starts_leave_a_wrong_basin() {
    let truth = camera(0.0, 0.0, 0.0);
    // Two parallel lines 40 cm apart, as goal line and goal area; the prior is off by one line.
    let wide = Vector6::new(0.25, 0.1, 0.012, 0.012, 0.012, 0.06);
    let beside = moved_pose(&truth, &Vector6::new(0.4, 0.0, 0.0, 0.0, 0.0, 0.0));
    let start = Prior::of_pose(beside, &Matrix6::from_diagonal(&wide.component_mul(&wide)));
    let across = |x: f64| line(DVec3::new(x, -1.0, 0.0), DVec3::new(x, 1.0, 0.0));
    let along = line(DVec3::new(0.3, -0.7, 0.0), DVec3::new(1.2, -0.7, 0.0));
    let mut seen = measurements(&truth, &[across(1.2), across(1.6), along], pixel_noise(6));
    // Associated as the prior expects: what is seen of the line at 1.2 is taken for the one at 1.6.
    for measurement in seen.iter_mut().filter(|measurement| measurement.tangent.y > 0.5 && measurement.point.x < 1.4) {
        measurement.point.x += 0.4;
    }
    let outliers = seen.iter().filter(|measurement| measurement.tangent.y > 0.5).count() / 2;
    let from =
        |start_at: &Vector6<f64>| solve::solve(&start, &seen, start_at, SCALES[1], Noise::USUAL).expect("a solution");
    let (stuck, free) = (from(&Vector6::zeros()), from(&error_between(&start.map_from_optical, &truth)));
    assert!(stuck.residuals.fitting + free.residuals.fitting >= seen.len() - 2 && outliers > 15);
    assert!((stuck.moved[0] - free.moved[0]).abs() > 0.2, "two basins: {} {}", stuck.moved[0], free.moved[0]);
}
