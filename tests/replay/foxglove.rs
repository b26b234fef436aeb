//! Logs with Foxglove's schemas, written by Foxglove's own packages, and other spellings of ROS 2 types.

use std::process::Command;
use std::sync::Arc;

use realitysim::ros2::messages::{Header, Image, Odometry, TFMessage, TransformStamped};
use realitysim::ros2::{Channel, LogMessage, Message};

use super::support::{
    IMAGE, ODOMETRY, Replayed, Room, TF, assert_same, decode_all, message, on, own_log, read_capture, session_name,
    walk,
};

/// Names a Python interpreter that has Foxglove's packages.
const INTERPRETER: &str = "REALITYSIM_PYTHON";
const WRITERS: [&str; 2] = ["sdk", "protobuf"];

fn interpreter() -> Option<std::ffi::OsString> {
    let python = std::env::var_os(INTERPRETER);
    assert!(python.is_some() || std::env::var("CI").is_err(), "{INTERPRETER} is not set: `./dev test` sets it");
    if python.is_none() {
        println!("skipped: {INTERPRETER} names no interpreter");
    }
    python
}

/// The messages as `foxglove.mcap`, written by one of the writers of to_foxglove.py.
fn as_foxglove(messages: &[LogMessage], writer: &str, python: &std::ffi::OsStr) -> Room {
    let room = Room::new();
    room.write("ros.mcap", own_log(messages));
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/to_foxglove.py");
    let paths = [room.path("ros.mcap"), room.path("foxglove.mcap")];
    let output = Command::new(python).arg(script).args(paths).arg(writer).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    room
}

/// Every type of the capture is one of ROS 2.
fn assert_all_ros2(replayed: &Replayed) {
    for message in read_capture(&replayed.session) {
        assert!(message.channel.is_ros2(), "{:?}", message.channel);
    }
}

#[test]
fn a_log_of_foxglove_gives_the_tags_of_the_ros_log() {
    let Some(python) = interpreter() else { return };
    for writer in WRITERS {
        let room = as_foxglove(&walk().messages, writer, &python);
        let replayed = room.replay("foxglove.mcap");
        assert_same(&replayed.tags, &walk().tags, writer);
        assert_eq!(replayed.count("bad_messages"), 0, "{writer}");
        assert_all_ros2(&replayed);
        let again = room.run(&format!("replay {} -o again --json", session_name(&replayed))).succeeds();
        assert_eq!(again.json()["frames"].as_u64(), Some(walk().frames() as u64), "{writer}");
        let capture = read_capture(&replayed.session);
        assert!(decode_all::<Odometry>(&capture, ODOMETRY) == decode_all(&walk().messages, ODOMETRY), "{writer}");
    }
}

#[test]
fn raw_images_and_transforms_of_foxglove_say_the_same() {
    let Some(python) = interpreter() else { return };
    let mut messages = walk().messages.clone();
    for old in &mut messages {
        if old.channel.topic == IMAGE {
            let compressed = realitysim::ros2::messages::CompressedImage::decode(&old.data).unwrap();
            let pixels = image::load_from_memory(&compressed.data).unwrap().to_rgb8();
            *old = message(900, "/camera/image_raw", old.log_time_ns, &bgr(compressed.header, &pixels));
        } else if old.channel.topic == ODOMETRY {
            let odometry = Odometry::decode(&old.data).unwrap();
            *old = message(901, TF, old.log_time_ns, &as_transform(&odometry));
        }
    }
    let expected = Room::with_log(&messages).replay("log.mcap");
    assert!(10 * expected.count("valid") >= 9 * walk().frames(), "{}", expected.report);
    for writer in WRITERS {
        let room = as_foxglove(&messages, writer, &python);
        let replayed = room.replay("foxglove.mcap");
        assert_same(&replayed.tags, &expected.tags, writer);
        assert_all_ros2(&replayed);
    }
}

