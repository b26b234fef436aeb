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
    room.run(&format!("replay log.mcap -o captures {image}"))
        .fails(1, &["/camera/camera_info", "topics.camera_info", "/back/info", "/eye/info"]);
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
