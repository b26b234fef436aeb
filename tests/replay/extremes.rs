//! Measurements at the ends of the exponent range: what is smaller than any sensor can tell is zero, what no robot can have made is
//! counted and left out, and no tag's number ever becomes anything but finite.

use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{Imu, Odometry, PoseWithCovarianceStamped, Quaternion};

use super::support::{IMU, INITIAL, ODOMETRY, Room, changed, walk};
use crate::numerics::support::assert_sound;

fn part(q: &mut Quaternion, index: usize) -> &mut f64 {
    [&mut q.x, &mut q.y, &mut q.z, &mut q.w].into_iter().nth(index % 4).expect("one of four")
}

/// From the fifth on, every fourth message of IMU and odometry has this value in one of its numbers, each time in the next one.
fn with_extremes(value: f64) -> Vec<LogMessage> {
    let mut count = 0;
    let mut next = move || {
        count += 1;
        (count > 4 && count % 4 == 0).then_some(count / 4)
    };
    let messages = changed::<Imu>(&walk().messages, IMU, |imu| {
        let Some(index) = next() else { return };
        match index % 7 {
            0 => imu.angular_velocity.x = value,
            1 => imu.angular_velocity.y = value,
            2 => imu.angular_velocity.z = value,
            _ => *part(&mut imu.orientation, index) = value,
        }
    });
    let mut count = 0;
    changed::<Odometry>(&messages, ODOMETRY, |odometry| {
        count += 1;
        let pose = &mut odometry.pose.pose;
        match count {
            0..5 => {}
            _ if count % 4 != 0 => {}
            _ => match count / 4 % 5 {
                0 => pose.position.x = value,
                1 => pose.position.y = value,
                2 => pose.position.z = value,
                _ => *part(&mut pose.orientation, count / 4) = value,
            },
        }
    })
}

#[test]
fn no_number_of_a_measurement_makes_a_tag_s_number_infinite() {
    for value in [5e-324, 1e-310, 1e-160, -1e-160, 1e-80, 1e80, 1e154, -1e300, f64::MAX, f64::INFINITY, f64::NAN] {
        let room = Room::with_log(&with_extremes(value));
        let replayed = room.replay("log.mcap");
        replayed.tags.iter().for_each(assert_sound);
        assert_eq!(replayed.tags.len(), walk().frames(), "{value:e}");
        assert!(replayed.tags.iter().all(|tag| tag.reason != "numerical_fault"), "{value:e}");
        let warnings = replayed.report["warnings"].to_string();
        assert!(!warnings.contains("begin anew"), "{value:e}: {warnings}");
        let is_wild = value.is_nan() || value.abs() > 1.0;
        assert_eq!(replayed.count("impossible_measurements") > 0, is_wild, "{value:e}");
        assert_eq!(
            warnings.contains("no covariance: they were recorded, but not used"),
            is_wild,
            "{value:e}: {warnings}"
        );
    }
}

/// One message of many, of a gyro at rest: its square is smaller than any number.
#[test]
fn a_turn_rate_whose_square_underflows_is_as_good_as_zero() {
    let with = |value: f64| {
        let mut count = 0;
        let messages = changed::<Imu>(&walk().messages, IMU, |imu| {
            count += 1;
            if count % 5 == 0 {
                imu.angular_velocity.x = value;
            }
        });
        Room::with_log(&messages).replay("log.mcap").tags
    };
    let (zero, tiny) = (with(0.0), with(1e-160));
    assert!(zero.iter().filter(|tag| tag.valid).count() * 2 > zero.len());
    super::support::assert_same(&tiny, &zero, "1e-160 rad/s");
}

#[test]
fn a_covariance_that_is_none_is_counted_and_the_place_believed() {
    for (index, value) in [(0, 1e308), (7, f64::NAN), (35, -1.0), (0, f64::INFINITY), (1, 3.0)] {
        let messages = changed::<PoseWithCovarianceStamped>(&walk().messages, INITIAL, |initial| {
            initial.pose.covariance[index] = value;
        });
        let room = Room::with_log(&messages);
        let replayed = room.replay("log.mcap");
        replayed.tags.iter().for_each(assert_sound);
        assert_eq!(replayed.count("impossible_measurements"), 1, "covariance[{index}] = {value}");
        super::support::assert_same(&replayed.tags, &walk().tags, "as if it had stated nothing");
    }
}
