//! Properties that hold for any prior and any lines.

use proptest::prelude::*;

use super::*;

fn tilted(turn: f64) -> DQuat {
    DQuat::from_rotation_z(turn)
}

proptest! {
    /// At a fixed pose and fixed noise, another line never makes the pose less certain, whatever it says.
    #[test]
    fn more_lines_never_widen_the_covariance(seed in 0u64..1000, few in 1usize..40) {
        let start = prior_with_lens(camera(0.0, 0.0, 0.0));
        let all = measurements(&start.map_from_optical, &corner(), pixel_noise(seed));
        let covariance = |measurements: &[LineMeasurement]| {
            solve::joint(&start, measurements, &Vector6::zeros(), SCALES[1], [Noise::USUAL; 2]).expect("a covariance").covariance
        };
        let (less, more) = (covariance(&all[..few]), covariance(&all));
        let factor = less.cholesky().expect("positive definite").l().try_inverse().expect("regular");
        let ratio = SymmetricEigen::new(factor * more * factor.transpose()).eigenvalues;
        prop_assert!(ratio.max() <= 1.0 + 1e-9, "{}", ratio);
    }

    /// Moving field and robot together gives the same errors of the pose, in rotated axes.
    #[test]
    fn rotating_and_shifting_field_and_robot_together_changes_nothing(
        x in -20.0..20.0f64, y in -20.0..20.0f64, turn in -3.1..3.1f64, seed in 0u64..1000,
    ) {
        let moved_by = Isometry::new(tilted(turn), DVec3::new(x, y, 0.0));
        let start = prior(camera(0.1, 0.0, 0.2));
        let truth = moved_pose(&start.map_from_optical, &Vector6::new(0.04, -0.03, 0.004, 0.005, -0.004, 0.02));
        let here = measurements(&truth, &corner(), pixel_noise(seed));
        let there: Vec<LineMeasurement> = here
            .iter()
            .map(|measurement| LineMeasurement {
                point: moved_by.transform_point(measurement.point),
                tangent: moved_by.transform_vector(measurement.tangent),
                ..*measurement
            })
            .collect();
        let mut axes = Matrix6::zeros();
        for (row, column, value) in [(0, 0, turn.cos()), (0, 1, -turn.sin()), (1, 0, turn.sin()), (1, 1, turn.cos())] {
            axes[(row, column)] = value;
            axes[(row + 3, column + 3)] = value;
        }
        axes[(2, 2)] = 1.0;
        axes[(5, 5)] = 1.0;
        let covariance = axes * start.pose_covariance() * axes.transpose();
        let covariance = (covariance + covariance.transpose()) * 0.5;
        let elsewhere = Prior::of_pose(moved_by * start.map_from_optical, &covariance);
        let ((a, a_covariance, _), (b, b_covariance, _)) = (solved(&start, &here), solved(&elsewhere, &there));
        prop_assert!((axes * a.moved - b.moved).amax() < 1e-9, "{} {}", axes * a.moved, b.moved);
        prop_assert!((axes * a_covariance * axes.transpose() - b_covariance).amax() < 1e-9);
    }

    /// For any prior and any lines the covariance is positive definite and every number finite.
    #[test]
    fn the_covariance_is_positive_definite_always(
        seed in any::<u64>(), count in 0usize..45, sizes in proptest::array::uniform6(-5.0..1.0f64),
        off_px in 0.0..200.0f64, height in 0.01..30.0f64,
    ) {
        let mut start = prior(camera(0.0, 0.0, 0.0));
        start.map_from_optical.translation.z = height;
        let mixed = Matrix6::from_fn(|i, j| 10f64.powf(sizes[i]) * (normal(seed, 6 * i + j) + f64::from(u8::from(i == j))));
        let covariance = mixed * mixed.transpose();
        start = Prior::of_pose(start.map_from_optical, &(covariance + Matrix6::identity() * (1e-9 * covariance.trace())));
        let seen = measurements(&start.map_from_optical, &corner(), |index| off_px * normal(seed ^ 1, index));
        let found = solve::solve(&start, &seen[..count], &Vector6::zeros(), SCALES[0], Noise::USUAL);
        let solution = found.expect("a covariance has a factor");
        let joint =
            solve::joint(&start, &seen[..count], &solution.moved, SCALES[1], [solution.residuals.noise(); 2]).expect("one");
        assert_sound(&start, &solution, &pose_block(&joint.covariance), joint.condition);
    }
}