#[test]
fn joints_of_foxglove_turn_the_head() {
    let Some(python) = interpreter() else { return };
    let ros = Room::new();
    // What moves the robot stands before what its sensors add.
    let head = "[[effect]]\nkind = \"head_motion\"\nrole = \"base\"\npan_amplitude_deg = 30.0\npan_period_s = 4.0\n\
                tilt_amplitude_deg = 8.0\ntilt_period_s = 2.7\nencoder_noise_deg = 0.05\n\n";
    let odometry = "[[effect]]\nkind = \"odometry_error\"";
    ros.write_scene("scene.toml", |text| text.replace(odometry, &format!("{head}{odometry}")));
    ros.run("scene render scene.toml -o log.mcap").succeeds();
    let messages = super::support::read_log(&ros.path("log.mcap"));
    assert!(on(&messages, "/joint_states").next().is_some());
    let expected = ros.replay("log.mcap");
    for writer in WRITERS {
        let room = as_foxglove(&messages, writer, &python);
        let written = super::support::read_log(&room.path("foxglove.mcap"));
        let joints = on(&written, "/joint_states").next().unwrap();
        assert_eq!(joints.channel.type_name, "foxglove.JointStates");
        assert_same(&room.replay("foxglove.mcap").tags, &expected.tags, writer);
    }
}

fn bgr(header: Header, pixels: &image::RgbImage) -> Image {
    let (width, height) = pixels.dimensions();
    let data = pixels.pixels().flat_map(|p| [p[2], p[1], p[0]]).collect();
    Image { header, height, width, encoding: "bgr8".into(), is_bigendian: 0, step: 3 * width, data }
}

fn as_transform(odometry: &Odometry) -> TFMessage {
    let pose = odometry.pose.pose;
    let mut transform = TransformStamped {
        header: odometry.header.clone(),
        child_frame_id: odometry.child_frame_id.clone(),
        ..TransformStamped::default()
    };
    (transform.transform.translation.x, transform.transform.translation.y) = (pose.position.x, pose.position.y);
    transform.transform.translation.z = pose.position.z;
    transform.transform.rotation = pose.orientation;
    TFMessage { transforms: vec![transform] }
}

/// The walk with the channels of its messages changed.
fn with_channels(change: impl Fn(&mut Channel)) -> Vec<LogMessage> {
    let mut messages = walk().messages.clone();
    for message in &mut messages {
        let mut channel = message.channel.as_ref().clone();
        change(&mut channel);
        message.channel = Arc::new(channel);
    }
    messages
}

#[test]
fn other_spellings_of_ros_types_give_the_same_tags() {
    let spelled: [fn(&str, &str) -> String; 3] = [
        |package, name| format!("{package}/{name}"),
        |package, name| format!("{package}::msg::{name}"),
        |package, name| format!("{package}::msg::dds_::{name}_"),
    ];
    for (spell, schema) in spelled.into_iter().zip(["ros2idl", "ros2idl", "omgidl"]) {
        let messages = with_channels(|channel| {
            let (package, name) = channel.type_name.split_once("/msg/").unwrap();
            channel.type_name = spell(package, name);
            channel.schema_encoding = schema.to_owned();
            channel.definition = b"// an IDL, which nothing here reads\n".as_slice().into();
        });
        let replayed = Room::with_log(&messages).replay("log.mcap");
        assert_same(&replayed.tags, &walk().tags, &messages[0].channel.type_name);
    }
}

#[test]
fn json_of_foxglove_is_refused_with_what_is_read() {
    let mut messages = walk().messages.clone();
    for message in messages.iter_mut().filter(|message| message.channel.topic == IMAGE) {
        let mut channel = message.channel.as_ref().clone();
        channel.type_name = "foxglove.CompressedImage".to_owned();
        (channel.message_encoding, channel.schema_encoding) = ("json".to_owned(), "jsonschema".to_owned());
        (message.channel, message.data) = (Arc::new(channel), b"{}".to_vec());
    }
    let words = ["log.mcap", IMAGE, "foxglove.CompressedImage in json", "in protobuf"];
    Room::with_log(&messages).run("replay log.mcap -o captures").fails(1, &words);
}

#[test]
fn a_broken_message_of_foxglove_is_damage_that_is_told() {
    let Some(python) = interpreter() else { return };
    let room = as_foxglove(&walk().messages, "protobuf", &python);
    let mut messages = super::support::read_log(&room.path("foxglove.mcap"));
    let broken = on(&walk().messages, IMAGE).nth(5).unwrap().log_time_ns;
    let is_broken = |message: &&mut LogMessage| message.channel.topic == IMAGE && message.log_time_ns == broken;
    messages.iter_mut().find(is_broken).unwrap().data.truncate(300);
    let replayed = Room::with_log(&messages).replay("log.mcap");
    assert_eq!(replayed.tags.len(), walk().frames() - 1);
    let run = replayed
        .run
        .fails(3, &["log.mcap", "300 bytes not used", IMAGE, "foxglove.CompressedImage", "not what its type says"]);
    assert!(run.stdout.contains("\"bad_messages\":0"), "{run:?}");
}
