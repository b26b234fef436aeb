//! Logs that cannot be replayed: each message names the file and what would be right, and nothing is left behind.

use std::fs;

use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::{CameraInfo, TFMessage, Transform};

use super::support::{
    CAMERA_INFO, IMAGE, LENS, ODOMETRY, Room, TF_STATIC, assert_same, changed, session_name, walk, without,
};

/// Exit code 1, these words, and no capture begun.
fn assert_refused(messages: &[LogMessage], words: &[&str]) -> Room {
    let room = Room::with_log(messages);
    let run = room.run("replay log.mcap -o captures").fails(1, &["log.mcap"]).fails(1, words);
    assert_eq!(run.stdout, "");
    assert!(!room.path("captures").exists(), "nothing is left behind");
    room
}

#[test]
fn a_file_that_is_no_log_is_told_by_what_it_is() {
    let room = Room::new();
    fs::create_dir(room.path("folder")).unwrap();
    room.write("folder/readme.txt", "a text");
    room.write("text.mcap", "a text, not a log\n");
    room.write("empty.mcap", "");
    room.write("bag.db3", b"SQLite format 3\0and so on");
    fs::create_dir(room.path("bag")).unwrap();
    room.write("bag/bag_0.db3", b"SQLite format 3\0and so on");
    for (source, words) in [
        ("missing.mcap", vec!["missing.mcap", "there is no such file"]),
        ("folder", vec!["folder", "no .mcap file", "capture"]),
        ("text.mcap", vec!["text.mcap", "an MCAP log is needed, and this file is a text"]),
        ("empty.mcap", vec!["empty.mcap", "an empty file"]),
        ("bag.db3", vec!["bag.db3", "SQLite", "rosbags-convert"]),
        ("bag", vec!["bag/bag_0.db3", "SQLite", "rosbags-convert"]),
        ("missing.toml", vec!["missing.toml", "there is no such file"]),
    ] {
        room.run(&format!("replay {source} -o captures")).fails(1, &words);
        assert!(!room.path("captures").exists());
        if !source.ends_with(".toml") {
            room.run(&format!("log info {source}")).fails(1, &words);
        }
    }
}

#[test]
fn a_log_without_odometry_is_replayed_as_a_random_walk_only() {
    let room =
        assert_refused(&without(&walk().messages, ODOMETRY), &["/odom", "topics.odometry", "--motion random_walk"]);
    let replayed = room.replay("log.mcap --motion random_walk");
    let valid = replayed.count("valid");
    assert!(2 * valid >= walk().frames(), "{}", replayed.report);
    // What was recorded of it is a capture, whose recorder went on without odometry as well.
    let again = room.run(&format!("replay {} -o again --json", session_name(&replayed)));
    assert_eq!(again.json()["frames"].as_u64(), Some(walk().frames() as u64), "{again:?}");
}

#[test]
fn a_log_without_a_camera_is_refused() {
    assert_refused(&without(&walk().messages, IMAGE), &[IMAGE, "CompressedImage"]);
}

#[test]
fn a_log_without_calibration_needs_a_lens_file() {
    let room = assert_refused(&without(&walk().messages, CAMERA_INFO), &[CAMERA_INFO, "camera.lens"]);
    room.write("lens.toml", LENS.replace("fov_deg = 200.0", ""));
    assert_same(&room.replay("log.mcap --lens lens.toml").tags, &walk().tags, "with a lens file");
}

#[test]
fn a_log_without_constants_is_refused() {
    assert_refused(&without(&walk().messages, TF_STATIC), &[TF_STATIC, "tf2_msgs/msg/TFMessage"]);
}

#[test]
fn a_calibration_of_zeros_is_refused() {
    let zero = changed::<CameraInfo>(&walk().messages, CAMERA_INFO, |info| info.k[0] = 0.0);
    assert_refused(&zero, &[CAMERA_INFO, "k[0] is 0", "focal length"]);
    // A driver that was never calibrated.
    let blank = changed::<CameraInfo>(&walk().messages, CAMERA_INFO, |info| (info.k, info.d) = ([0.0; 9], vec![]));
    assert_refused(&blank, &[CAMERA_INFO]);
    let other = changed::<CameraInfo>(&walk().messages, CAMERA_INFO, |info| info.distortion_model = "magic".into());
    assert_refused(&other, &[CAMERA_INFO, "magic", "plumb_bob"]);
    let part = changed::<CameraInfo>(&walk().messages, CAMERA_INFO, |info| info.roi.width = 10);
    assert_refused(&part, &[CAMERA_INFO, "roi is 10 x 0 pixels", "must lie within width x height, 320 x 240"]);
    let beyond = changed::<CameraInfo>(&walk().messages, CAMERA_INFO, |info| {
        (info.roi.x_offset, info.roi.width, info.roi.height) = (u32::MAX, 10, 10);
    });
    assert_refused(&beyond, &[CAMERA_INFO, "from column 4294967295, row 0"]);
    let binned = changed::<CameraInfo>(&walk().messages, CAMERA_INFO, |info| info.binning_y = 241);
    assert_refused(&binned, &[CAMERA_INFO, "binning_x, binning_y are 1, 241: no pixel is left"]);
}

#[test]
fn a_mount_of_zeros_is_refused() {
    let zeros = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        constants.transforms.iter_mut().for_each(|transform| transform.transform = Transform::default());
    });
    assert_refused(&zeros, &["0.000 m above the ground", TF_STATIC, "base_footprint", "camera_link"]);
    let unknown = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        constants.transforms[1].transform.translation.x = f64::NAN;
    });
    assert_refused(&unknown, &["camera_link"]);
    let ceiling = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        let optical = constants.transforms.iter_mut().find(|t| t.child_frame_id == "camera_optical_frame").unwrap();
        optical.transform = Transform::default();
        constants.transforms[1].transform.rotation = Default::default();
    });
    assert_refused(&ceiling, &["camera_optical_frame", "REP 103"]);
}

#[test]
fn a_missing_link_of_the_chain_is_named() {
    for child in ["base_link", "camera_link", "camera_optical_frame"] {
        let broken = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
            constants.transforms.retain(|transform| transform.child_frame_id != child);
        });
        assert_refused(&broken, &[&format!("no transform leads to {child}"), "base_footprint", TF_STATIC]);
    }
}

#[test]
fn an_optical_frame_of_another_name_is_known_from_the_images() {
    let mut messages = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        for transform in &mut constants.transforms {
            transform.child_frame_id = transform.child_frame_id.replace("camera_optical_frame", "eye_optical");
        }
    });
    messages = changed::<realitysim::ros2::messages::CompressedImage>(&messages, IMAGE, |image| {
        image.header.frame_id = "eye_optical".into();
    });
    assert_same(&Room::with_log(&messages).replay("log.mcap").tags, &walk().tags, "another name");
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let room = Room::with_walk();
    room.write("taken", "a file where the captures should go");
    room.run("replay log.mcap -o taken").fails(1, &["taken"]);
    room.run("replay log.mcap -o taken/captures").fails(1, &["taken"]);
    assert_eq!(fs::read_to_string(room.path("taken")).unwrap(), "a file where the captures should go");
}
