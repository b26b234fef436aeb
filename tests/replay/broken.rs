//! Broken images and impossible measurements: the replay goes on, and says what it met.

use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{
    CompressedImage, DiagnosticArray, FrameTag, Imu, Odometry, PoseWithCovarianceStamped, TFMessage,
};

use crate::numerics::support::assert_sound;

use super::support::{
    IMAGE, IMU, INITIAL, ODOMETRY, Replayed, Room, TF_STATIC, assert_same, changed, decode_all, on, read_capture, walk,
};

/// Frames `from` to `to` get other bytes.
fn with_images(from: usize, to: usize, change: impl Fn(&mut Vec<u8>)) -> Vec<LogMessage> {
    let mut number = 0;
    changed::<CompressedImage>(&walk().messages, IMAGE, |image| {
        if (from..to).contains(&number) {
            change(&mut image.data);
        }
        number += 1;
    })
}

fn replayed(messages: &[LogMessage]) -> Replayed {
    let room = Room::with_log(messages);
    let replayed = room.replay("log.mcap");
    assert_eq!(replayed.tags.len(), walk().frames(), "every frame is tagged");
    replayed.tags.iter().for_each(assert_sound);
    let written: Vec<CompressedImage> = decode_all(&read_capture(&replayed.session), IMAGE);
    let source: Vec<CompressedImage> = decode_all(messages, IMAGE);
    assert!(written == source, "every frame is kept as it was");
    replayed
}

/// The bytes of some frames' messages, their CDR included.
fn with_frame_bytes(from: usize, to: usize, change: impl Fn(&mut Vec<u8>)) -> Vec<LogMessage> {
    let mut messages = walk().messages.clone();
    let frames = messages.iter_mut().filter(|message| message.channel.topic == IMAGE);
    frames.skip(from).take(to - from).for_each(|message| change(&mut message.data));
    messages
}

fn reasons(tags: &[FrameTag]) -> Vec<&str> {
    tags.iter().map(|tag| tag.reason.as_str()).collect()
}

#[test]
fn an_image_that_does_not_decode_is_kept_and_its_tag_invalid() {
    type Change = fn(&mut Vec<u8>);
    let changes: [(&str, Change); 5] = [
        ("torn", |data| data.truncate(data.len() / 3)),
        ("empty", Vec::clear),
        ("text", |data| *data = b"no image at all".to_vec()),
        ("zeros", |data| data.fill(0)),
        ("torn PNG", |data| *data = b"\x89PNG\r\n\x1a\n\0\0".to_vec()),
    ];
    for (name, change) in changes {
        let replayed = replayed(&with_images(15, 17, change));
        let expected: Vec<&str> =
            (0..walk().frames()).map(|i| if (15..17).contains(&i) { "image_broken" } else { "" }).collect();
        assert_eq!(reasons(&replayed.tags), expected, "{name}");
        assert!(replayed.tags.iter().all(|tag| tag.valid == tag.reason.is_empty()));
        let run = replayed.run.fails(3, &[IMAGE, "frame 15"]);
        let told = run.stderr.lines().find(|line| line.contains("frame 15")).unwrap();
        assert!(told.ends_with("such frames are tagged invalid)"), "{name}: torn in two: {told}");
        // Until then nothing is otherwise.
        assert_same(&replayed.tags[..15], &walk().tags[..15], name);
    }
}

#[test]
fn a_broken_frame_message_has_a_tag_as_long_as_its_stamp_is_whole() {
    type Change = fn(&mut Vec<u8>);
    let changes: [(&str, Change); 4] = [
        ("cut behind its stamp", |data| data.truncate(12)),
        ("cut in its pixels", |data| data.truncate(data.len() / 2)),
        ("a name that is none", |data| data[12..16].fill(0xff)),
        ("another message behind it", |data| data.extend_from_slice(&[7; 64])),
    ];
    for (name, change) in changes {
        let room = Room::with_log(&with_frame_bytes(15, 17, change));
        let replayed = room.replay("log.mcap");
        let expected: Vec<&str> =
            (0..walk().frames()).map(|i| if (15..17).contains(&i) { "image_broken" } else { "" }).collect();
        assert_eq!(reasons(&replayed.tags), expected, "{name}");
        for (tag, sound) in replayed.tags.iter().zip(&walk().tags) {
            assert_eq!(tag.header.stamp, sound.header.stamp, "{name}");
        }
        assert_eq!((replayed.count("bad_messages"), replayed.count("tagged")), (0, walk().frames()), "{name}");
        replayed.run.fails(3, &[IMAGE, "frame 15", "not what its type says"]);
    }
}

