//! Tests of what the filter learns about a walking robot.

use nalgebra::Matrix6;

use super::*;
use crate::refinement::{Agreement, error_between};

const MODEL: fn() -> SlowStateModel = SlowStateModel::default;

fn camera(pose: &Pose2) -> Isometry {
    let place = Isometry::from_euler(realitysim_geometry::Euler { yaw: 0.0, pitch: 0.3, roll: 0.0 }, DVec3::Z * 0.5);
    pose.to_isometry() * place * Isometry::link_from_optical()
}

/// The filter after a walk along a circle, in which each frame's lines show exactly where the camera is.
fn walked(
    frames: usize,
    odometry: impl Fn(Pose2) -> Option<Pose2>,
    gyro: impl Fn(f64) -> Option<f64>,
) -> SlowStateFilter {
    let step = Pose2::new(0.025, 0.0, 0.05);
    let mut truth = Pose2::new(0.3, -0.2, 0.1);
    let mut track = SlowStateFilter::around(truth, 0.05, 0.05, &MODEL());
    let place = Pose2::default().to_isometry().inverse() * camera(&Pose2::default());
    for _ in 0..frames {
        truth = truth.compose(&step);
        let told = Step { odometry: odometry(step), turned_rad: gyro(step.yaw), seconds: 0.1, stamp_sigma_s: 0.0 };
        track.predict(&told, &MODEL(), 0.04, 0.1);
        let prediction = track.prior(&place, &MODEL());
        let off = error_between(&prediction.prior.map_from_optical, &camera(&truth));
        let moved = Errors::from_fn(|i, _| if i < 6 { off[i] } else { 0.0 });
        let refined = Refined {
            map_from_optical: camera(&truth),
            covariance: ErrorCovariance::identity() * 1e-8,
            by_paint: Matrix6::zeros(),
            moved,
            cost: 0.0,
            condition: 1.0,
            lines: Agreement::default(),
        };
        track.update(&prediction, &refined);
    }
    track
}

#[test]
fn odometry_s_scales_are_learnt_while_walking() {
    // Odometry says 20 % too much of the distance and 15 % too little of the turn.
    let track = walked(150, |step| Some(Pose2::new(1.2 * step.x, 0.0, 0.85 * step.yaw)), |_| None);
    assert!((track.mean[DISTANCE] - (1.0 / 1.2 - 1.0)).abs() < 0.02, "{}", track.mean[DISTANCE]);
    assert!((track.mean[TURN] - (1.0 / 0.85 - 1.0)).abs() < 0.05, "{}", track.mean[TURN]);
}

#[test]
fn a_gyro_s_bias_is_learnt_and_odometry_s_turn_does_not_matter_then() {
    let bias = 0.012;
    for share in [0.7, 1.0, 1.3] {
        let odometry = |step: Pose2| Some(Pose2 { yaw: share * step.yaw, ..step });
        let track = walked(150, odometry, |turn| Some(turn + bias * 0.1));
        assert!((track.mean[GYRO] - bias).abs() < 0.003, "{share}: {}", track.mean[GYRO]);
        assert_eq!(track.mean[TURN], 0.0, "odometry's turn was not used");
    }
}

#[test]
fn a_gyro_that_contradicts_odometry_leaves_both_possible() {
    let mut track = SlowStateFilter::around(Pose2::default(), 0.01, 0.01, &MODEL());
    let told = Step { odometry: Some(Pose2::default()), turned_rad: Some(0.4), seconds: 0.1, stamp_sigma_s: 0.0 };
    track.predict(&told, &MODEL(), 0.04, 0.1);
    let (_, yaw_sigma) = track.spread();
    assert!((track.pose().yaw - 0.4).abs() < 1e-12 && (0.39..0.5).contains(&yaw_sigma), "{yaw_sigma}");
    let mut agreed = SlowStateFilter::around(Pose2::default(), 0.01, 0.01, &MODEL());
    let turn = Pose2::new(0.0, 0.0, 0.39);
    agreed.predict(&Step { odometry: Some(turn), ..told }, &MODEL(), 0.04, 0.1);
    assert!(agreed.spread().1 < 0.02, "{}", agreed.spread().1);
}

/// Stretch of the lens and its standard deviation after frames that all measure the same `stretch`, each with this `sigma`.
fn told_of_the_lens(stretch: f64, sigma: f64, rate_hz: usize, seconds: usize) -> (f64, f64) {
    let track = SlowStateFilter::around(Pose2::default(), 0.05, 0.05, &MODEL());
    let track = told_again(track, stretch, sigma, rate_hz, seconds);
    (track.lens().stretch, track.lens_sigmas()[0])
}

fn told_again(mut track: SlowStateFilter, stretch: f64, sigma: f64, rate_hz: usize, seconds: usize) -> SlowStateFilter {
    for _ in 0..rate_hz * seconds {
        track.predict(&Step { seconds: 1.0 / rate_hz as f64, ..Step::none() }, &MODEL(), 0.04, 0.1);
        let prediction = track.prior(&camera(&Pose2::default()), &MODEL());
        let (known, seen) = (prediction.prior.covariance[(STRETCH_ROW, STRETCH_ROW)], sigma * sigma);
        let mut refined = Refined {
            map_from_optical: prediction.prior.map_from_optical,
            covariance: prediction.prior.covariance,
            by_paint: Matrix6::zeros(),
            moved: Errors::zeros(),
            cost: 0.0,
            condition: 1.0,
            lines: Agreement::default(),
        };
        refined.moved[STRETCH_ROW] = known / (known + seen) * (stretch - track.lens().stretch);
        refined.covariance[(STRETCH_ROW, STRETCH_ROW)] = known * seen / (known + seen);
        track.update(&prediction, &refined);
    }
    track
}

