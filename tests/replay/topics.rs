//! Topics that are called otherwise than by default.

use std::sync::Arc;

use realitysim::ros2::{Channel, LogMessage};

use super::support::{CAMERA_INFO, IMAGE, IMU, ODOMETRY, Room, TF_STATIC, assert_same, on, read_capture, walk};

fn renamed(messages: &[LogMessage], names: &[(&str, &str)]) -> Vec<LogMessage> {
    let mut messages = messages.to_vec();
    for message in &mut messages {
        if let Some((_, new)) = names.iter().find(|(old, _)| *old == message.channel.topic) {
            message.channel = Arc::new(Channel { topic: (*new).to_owned(), ..message.channel.as_ref().clone() });
        }
    }
    messages
}

const OTHER: [(&str, &str); 5] = [
    (IMAGE, "/eye/image_raw/compressed"),
    (CAMERA_INFO, "/eye/info"),
    (IMU, "/torso/imu"),
    (ODOMETRY, "/walk/odometry"),
    (TF_STATIC, "/robot1/tf_static"),
];

#[test]
fn the_only_topic_of_a_type_is_found_by_itself() {
    let room = Room::with_log(&renamed(&walk().messages, &OTHER));
    let replayed = room.replay("log.mcap");
    assert_same(&replayed.tags, &walk().tags, "found by type");
    assert_eq!(on(&read_capture(&replayed.session), OTHER[0].1).count(), walk().frames(), "its name is kept");
    // What comes after knows the name as well.
    let session = replayed.session.display();
    room.run(&format!("export {session} --to images -o frames")).succeeds();
    let added = room.run(&format!("db add {session} --db db --json")).succeeds().json();
    let valid = replayed.tags.iter().filter(|tag| tag.valid && !tag.ambiguous).count();
    assert_eq!(added["images"], valid);
    let shown = room.run(&format!("sessions show {session} --json")).succeeds().json();
    assert!(shown["coverage"]["filled"].as_u64() > Some(0), "{shown}");
    let played = room.run(&format!("log play {session} --video out.mjpeg --speed 20 --json")).succeeds().json();
    assert_eq!(played["images"], walk().frames());
    // A repair that has nothing but the segments counts what the manifest had.
    let manifest = replayed.session.join("manifest.jsonl");
    let counted = |text: &str| -> Vec<u64> {
        let lines = text.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).expect("a line"));
        lines.map(|line| line["frames"]["written"].as_u64().expect("a count")).collect()
    };
    let before = counted(&std::fs::read_to_string(&manifest).expect("read"));
    std::fs::write(&manifest, "").expect("written");
    room.run("sessions repair --captures captures").succeeds();
    assert_eq!(counted(&std::fs::read_to_string(&manifest).expect("read")), before);
    assert_eq!(before.iter().sum::<u64>(), walk().frames() as u64);
}

/// As captures of earlier versions are: their `session.json` has the names that were asked for.
#[test]
fn a_command_that_finds_nothing_to_do_says_so_and_fails() {
    let room = Room::with_walk();
    let session = room.replay("log.mcap").session;
    let path = session.join("session.json");
    let text = std::fs::read_to_string(&path).expect("read");
    for topic in [IMAGE, ODOMETRY, IMU] {
        assert!(text.contains(topic));
    }
    let other = text.replace(IMAGE, "/other/image").replace(ODOMETRY, "/other/odometry").replace(IMU, "/other/imu");
    std::fs::write(&path, other).expect("written");
    let session = session.display();
    room.run(&format!("db add {session} --db db"))
        .fails(1, &["nothing was added", "no image on /other/image", "settings.topics.image"]);
    room.run("db stats --db db").fails(1, &["there is no database here"]);
    room.run(&format!("log play {session} --video out.mjpeg --speed 20"))
        .fails(1, &["nothing in it can be played: no image on /other/image"]);
}

#[test]
fn topics_are_named_on_the_command_line_where_there_are_two() {
    // A second camera, whose frames show nothing of use.
    let mut messages = renamed(&walk().messages, &OTHER);
    let second: Vec<LogMessage> =
        on(&walk().messages, CAMERA_INFO).chain(on(&walk().messages, IMAGE)).cloned().collect();
    messages.extend(renamed(&second, &[(IMAGE, "/back/compressed"), (CAMERA_INFO, "/back/info")]).into_iter().map(
        |mut message| {
            message.channel = Arc::new(Channel { id: message.channel.id + 50, ..message.channel.as_ref().clone() });
            message
        },
    ));
    messages.sort_by_key(|message| message.log_time_ns);
    let room = Room::with_log(&messages);
    room.run("replay log.mcap -o captures")
        .fails(1, &["/camera/image/compressed", "topics.image", "/back/compressed", "/eye/image_raw/compressed"]);
    let image = "--set topics.image=/eye/image_raw/compressed";
    let beside = room.replay(&format!("log.mcap {image}"));
    assert_same(&beside.tags, &walk().tags, "the calibration beside the image");
    let both = room.replay(&format!("log.mcap {image} --set topics.camera_info=/eye/info"));
    assert_same(&both.tags, &walk().tags, "named");
    assert_eq!(on(&read_capture(&both.session), "/back/compressed").count(), walk().frames(), "recorded all the same");
    assert_eq!(both.count("frames"), walk().frames(), "but not counted");
}

#[test]
fn names_in_a_config_file_count_as_those_on_the_command_line() {
    let room = Room::with_log(&renamed(&walk().messages, &OTHER));
    room.write("robot.toml", "robot = \"nina\"\n[topics]\nimage = \"/eye/image_raw/compressed\"\n");
    let replayed = room.replay("log.mcap --config robot.toml");
    assert_same(&replayed.tags, &walk().tags, "named in a file");
    assert!(replayed.session.to_str().unwrap().ends_with("-nina"));
}