#[test]
fn a_frame_that_does_not_say_when_it_was_exposed_is_recorded_and_counted() {
    type Change = fn(&mut Vec<u8>);
    let changes: [(&str, Change); 4] = [
        ("cut in its stamp", |data| data.truncate(11)),
        ("empty", Vec::clear),
        ("no CDR", |data| data.fill(0x55)),
        ("zeros", |data| data.fill(0)),
    ];
    for (name, change) in changes {
        let messages = with_frame_bytes(15, 17, change);
        let room = Room::with_log(&messages);
        let replayed = room.replay("log.mcap");
        let frames = walk().frames();
        assert_eq!((replayed.count("frames"), replayed.count("tagged")), (frames, frames - 2), "{name}");
        assert_eq!(replayed.report["untagged"], serde_json::json!({ "no_stamp": 2 }), "{name}");
        assert!(replayed.tags.iter().all(|tag| tag.valid), "{name}");
        let manifest = std::fs::read_to_string(replayed.session.join("manifest.jsonl")).unwrap();
        assert!(manifest.contains(r#""untagged":{"no_stamp":2}"#), "{manifest}");
        let capture = read_capture(&replayed.session);
        assert!(on(&capture, IMAGE).map(|m| &m.data).eq(on(&messages, IMAGE).map(|m| &m.data)), "{name}: kept");
        let last = decode_all::<DiagnosticArray>(&capture, "/diagnostics").pop().unwrap();
        let value = last.status[0].values.iter().find(|value| value.key == "untagged_no_stamp");
        assert_eq!(value.map(|value| value.value.as_str()), Some("2"), "{last:?}");
        replayed.run.fails(3, &[IMAGE, "2 frames do not even say when they were exposed"]);
    }
}

#[test]
fn a_first_image_that_does_not_decode_does_not_stop_the_start() {
    let replayed = replayed(&with_images(0, 3, Vec::clear));
    assert_eq!(reasons(&replayed.tags)[..3], ["image_broken"; 3]);
    assert!(replayed.tags[6..].iter().all(|tag| tag.valid), "{:?}", reasons(&replayed.tags));
}

#[test]
fn a_log_of_broken_images_only_comes_to_its_end() {
    let replayed = replayed(&with_images(0, usize::MAX, Vec::clear));
    assert_eq!(replayed.count("valid"), 0);
    replayed.run.fails(1, &["tags is valid", "image_broken"]);
}

#[test]
fn an_image_of_another_size_than_the_lens_is_named() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text.replace("\"lens.toml\"", "\"fisheye-640\""));
    room.run("scene render scene.toml -o large.mcap").succeeds();
    let large = super::support::read_log(&room.path("large.mcap"));
    let mut images = on(&large, IMAGE).cloned();
    let mut messages = walk().messages.clone();
    let frames = messages.iter_mut().filter(|message| message.channel.topic == IMAGE);
    for (index, message) in frames.enumerate() {
        let other = images.next().unwrap();
        if index == 20 {
            message.data = other.data;
        }
    }
    let replayed = replayed(&messages);
    assert_eq!(replayed.tags[20].reason, "image_size");
    assert!(replayed.tags[21].valid);
    replayed.run.fails(3, &[IMAGE, "frame 20", "640 x 480", "320 x 240"]);
}

