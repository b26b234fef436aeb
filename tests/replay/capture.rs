//! What a capture says about itself is right, and a capture is a log like any other.

use std::fs;
use std::path::Path;

use realitysim::ros2::messages::{FrameTag, PoseWithCovarianceStamped};
use serde_json::Value;

use super::support::{
    IMAGE, INITIAL, POSE, Replayed, Room, TAG, assert_same, decode_all, on, read_capture, read_log, segments, walk,
};

fn manifest(session: &Path) -> Vec<Value> {
    let text = fs::read_to_string(session.join("manifest.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn number(line: &Value, pointer: &str) -> u64 {
    line.pointer(pointer).and_then(Value::as_u64).unwrap_or_else(|| panic!("{pointer}: {line}"))
}

fn assert_manifest_is_right(replayed: &Replayed) {
    let lines = manifest(&replayed.session);
    let files = segments(&replayed.session);
    assert_eq!(lines.len(), files.len());
    for (line, file) in lines.iter().zip(&files) {
        let bytes = fs::read(file).unwrap();
        assert_eq!(line["name"].as_str(), file.file_name().unwrap().to_str());
        assert_eq!(line["blake3"].as_str().unwrap(), blake3::hash(&bytes).to_hex().as_str());
        assert_eq!(number(line, "/bytes"), bytes.len() as u64);
        let messages = read_log(file);
        let tags = decode_all::<FrameTag>(&messages, TAG);
        let valid = tags.iter().filter(|tag| tag.valid).count() as u64;
        assert_eq!(number(line, "/messages"), messages.len() as u64);
        assert_eq!(number(line, "/first_ns") as i64, messages.iter().map(|m| m.log_time_ns).min().unwrap());
        assert_eq!(number(line, "/last_ns") as i64, messages.iter().map(|m| m.log_time_ns).max().unwrap());
        assert_eq!(number(line, "/frames/written"), on(&messages, IMAGE).count() as u64);
        assert_eq!(number(line, "/frames/tagged"), tags.len() as u64);
        assert_eq!(number(line, "/frames/valid"), valid);
        let dropped: u64 = line["frames"]["dropped"].as_object().unwrap().values().filter_map(Value::as_u64).sum();
        assert_eq!(number(line, "/frames/captured"), number(line, "/frames/written") + dropped);
        for tag in tags.iter().filter(|tag| tag.valid) {
            let range = |axis: &str| {
                let range = &line["poses"][axis];
                // This reader of JSON rounds the last digit now and then.
                range[0].as_f64().unwrap() - 1e-12..=range[1].as_f64().unwrap() + 1e-12
            };
            let position = &tag.pose.pose.position;
            assert!(range("x").contains(&position.x) && range("y").contains(&position.y), "{line}");
        }
    }
}

#[test]
fn the_manifest_has_the_hashes_and_counts_of_the_files() {
    let room = Room::with_walk();
    assert_manifest_is_right(&room.replay("log.mcap"));
    let parts = room.replay("log.mcap --set recording.segment_s=1");
    assert!(segments(&parts.session).len() >= 3);
    assert_manifest_is_right(&parts);
}

#[test]
fn the_session_file_says_with_what_it_was_made() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap --seed 5 --particles 500 --set robot=nina");
    let text = fs::read_to_string(replayed.session.join("session.json")).unwrap();
    let session: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(session["format"], 1);
    assert_eq!(session["source"], "log.mcap");
    assert_eq!(session["robot"], "nina");
    assert_eq!(session["settings"]["filter"]["seed"], 5);
    assert_eq!(session["settings"]["filter"]["particles"], 500);
    assert_eq!((&session["lens"]["width"], &session["lens"]["height"]), (&Value::from(320), &Value::from(240)));
    let name = replayed.session.file_name().unwrap().to_str().unwrap();
    assert!(name.ends_with("Z-nina"), "{name}");
    let started = session["started"].as_str().unwrap().replace(':', "-");
    assert_eq!(name[..19], started[..19], "the folder is named after the first message");
    let folder = room.path("").canonicalize().unwrap();
    assert!(!text.contains(folder.to_str().unwrap()), "no path of this machine: {text}");
}

#[test]
fn a_second_session_of_the_same_time_gets_a_suffix_and_is_finished() {
    let room = Room::with_walk();
    let names: Vec<String> =
        (0..3).map(|_| room.replay("log.mcap").session.file_name().unwrap().to_str().unwrap().to_owned()).collect();
    assert_eq!(names[1], format!("{}-2", names[0]));
    assert_eq!(names[2], format!("{}-3", names[0]));
    for name in names {
        let session = room.path("captures").join(name);
        let mut files: Vec<_> =
            fs::read_dir(session).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        files.sort();
        assert_eq!(files, ["0000.mcap", "coverage.json", "manifest.jsonl", "metadata.yaml", "session.json"]);
    }
}

#[test]
fn every_message_of_the_log_is_passed_on_untouched() {
    let room = Room::with_walk();
    let capture = read_capture(&room.replay("log.mcap").session);
    for topic in [IMAGE, INITIAL, "/imu/data", "/odom", "/tf_static", "/camera/camera_info"] {
        let source: Vec<_> = on(&walk().messages, topic).collect();
        let written: Vec<_> = on(&capture, topic).collect();
        assert_eq!(source.len(), written.len(), "{topic}");
        for (a, b) in source.iter().zip(&written) {
            assert_eq!((a.sequence, a.log_time_ns, a.publish_time_ns), (b.sequence, b.log_time_ns, b.publish_time_ns));
            assert!(a.data == b.data, "{topic}");
            assert_eq!(a.channel.definition, b.channel.definition, "{topic}");
        }
    }
}

#[test]
fn a_pose_message_stands_for_each_valid_tag_and_no_other() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let poses = decode_all::<PoseWithCovarianceStamped>(&read_capture(&replayed.session), POSE);
    let valid: Vec<&FrameTag> = replayed.tags.iter().filter(|tag| tag.valid).collect();
    assert_eq!(poses.len(), valid.len());
    assert_eq!(replayed.count("valid"), valid.len());
    for (pose, tag) in poses.iter().zip(valid) {
        assert_eq!((&pose.header, &pose.pose), (&tag.header, &tag.pose));
        assert_eq!(pose.header.frame_id, "map");
    }
}

#[test]
fn a_capture_replayed_gives_the_same_tags() {
    let room = Room::with_walk();
    for settings in ["", " --set recording.segment_s=1"] {
        let first = room.replay(&format!("log.mcap{settings}"));
        let source = format!("captures/{}", first.session.file_name().unwrap().to_str().unwrap());
        let again = room.replay(&source);
        assert_same(&again.tags, &walk().tags, &source);
        assert_eq!(again.run.code, Some(0), "{:?}", again.run);
        let (before, after) = (read_capture(&first.session), read_capture(&again.session));
        for topic in [IMAGE, "/imu/data", "/odom", TAG, POSE, "/diagnostics", INITIAL] {
            assert_eq!(on(&before, topic).count(), on(&after, topic).count(), "{topic}");
        }
    }
}
