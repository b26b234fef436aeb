//! Tests whether errors are as large as the covariances say.

use super::*;
use crate::refinement::paint_displacement;

/// The 95 % ellipse holds the truth in 90 to 99 % of draws where errors along a line are correlated, as in images. For
/// independent errors it is too wide, by the allowance for what lines share ([`solve::SHARED_FACTOR`]); without that it is right.
#[test]
fn the_ellipse_holds_the_truth_as_often_as_it_says() {
    const DRAWS: u64 = 1500;
    let start = prior(camera(0.0, 0.0, 0.1));
    let factor = start.pose_covariance().cholesky().expect("a prior").l();
    for correlation in [0.0f64, 0.6] {
        let (mut stated, mut bare, mut nees) = ([0; 2], [0; 2], 0.0);
        for seed in 0..DRAWS {
            let off = factor * Vector6::from_fn(|i, _| normal(seed + 10_000, i));
            let truth = moved_pose(&start.map_from_optical, &off);
            // Noise along the lines is an autoregressive process.
            let mut last = 0.25 * normal(seed + 20_000, 0);
            let noise = |index: usize| {
                last = correlation * last + (1.0 - correlation * correlation).sqrt() * 0.25 * normal(seed, index);
                last
            };
            let (solution, covariance, condition) = solved(&start, &measurements(&truth, &corner(), noise));
            assert_sound(&start, &solution, &covariance, condition);
            let error = error_between(&moved_pose(&start.map_from_optical, &solution.moved), &truth);
            let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
            let xy = Vector2::new(error[0], error[1]);
            // Squared deviations relative to their 95 % quantiles.
            let squares = [
                xy.dot(&(plane.try_inverse().expect("regular") * xy)) / 5.991,
                error[5] * error[5] / covariance[(5, 5)] / 3.841,
            ];
            for (i, square) in squares.into_iter().enumerate() {
                stated[i] += usize::from(square < 1.0);
                bare[i] += usize::from(square * solve::SHARED_FACTOR < 1.0);
            }
            nees += error.dot(&(covariance.try_inverse().expect("regular") * error)) / 6.0 / DRAWS as f64;
        }
        let share = |counts: [usize; 2]| counts.map(|count| count as f64 / DRAWS as f64);
        let (stated, bare) = (share(stated), share(bare));
        println!("correlation {correlation}: position and heading {stated:?}, bare {bare:?}, NEES {nees:.2}");
        assert!(stated.iter().all(|share| *share >= 0.90), "correlation {correlation}: {stated:?}");
        let honest = if correlation > 0.0 { stated } else { bare };
        assert!(honest.iter().all(|share| (0.90..=0.99).contains(share)), "correlation {correlation}: {honest:?}");
    }
}