#[test]
fn numbers_that_are_none_do_no_harm() {
    let nan = f64::NAN;
    let mut count = 0;
    let mut now_and_then = move || {
        count += 1;
        count % 7 == 3
    };
    let mut then = now_and_then;
    let odometry = changed::<Odometry>(&walk().messages, ODOMETRY, |odometry| {
        if now_and_then() {
            odometry.pose.pose.position.x = nan;
        }
    });
    let orientation = changed::<Odometry>(&walk().messages, ODOMETRY, |odometry| {
        if then() {
            odometry.pose.pose.orientation.z = f64::INFINITY;
        }
    });
    let mut place = 0;
    let imu = changed::<Imu>(&walk().messages, IMU, |imu| {
        place += 1;
        match place % 9 {
            0 => imu.orientation.x = nan,
            1 => (imu.orientation.x, imu.orientation.y, imu.orientation.z, imu.orientation.w) = (0.0, 0.0, 0.0, 0.0),
            2 => imu.orientation.w = f64::INFINITY,
            _ => {}
        }
    });
    for (name, messages) in [("odometry", odometry), ("turn of the odometry", orientation), ("attitude", imu)] {
        let replayed = replayed(&messages);
        let valid = replayed.count("valid");
        assert!(10 * valid >= 9 * walk().frames(), "{name}: {valid} valid, {:?}", reasons(&replayed.tags));
    }
}

#[test]
fn odometry_without_any_number_is_none() {
    let messages = changed::<Odometry>(&walk().messages, ODOMETRY, |odometry| odometry.pose.pose.position.y = f64::NAN);
    let replayed = replayed(&messages);
    assert_eq!(replayed.count("valid"), 0, "{}", replayed.report);
    assert_eq!(replayed.tags[5].reason, "no_odometry");
}

#[test]
fn an_attitude_that_is_always_zero_is_none() {
    let messages = changed::<Imu>(&walk().messages, IMU, |imu| {
        imu.orientation = realitysim::ros2::messages::Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
        imu.angular_velocity_covariance[0] = -1.0;
    });
    // The torso is taken to be upright, as in a log without an IMU.
    let upright = Room::with_log(&super::support::without(&walk().messages, IMU)).replay("log.mcap");
    assert_same(&replayed(&messages).tags, &upright.tags, "without an attitude");
}

#[test]
fn an_initial_pose_without_numbers_is_passed_over() {
    let messages = changed::<PoseWithCovarianceStamped>(&walk().messages, INITIAL, |initial| {
        initial.pose.pose.position.x = f64::NAN;
        initial.pose.covariance = [f64::NAN; 36];
    });
    replayed(&messages);
    let messages = changed::<PoseWithCovarianceStamped>(&walk().messages, INITIAL, |initial| {
        initial.pose.covariance = [f64::NAN; 36];
    });
    assert!(replayed(&messages).tags[3].valid, "the pose is good, only its covariance is not");
}

fn with_mount_turned_by(w: f64) -> Vec<LogMessage> {
    changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        let rotation = &mut constants.transforms[0].transform.rotation;
        (rotation.x, rotation.y, rotation.z, rotation.w) = (0.0, 0.0, 0.0, w);
    })
}

#[test]
fn a_mount_turned_by_a_quaternion_of_zeros_is_not_turned() {
    replayed(&with_mount_turned_by(0.0));
}

#[test]
fn a_mount_turned_by_no_number_is_refused_by_name() {
    for wild in [f64::NAN, f64::INFINITY, 1e308] {
        let room = Room::with_log(&with_mount_turned_by(wild));
        room.run("replay log.mcap -o captures")
            .fails(1, &["the transform to base_link holds a number that is not finite"]);
    }
}

#[test]
fn a_message_that_is_cut_is_counted_and_kept() {
    let mut messages = walk().messages.clone();
    let cut = messages.iter_mut().filter(|message| message.channel.topic == IMU).nth(50).unwrap();
    cut.data.truncate(40);
    let room = Room::with_log(&messages);
    let replayed = room.replay("log.mcap");
    assert_eq!(replayed.count("bad_messages"), 1);
    assert_eq!(on(&read_capture(&replayed.session), IMU).count(), on(&messages, IMU).count());
    assert_eq!(replayed.tags.len(), walk().frames());
    replayed.run.fails(3, &["1 messages are not what their type says"]);
}