const STRETCH_ROW: usize = 6;

#[test]
fn what_frames_have_in_common_counts_by_time_and_not_by_frames() {
    // A frame that says more than the calibration counts at once.
    let (stretch, sigma) = told_of_the_lens(0.004, 0.001, 1, 1);
    assert!((stretch - 0.004).abs() < 0.0003 && sigma < 0.0011, "{stretch} {sigma}");
    let [slow, fast] = [10, 100].map(|rate_hz| told_of_the_lens(0.004, 0.001, rate_hz, 30));
    assert!((slow.0 - 0.004).abs() < 0.0001 && (fast.0 - 0.004).abs() < 0.0001, "{slow:?} {fast:?}");
    assert!((slow.1 / fast.1 - 1.0).abs() < 0.05, "ten times the frames say no more: {slow:?} {fast:?}");
    let independent = (slow.1 / 0.001).powi(-2);
    assert!((15.0..=33.0).contains(&independent), "as much as an independent frame a second, or half a one: {slow:?}");
}

#[test]
fn a_doubted_lens_is_learnt_anew_at_the_right_pose() {
    let wrong = told_again(SlowStateFilter::around(Pose2::default(), 0.05, 0.05, &MODEL()), 0.01, 0.001, 10, 20);
    let elsewhere = wrong.moved_to(Pose2::new(1.0, 0.0, 0.0), 0.05, 0.05);
    let stays = told_again(elsewhere.clone(), 0.0, 0.001, 10, 1).lens().stretch;
    let again = told_again(elsewhere.with_lens_doubted(&MODEL()), 0.0, 0.001, 10, 1).lens().stretch;
    assert!(stays > 0.008 && again.abs() < 0.001, "{stays} {again}");
}

#[test]
fn forgetting_the_lean_changes_no_other_state() {
    let mut track = walked(60, Some, Some);
    for index in [TORSO_ROLL, TORSO_PITCH, MOUNT_ROLL, MOUNT_PITCH, HEIGHT] {
        track.mean[index] = 0.01;
    }
    let (anew, begun) =
        (track.clone().with_lean_forgotten(&MODEL()), SlowStateFilter::around(track.pose(), 0.0, 0.0, &MODEL()));
    for index in 0..STATES {
        let of = if (TORSO_ROLL..=HEIGHT).contains(&index) { &begun } else { &track };
        assert_eq!(
            (anew.mean[index], anew.covariance[(index, index)]),
            (of.mean[index], of.covariance[(index, index)])
        );
    }
    assert!(nalgebra::SymmetricEigen::new(anew.covariance).eigenvalues.min() > 0.0);
}

#[test]
fn the_covariance_stays_one_whatever_is_doubted() {
    let mut track = walked(30, Some, Some);
    for round in 0..200 {
        let off = Errors::repeat(10f64.powi(round % 7 - 4));
        track.doubt(&off);
        let told = Step { odometry: None, turned_rad: None, seconds: 1e-9, stamp_sigma_s: 0.0 };
        track.predict(&told, &MODEL(), 0.04, 0.1);
        let prediction = track.prior(&Isometry::IDENTITY, &MODEL()).doubted(&off);
        let refined = Refined {
            map_from_optical: prediction.prior.map_from_optical,
            covariance: ErrorCovariance::identity() * 1e-12,
            by_paint: Matrix6::zeros(),
            moved: off,
            cost: 0.0,
            condition: 1.0,
            lines: Agreement::default(),
        };
        track.update(&prediction, &refined);
        let least = nalgebra::SymmetricEigen::new(track.covariance).eigenvalues.min();
        let most = nalgebra::SymmetricEigen::new(track.covariance).eigenvalues.max();
        assert!(least > -1e-12 * most && most.is_finite(), "round {round}: {least} of {most}");
    }
}

/// The standard deviations of the ends of a step are independent, so that they add up as squares.
#[test]
fn what_has_no_stamp_is_less_certain_by_speed_times_time() {
    let spread = |stamp_sigma_s: f64| {
        let mut track = SlowStateFilter::around(Pose2::default(), 0.0, 0.0, &MODEL());
        let odometry = Some(Pose2::new(0.05, 0.0, 0.02));
        track.predict(&Step { odometry, turned_rad: None, seconds: 0.1, stamp_sigma_s }, &MODEL(), 0.04, 0.1);
        (track.covariance[(Y, Y)], track.covariance[(YAW, YAW)])
    };
    let (stamped, unstamped) = (spread(0.0), spread(0.01));
    let speed_m_per_s = 0.5;
    let turn_rad_per_s = 0.2;
    assert!((unstamped.0 - stamped.0 - 2.0 * (0.01f64 * speed_m_per_s).powi(2)).abs() < 1e-12);
    assert!((unstamped.1 - stamped.1 - 2.0 * (0.01f64 * turn_rad_per_s).powi(2)).abs() < 1e-12);
    assert_eq!(Step { stamp_sigma_s: 0.01, ..Step::none() }.time_error(1.0), 0.0, "in no time nothing moves");
}