/// Lenses are as wrong as their calibration allows and poses as wrong as the prior. Both are found as precisely as the covariance
/// says, and the pose is better than if the lens were taken for right.
#[test]
fn errors_of_lens_and_pose_are_found_with_consistent_covariance() {
    const DRAWS: u64 = 800;
    let start = prior_with_lens(camera(0.0, 0.0, 0.1));
    let ignorant = prior(start.map_from_optical);
    let factor = start.covariance.cholesky().expect("a prior").l();
    let (mut held, mut held_if_ignorant, mut nees, mut off_m, mut off_if_ignorant_m) = (0, 0, 0.0, 0.0, 0.0);
    let lens = lens();
    for seed in 0..DRAWS {
        let off: Errors = factor * Errors::from_fn(|i, _| normal(seed + 30_000, i));
        let truth = moved_pose(&start.map_from_optical, &pose_part(&off));
        let wrong = Miscalibration { stretch: off[6], shift: DVec2::new(off[7], off[8]), readout_s: off[9] };
        let mut seen = measurements(&truth, &corner(), pixel_noise(seed));
        for measurement in &mut seen {
            measurement.ray = misread(&lens, &wrong, measurement.ray).expect("in view");
            measurement.ray_by_lens = ray_by_lens(measurement.ray);
        }
        let noise = Noise { sigma_px: 0.25, correlated: 1.0 };
        let [.., scale] = SCALES;
        let [knowing, not] = [&start, &ignorant].map(|prior| {
            let solution = solve::solve(prior, &seen, &Vector6::zeros(), SCALES[0], noise).expect("a solution");
            solve::joint(prior, &seen, &solution.moved, scale, [noise; 2]).expect("a covariance")
        });
        let within = |joint: &solve::Joint| {
            let error = joint.moved - off;
            let plane: Matrix2<f64> = joint.covariance.fixed_view::<2, 2>(0, 0).into();
            let xy = Vector2::new(error[0], error[1]);
            (xy.dot(&(plane.try_inverse().expect("regular") * xy)) < 5.991, xy.norm())
        };
        let ((is_held, m), (is_held_if_ignorant, if_ignorant_m)) = (within(&knowing), within(&not));
        held += u64::from(is_held);
        held_if_ignorant += u64::from(is_held_if_ignorant);
        (off_m, off_if_ignorant_m) = (off_m + m / DRAWS as f64, off_if_ignorant_m + if_ignorant_m / DRAWS as f64);
        let error = knowing.moved - off;
        nees += error.dot(&(knowing.covariance.try_inverse().expect("regular") * error)) / 10.0 / DRAWS as f64;
    }
    let [held, ignorant] = [held, held_if_ignorant].map(|count| count as f64 / DRAWS as f64);
    println!(
        "held {held:.3}, NEES {nees:.2}, {off_m:.5} m; lens taken for right: {ignorant:.3}, {off_if_ignorant_m:.5} m"
    );
    assert!((0.90..=0.99).contains(&held) && (0.7..1.4).contains(&nees), "{held} {nees}");
    assert!(ignorant < 0.7 && off_m < off_if_ignorant_m, "{ignorant} {off_m} {off_if_ignorant_m}");
}

/// The torso sways and rocks unmeasured while rows are read. The pose at the middle row's time is found as precisely as the
/// covariance says, and better than without a model of that motion.
#[test]
fn a_pose_during_unmeasured_sway_has_a_consistent_covariance() {
    for rocks_rad_per_s in [0.0, UNMEASURED_RAD_PER_S] {
        let [knowing, ignorant] = swayed_unseen(rocks_rad_per_s);
        println!("rocks by {rocks_rad_per_s} rad/s: {knowing:.3?}; taken for one moment's: {ignorant:.3?}");
        assert!((0.90..=0.99).contains(&knowing.held) && (0.7..1.4).contains(&knowing.nees), "{knowing:?}");
        assert!(ignorant.held < 0.9 && knowing.off_m < ignorant.off_m, "{knowing:?} {ignorant:?}");
    }
}

/// For lines painted beside their place, `by_paint` covers what they move the pose by.
#[test]
fn lines_painted_elsewhere_move_the_pose_as_far_as_is_said() {
    const DRAWS: u64 = 800;
    const SIGMA_PX: f64 = 0.05;
    let start = prior(camera(0.0, 0.0, 0.1));
    let factor = start.pose_covariance().cholesky().expect("a prior").l();
    let noise = Noise { sigma_px: SIGMA_PX, correlated: 1.0 };
    let [.., scale] = SCALES;
    let (mut held, mut held_by_noise_alone, mut nees) = (0.0, 0.0, 0.0);
    for seed in 0..DRAWS {
        let off: Vector6<f64> = factor * Vector6::from_fn(|i, _| normal(seed + 80_000, i));
        let truth = moved_pose(&start.map_from_optical, &off);
        let painted: Vec<Vec<_>> = corner()
            .into_iter()
            .enumerate()
            .map(|(line, places)| {
                let aside = places[0].1.cross(DVec3::Z) * (paint_displacement::PAINT_M * normal(seed + 90_000, line));
                places.into_iter().map(|(point, tangent)| (point + aside, tangent)).collect()
            })
            .collect();
        let mut seen = measurements(&truth, &painted, |index| SIGMA_PX * normal(seed, index));
        for (measurement, (point, _)) in seen.iter_mut().zip(corner().concat()) {
            measurement.point = point;
        }
        let solution = solve::solve(&start, &seen, &Vector6::zeros(), SCALES[0], noise).expect("a solution");
        let joint = solve::joint(&start, &seen, &solution.moved, scale, [noise; 2]).expect("a covariance");
        assert!(SymmetricEigen::new(joint.by_paint).eigenvalues.min() > -1e-12, "{}", joint.by_paint);
        let error = pose_part(&joint.moved) - off;
        let xy = Vector2::new(error[0], error[1]);
        let by_noise = pose_block(&joint.covariance);
        let within = |covariance: &Matrix6<f64>| {
            let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
            f64::from(u8::from(xy.dot(&(plane.try_inverse().expect("regular") * xy)) < 5.991)) / DRAWS as f64
        };
        let all = by_noise + joint.by_paint;
        (held, held_by_noise_alone) = (held + within(&all), held_by_noise_alone + within(&by_noise));
        nees += error.dot(&(all.try_inverse().expect("regular") * error)) / 6.0 / DRAWS as f64;
    }
    println!("held {held:.3}, NEES {nees:.2}; without the paint {held_by_noise_alone:.3}");
    assert!((0.90..=0.99).contains(&held) && (0.8..1.3).contains(&nees), "{held} {nees}");
    assert!(held_by_noise_alone < 0.8, "{held_by_noise_alone}");
}

