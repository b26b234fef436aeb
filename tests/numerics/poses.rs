//! Cameras where no camera should be: straight down, straight up, on their side, on the carpet, far away. A tag is right,
//! or invalid and finite (`Robot::tag` asserts it of each).

use core::f64::consts::{FRAC_PI_2, PI};

use glam::DQuat;
use realitysim::config::Settings;
use realitysim::geometry::{Euler, Isometry, Pose2};

use super::support::{Robot, assert_sound, place, small_lens};
use realitysim_test_support::measured::largest_error;

fn robot(pose: Pose2, camera: Isometry) -> Robot {
    let mut robot = Robot::at(pose, &small_lens(), &Settings::default());
    (robot.place, robot.told_place) = (camera, camera);
    robot
}

fn angle_between(a: DQuat, b: DQuat) -> f64 {
    let d = a.conjugate() * b;
    2.0 * d.xyz().length().atan2(d.w.abs())
}

/// Yaw and roll turn about the same axis there: dividing by the cosine of pitch gives any angle.
#[test]
fn euler_angles_at_pitch_plus_and_minus_90_degrees_keep_the_rotation() {
    let mut largest = 0.0f64;
    for pitch in [FRAC_PI_2, -FRAC_PI_2] {
        for off in [0.0, 1e-16, 1e-12, 1e-10, 1e-9, 2e-9, 1e-8, 1e-6, 1e-3] {
            for (yaw, roll) in [(0.0, 0.0), (0.7, -2.0), (-3.1, 3.1), (PI, 0.0), (1e-9, 1e-9), (2.0, PI)] {
                let rotation = Euler { yaw, pitch: pitch - off * pitch.signum(), roll }.rotation();
                let found = Euler::from_rotation(rotation);
                assert!(found.yaw.is_finite() && found.roll.is_finite() && found.pitch.abs() <= FRAC_PI_2);
                if off == 0.0 {
                    assert_eq!(found.roll, 0.0, "there roll is 0");
                }
                largest = largest.max(angle_between(rotation, found.rotation()));
            }
        }
    }
    largest_error(largest, 8e-16, "rad");
}

#[test]
fn a_camera_straight_down_straight_up_or_on_its_side_gives_tags() {
    // Above the corner of the penalty area's lines, so that straight down there is something to see.
    let pose = Pose2::new(-2.4, 0.6, 0.3);
    for (name, pitch, roll) in [
        ("straight down", FRAC_PI_2, 0.0),
        ("straight up", -FRAC_PI_2, 0.0),
        ("on its left side", 0.2, -FRAC_PI_2),
        ("on its right side", 0.2, FRAC_PI_2),
        ("upside down", 0.3, PI),
        ("backwards over its head", PI - 0.4, 0.0),
    ] {
        let mut robot = robot(pose, place(0.49, 0.0, pitch, roll));
        let tags: Vec<_> = (0..4).map(|_| robot.step()).collect();
        let valid = tags.iter().filter(|tag| tag.valid).count();
        println!("{name}: {valid} of 4 valid, pitch {:.1} deg", tags[3].pitch.to_degrees());
        if name == "straight up" {
            assert_eq!(valid, 0, "the ceiling has no lines");
        }
        if name == "straight down" || name == "upside down" {
            assert!(valid > 0, "{name}");
        }
    }
}

/// A fallen robot: lines are as wide as the image, and everything far lies in one pixel row.
#[test]
fn a_camera_3_cm_above_the_carpet_says_nothing_wrong() {
    for pitch in [-0.5, 0.0, 0.1, 0.6, FRAC_PI_2] {
        for roll in [0.0, 0.7, FRAC_PI_2] {
            let mut robot = robot(Pose2::new(-1.2, 0.4, 0.5), place(0.03, 0.0, pitch, roll));
            for _ in 0..3 {
                robot.step();
            }
        }
    }
}

#[test]
fn a_field_seen_from_20_m_outside_is_no_place_to_stand() {
    for height in [0.5, 3.0, 15.0] {
        for pitch in [0.0, 0.1, 0.6] {
            let mut robot = robot(Pose2::new(-23.0, 1.0, 0.0), place(height, 0.0, pitch, 0.0));
            for _ in 0..3 {
                let tag = robot.tag(&robot.view());
                assert!(!tag.valid, "{height} m, {pitch}: {tag:?}");
                robot.stamp_ns += 100_000_000;
            }
        }
    }
}

/// Head up and tilted, so that lines run out of the image, over its rim and towards the horizon.
#[test]
fn lines_across_the_rim_and_the_horizon_are_cut_and_not_bent() {
    let mut valid = 0;
    for pitch in [-0.4, -0.1, 0.0, 0.15, 0.8] {
        for roll in [-0.5, 0.0, 0.9] {
            for yaw in [0.0, 2.0] {
                let mut robot = robot(Pose2::new(0.5, -0.7, yaw), place(0.49, 0.3, pitch, roll));
                valid += (0..3).map(|_| robot.step()).filter(|tag| tag.valid).count();
            }
        }
    }
    assert!(valid > 60, "{valid} of 90 tags");
}

#[test]
fn a_camera_at_or_below_the_ground_sees_nothing() {
    for height in [0.0, -0.0, 1e-12, 1e-3, -0.5, 1e6] {
        let mut robot = robot(Pose2::new(-1.2, 0.4, 0.5), place(height, 0.0, 0.3, 0.0));
        for _ in 0..2 {
            let view = robot.view();
            let tag = robot.tag(&view);
            assert_sound(&tag);
            assert!(!tag.valid || height > 0.0, "{height}");
        }
    }
}
