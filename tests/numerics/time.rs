//! Clocks that stand, jump and go back; odometry that jumps, freezes and is no number; a robot that falls. A tag is right,
//! or invalid and finite (`Robot::tag` asserts it of each).

use core::f64::consts::FRAC_PI_2;

use glam::{DQuat, DVec3};
use realitysim::config::Settings;
use realitysim::geometry::{Isometry, Pose2, longest_axis};
use realitysim::localization::motion::{MotionModel, predict, wander};
use realitysim::localization::particles::Particles;
use realitysim::ros2::messages::FrameTag;

use super::support::{FRAME_NS, Robot, place, small_lens, usual_place};

fn robot() -> Robot {
    let mut robot = Robot::at(Pose2::new(-1.2, 0.4, 0.5), &small_lens(), &Settings::default());
    robot.settle();
    robot
}

/// Walks for one frame at 25 cm a second, and odometry counts it.
fn walk(robot: &mut Robot) {
    let step = Pose2::new(0.025, 0.0, 0.01);
    robot.pose = robot.pose.compose(&step);
    robot.odometry = robot.odometry.map(|odometry| odometry.compose(&step));
}

fn valid_within(robot: &mut Robot, frames: usize) {
    assert!((0..frames).any(|_| robot.step().valid), "not found again after {frames} frames");
}

#[test]
fn equal_stamps_and_steps_of_a_nanosecond_are_frames_like_others() {
    let mut robot = robot();
    for later in [0, 0, 1, 1, 0, 1] {
        robot.stamp_ns += later;
        assert!(robot.tag(&robot.view()).valid, "{later} ns later");
    }
}

#[test]
fn stamps_that_go_back_move_nobody() {
    let mut robot = robot();
    for back_ns in [1, FRAME_NS, 1_000_000_000, 3_600_000_000_000] {
        robot.stamp_ns -= back_ns;
        robot.step();
        valid_within(&mut robot, 3);
    }
    for stamp_ns in [i64::MIN, i64::MAX - 10 * FRAME_NS, 0, -1] {
        robot.stamp_ns = stamp_ns;
        robot.step();
    }
    valid_within(&mut robot, 12);
}

/// Noise grows for five seconds and no longer: the tag after an hour is that after five seconds, to the bit.
#[test]
fn a_gap_of_an_hour_costs_no_more_than_five_seconds() {
    let after = |gap_ns: i64| {
        let mut robot = robot();
        robot.stamp_ns += gap_ns;
        let tag = robot.step();
        valid_within(&mut robot, 10);
        (tag.pose, tag.best_particle, tag.particles)
    };
    let [second, five, hour] = [1_000_000_000, 5_000_000_000, 3_600_000_000_000].map(after);
    assert_eq!(five, hour);
    assert_ne!(five, second, "a gap tells at all");
}

#[test]
fn a_robot_that_walked_on_for_an_hour_unseen_is_not_wrong() {
    let mut robot = robot();
    robot.stamp_ns += 3_600_000_000_000;
    for _ in 0..40 {
        walk(&mut robot);
    }
    for _ in 0..10 {
        robot.step();
    }
}

#[test]
fn frames_before_the_first_odometry_are_invalid_and_no_more() {
    let mut robot = Robot::at(Pose2::new(-1.2, 0.4, 0.5), &small_lens(), &Settings::default());
    robot.odometry = None;
    for _ in 0..4 {
        let tag = robot.step();
        assert!(!tag.valid, "{tag:?}");
    }
    robot.odometry = Some(Pose2::new(44.0, -3.0, 2.0));
    valid_within(&mut robot, 4);
}

#[test]
fn odometry_that_jumps_a_hundred_metres_is_not_believed() {
    let mut robot = robot();
    for jump in [Pose2::new(100.0, 0.0, 0.0), Pose2::new(-1e9, 1e9, 3.0), Pose2::new(1e300, -1e300, 1e300)] {
        robot.odometry = Some(jump);
        for _ in 0..3 {
            walk(&mut robot);
            robot.step();
        }
        robot.odometry = Some(Pose2::default());
        robot.step();
        valid_within(&mut robot, 6);
    }
}

#[test]
fn odometry_that_is_no_number_counts_as_none() {
    let mut robot = robot();
    for bad in [
        Pose2::new(f64::NAN, 0.0, 0.0),
        Pose2::new(0.0, 0.0, f64::INFINITY),
        Pose2::new(f64::NEG_INFINITY, 0.0, f64::NAN),
    ] {
        robot.odometry = Some(bad);
        for _ in 0..3 {
            robot.step();
        }
        robot.odometry = Some(Pose2::default());
        valid_within(&mut robot, 6);
    }
}

/// It cannot say more than 250 degrees a second, and the robot turns faster; then it hangs at an end of its range.
#[test]
fn a_gyro_at_its_limit_misleads_nobody() {
    let limit = |rate_deg_s: f64| Some((rate_deg_s * FRAME_NS as f64 * 1e-9).to_radians());
    for way in [1.0, -1.0] {
        let mut robot = robot();
        for _ in 0..8 {
            let step = Pose2::new(0.0, 0.0, way * 30f64.to_radians());
            robot.pose = robot.pose.compose(&step);
            robot.odometry = robot.odometry.map(|odometry| odometry.compose(&step));
            robot.turned_rad = limit(way * 250.0);
            robot.step();
        }
        robot.turned_rad = Some(0.0);
        valid_within(&mut robot, 30);
        for hanging in [limit(way * 250.0), limit(way * 2000.0), Some(f64::NAN), Some(way * f64::INFINITY)] {
            robot.turned_rad = hanging;
            for _ in 0..6 {
                walk(&mut robot);
                robot.step();
            }
            robot.turned_rad = None;
            valid_within(&mut robot, 30);
        }
    }
}