/// Average consistency of poses with their covariances.
#[derive(Clone, Copy, Debug, Default)]
struct Honesty {
    /// Share of the 95 % ellipses that hold the truth.
    held: f64,
    /// Normalised estimation error squared, divided by the number of unknowns.
    nees: f64,
    /// Mean error of the position, metres.
    off_m: f64,
}

/// Results with and without a model of the motion. There is a gyro if the camera does not rock.
fn swayed_unseen(rocks_rad_per_s: f64) -> [Honesty; 2] {
    const DRAWS: u64 = 800;
    const READOUT_S: f64 = 0.025;
    const SIGMA_PX: f64 = 0.08;
    let lens = lens();
    let of_a_moment = prior(camera(0.0, 0.0, 0.1));
    let mut swaying = of_a_moment.clone();
    swaying.lens.readout_s = READOUT_S;
    swaying.turn_is_measured = rocks_rad_per_s == 0.0;
    let factor = of_a_moment.pose_covariance().cholesky().expect("a prior").l();
    let noise = Noise { sigma_px: SIGMA_PX, correlated: 1.0 };
    let mut honesty = [Honesty::default(); 2];
    for seed in 0..DRAWS {
        let off: Vector6<f64> = factor * Vector6::from_fn(|i, _| normal(seed + 50_000, i));
        let truth = moved_pose(&of_a_moment.map_from_optical, &off);
        let draw = |from: u64| DVec3::from_array(core::array::from_fn(|i| normal(seed + from, i)));
        let (sways, rocks) = (UNSEEN_M_PER_S * draw(60_000), rocks_rad_per_s * draw(70_000));
        let mut seen = measurements(&truth, &corner(), |index| SIGMA_PX * normal(seed, index));
        for measurement in &mut seen {
            measurement.row = row(&lens, lens.project(measurement.ray).expect("in view"));
            measurement.distance = measurement.point.distance(truth.translation);
            let place = measurement.ray * measurement.distance;
            measurement.ray = (place - (sways + rocks.cross(place)) * READOUT_S * measurement.row).normalize();
        }
        for (honesty, prior) in honesty.iter_mut().zip([&swaying, &of_a_moment]) {
            let solution = solve::solve(prior, &seen, &Vector6::zeros(), SCALES[0], noise).expect("a solution");
            let joint = solve::joint(prior, &seen, &solution.moved, SCALES[2], [noise; 2]).expect("a covariance");
            let (error, covariance) = (pose_part(&joint.moved) - off, pose_block(&joint.covariance));
            let plane: Matrix2<f64> = covariance.fixed_view::<2, 2>(0, 0).into();
            let xy = Vector2::new(error[0], error[1]);
            let is_held = xy.dot(&(plane.try_inverse().expect("regular") * xy)) < 5.991;
            honesty.held += f64::from(u8::from(is_held)) / DRAWS as f64;
            honesty.nees += error.dot(&(covariance.try_inverse().expect("regular") * error)) / 6.0 / DRAWS as f64;
            honesty.off_m += xy.norm() / DRAWS as f64;
        }
    }
    honesty
}
