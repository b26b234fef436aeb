//! Messages that are logged late: the stamps of their headers count.

use realitysim::ros2::LogMessage;

use super::support::{IMAGE, IMU, ODOMETRY, Room, assert_same, farthest_apart, segments, stamp_later, walk};

const MS: i64 = 1_000_000;

/// Logged later by what `delay_ms` says of topic and place, in the order of the new times.
fn delayed(delay_ms: impl Fn(&str, u64) -> i64) -> Vec<LogMessage> {
    let mut messages = walk().messages.clone();
    for (place, message) in messages.iter_mut().enumerate() {
        message.log_time_ns += MS * delay_ms(&message.channel.topic, place as u64);
    }
    messages.sort_by_key(|message| message.log_time_ns);
    messages
}

/// 20 to 150, without a pattern.
fn jitter_ms(place: u64) -> i64 {
    20 + (place.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as i64 % 131
}

#[test]
fn measurements_that_come_late_give_the_same_tags() {
    for (name, image, imu, odometry) in [
        ("late odometry", 0, 20, 150),
        ("late IMU", 30, 150, 20),
        ("late images", 150, 20, 40),
        ("all late", 90, 90, 90),
    ] {
        let room = Room::with_log(&delayed(|topic, _| match topic {
            IMAGE => image,
            IMU => imu,
            ODOMETRY => odometry,
            _ => 0,
        }));
        let replayed = room.replay("log.mcap");
        // The last frames wait in vain for what the log does not hold any more, as they do without delays.
        let sure = walk().frames() - 1;
        assert_same(&replayed.tags[..sure], &walk().tags[..sure], name);
    }
}

#[test]
fn measurements_out_of_order_give_tags_as_good() {
    let room = Room::with_log(&delayed(|topic, place| match topic {
        IMU | ODOMETRY => jitter_ms(place),
        _ => 0,
    }));
    let replayed = room.replay("log.mcap");
    assert_eq!(replayed.run.code, Some(0), "{:?}", replayed.run);
    assert_eq!(replayed.count("late_measurements"), 0);
    let apart = farthest_apart(&replayed.tags, &walk().tags);
    println!("at most {apart} m apart");
    assert!(apart < 0.02, "{apart} m");
    assert_eq!(replayed.count("valid"), walk().tags.iter().filter(|tag| tag.valid).count());
}

#[test]
fn a_capture_out_of_order_is_split_without_a_trace() {
    let room = Room::with_log(&delayed(|topic, place| match topic {
        IMU | ODOMETRY => jitter_ms(place),
        _ => 0,
    }));
    assert_split_without_a_trace(&room);
}

#[test]
fn a_measurement_that_comes_far_too_late_is_counted_and_changes_nothing() {
    // Every twentieth, so that it stands alone.
    let messages = delayed(|topic, place| if topic == ODOMETRY && place % 20 == 7 { 1500 } else { 0 });
    let late = walk().messages.iter().enumerate().filter(|(place, m)| m.channel.topic == ODOMETRY && place % 20 == 7);
    let room = Room::with_log(&messages);
    let replayed = room.replay("log.mcap");
    // Those that come after the last one in time are not late but the newest there is.
    let counted = replayed.count("late_measurements");
    assert!(counted > 3 && counted <= late.count(), "{}", replayed.report);
    replayed.run.fails(3, &[&format!("{counted} measurements came more than a second after later ones")]);
    let apart = farthest_apart(&replayed.tags, &walk().tags);
    assert!(apart < 0.02, "{apart} m");
}

#[test]
fn a_clock_that_is_set_back_costs_a_few_frames() {
    let mut messages = walk().messages.clone();
    let half = messages.len() / 2;
    messages[half..].iter_mut().for_each(|message| stamp_later(message, -100_000 * MS));
    let room = Room::with_log(&messages);
    let replayed = room.replay("log.mcap");
    assert_eq!((replayed.run.code, replayed.count("late_measurements")), (Some(0), 0), "{}", replayed.report);
    assert_eq!(replayed.tags.len(), walk().frames());
    assert!(replayed.count("valid") + 4 >= walk().frames(), "{}", replayed.report);
}

#[test]
fn frames_out_of_order_are_all_tagged() {
    let room = Room::with_log(&delayed(|topic, place| if topic == IMAGE { jitter_ms(place) } else { 0 }));
    let replayed = room.replay("log.mcap");
    assert_eq!(replayed.tags.len(), walk().frames());
    assert!(10 * replayed.count("valid") >= 9 * walk().frames(), "{}", replayed.report);
}

#[test]
fn a_capture_is_split_although_a_frame_is_waiting_at_every_moment() {
    // A frame every 100 ms waits 150 ms for its odometry.
    let late = delayed(|topic, _| if topic == ODOMETRY { 150 } else { 0 });
    let room = Room::with_log(&late);
    assert_split_without_a_trace(&room);
}

#[test]
fn a_capture_without_odometry_is_split_as_well() {
    let room = Room::with_log(&super::support::without(&walk().messages, ODOMETRY));
    let parts = room.replay("log.mcap --motion random_walk --set recording.segment_s=1");
    assert!(segments(&parts.session).len() >= 3);
}

/// In segments of a second, together and each alone, the log gives the tags that it gives in one piece.
fn assert_split_without_a_trace(room: &Room) {
    let whole = room.replay("log.mcap");
    let parts = room.replay("log.mcap --set recording.segment_s=1");
    assert_same(&parts.tags, &whole.tags, "in parts");
    let files = segments(&parts.session);
    assert!(files.len() >= 3, "{files:?}");
    let mut alone = Vec::new();
    for file in &files {
        room.write("part.mcap", std::fs::read(file).unwrap());
        alone.extend(room.replay("part.mcap").tags);
    }
    assert_same(&alone, &whole.tags, "each part alone");
}