#[test]
fn odometry_that_freezes_while_the_robot_walks_misleads_nobody() {
    let mut robot = robot();
    for _ in 0..25 {
        let last_odometry = robot.odometry;
        walk(&mut robot);
        robot.odometry = last_odometry;
        robot.step();
    }
    for _ in 0..15 {
        walk(&mut robot);
        robot.step();
    }
    valid_within(&mut robot, 5);
}

#[test]
fn a_step_in_no_time_or_in_a_nanosecond_spreads_by_as_much_as_was_walked() {
    let spread = |seconds: f64, step: Pose2| {
        let mut particles = Particles { poses: vec![Pose2::default(); 2000], log_weights: vec![0.0; 2000] };
        predict(&MotionModel::default(), &mut particles, step, seconds, 1, 1);
        assert!(particles.poses.iter().all(Pose2::is_finite));
        particles.poses.iter().map(|pose| (pose.x - step.x).abs()).fold(0.0, f64::max)
    };
    assert_eq!(spread(0.0, Pose2::default()), 0.0);
    assert!(spread(1e-9, Pose2::default()) < 1e-5);
    assert!((0.01..0.2).contains(&spread(0.0, Pose2::new(0.1, 0.0, 0.0))));
    // Time that runs backwards is no time.
    assert_eq!(spread(-5.0, Pose2::default()), 0.0);
    let mut particles = Particles { poses: vec![Pose2::default(); 10], log_weights: vec![0.0; 10] };
    wander(&MotionModel::default(), &mut particles, -1.0, 1, 1);
    assert!(particles.poses.iter().all(|pose| *pose == Pose2::default()));
}

/// 500 degrees a second: from upright to lying in 180 ms, told 20 ms late.
#[test]
fn a_robot_that_falls_at_500_degrees_a_second_says_nothing_wrong() {
    for roll in [false, true] {
        let mut robot = robot();
        let lying = |share: f64| {
            let angle = FRAC_PI_2 * share;
            let height = 0.05 + 0.44 * angle.cos();
            if roll { place(height, 0.0, 0.3, angle) } else { place(height, 0.0, 0.3 + angle, 0.0) }
        };
        for millisecond in (0..=200).step_by(33) {
            let share = |ms: f64| (ms * 500.0 / 1000.0 / 90.0).clamp(0.0, 1.0);
            robot.place = lying(share(f64::from(millisecond)));
            robot.told_place = lying(share(f64::from(millisecond) - 20.0));
            robot.tag(&robot.view());
            robot.stamp_ns += 33_000_000;
        }
        for _ in 0..10 {
            robot.told_place = robot.place;
            robot.step();
        }
        // Gets up where it fell.
        (robot.place, robot.told_place) = (usual_place(), usual_place());
        valid_within(&mut robot, 30);
    }
}

#[test]
fn quaternions_unnormalised_or_with_the_other_sign_are_the_same_rotation() {
    let q = DQuat::from_euler(glam::EulerRot::ZYX, 0.3, -0.2, 0.1);
    let plain = Isometry::new(q, DVec3::ONE);
    for factor in [-1.0, 1e-9, 1e9, 3.0, -0.25] {
        let other = Isometry::new(q * factor, DVec3::ONE);
        let off = (plain.transform_point(DVec3::X) - other.transform_point(DVec3::X)).length();
        assert!(off < 1e-15 && (other.rotation.length() - 1.0).abs() < 1e-15, "{factor}: {off}");
        assert!((plain.interpolate(&other, 0.5).rotation.dot(q).abs() - 1.0).abs() < 1e-15, "{factor}");
    }
    for bad in [
        DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0),
        DQuat::from_xyzw(f64::NAN, 0.0, 0.0, 1.0),
        DQuat::from_xyzw(1e300, 1e300, 1e300, 0.0),
    ] {
        let pose = Isometry::new(bad, DVec3::ONE);
        assert!((pose.rotation.length() - 1.0).abs() < 1e-15, "{bad}: {}", pose.rotation);
    }
}

/// Minutes without a frame, of walking and of nonsense from odometry: predictions say less and less, then nothing, and
/// who does not go on from them is the same to the bit as if nobody had asked.
#[test]
fn a_prediction_over_minutes_grows_uncertain_and_changes_only_its_copy() {
    for broken in [None, Some(Pose2::new(f64::NAN, 0.0, 0.0)), Some(Pose2::new(1e300, -1e300, 1e300))] {
        let mut robot = robot();
        let mut asked_nothing = robot.clone();
        let mut ahead = robot.state();
        let mut sigma_m = 0.0;
        let mut predicted = 0;
        for step in 0..3_000 {
            robot.stamp_ns += FRAME_NS;
            walk(&mut robot);
            let odometry = robot.odometry;
            if step % 7 == 3 && broken.is_some() {
                robot.odometry = broken;
            }
            let tag = robot.predict_ahead(&mut ahead);
            robot.odometry = odometry;
            let Some(tag) = tag else { continue };
            let now_m = longest_axis(tag.pose.covariance[0], tag.pose.covariance[1], tag.pose.covariance[7]);
            assert!(!tag.valid && now_m >= sigma_m && now_m < 0.61, "{now_m} m after {sigma_m} m");
            (sigma_m, predicted) = (now_m, predicted + 1);
        }
        assert!((20..2_500).contains(&predicted), "{predicted}: known for a while, and not for ever");
        (asked_nothing.stamp_ns, asked_nothing.pose, asked_nothing.odometry) =
            (robot.stamp_ns, robot.pose, robot.odometry);
        let (asked, other) = (robot.step(), asked_nothing.step());
        assert_eq!(asked, FrameTag { elapsed_ms: asked.elapsed_ms, ..other });
    }
}
