//! Captures in other forms, what `info` says of logs, and what programs read of `replay`.

use std::fs;

use realitysim::config::Settings;
use realitysim::database::ImageDatabase;
use realitysim::ros2::messages::CompressedImage;
use serde_json::Value;

use super::support::{IMAGE, IMU, Room, decode_all, session_name, walk};

fn session_of(room: &Room, arguments: &str) -> String {
    session_name(&room.replay(arguments))
}

#[test]
fn tum_has_a_line_of_eight_numbers_for_each_valid_tag() {
    let room = Room::with_walk();
    let session = session_of(&room, "log.mcap");
    let report = room.run(&format!("export {session} --to tum -o tags.tum --json")).succeeds().json();
    let valid: Vec<_> = walk().tags.iter().filter(|tag| tag.valid).collect();
    assert_eq!(report["written"], valid.len());
    let text = fs::read_to_string(room.path("tags.tum")).unwrap();
    assert_eq!(text.lines().count(), valid.len());
    for (line, tag) in text.lines().zip(valid) {
        let fields: Vec<&str> = line.split(' ').collect();
        assert_eq!(fields.len(), 8, "{line}");
        let (seconds, nanoseconds) = fields[0].split_once('.').unwrap();
        assert_eq!(seconds.parse(), Ok(tag.header.stamp.sec));
        assert_eq!((nanoseconds.len(), nanoseconds.parse()), (9, Ok(tag.header.stamp.nanosec)));
        let numbers: Vec<f64> = fields[1..].iter().map(|field| field.parse().unwrap()).collect();
        let (p, q) = (&tag.pose.pose.position, &tag.pose.pose.orientation);
        for (found, expected) in numbers.iter().zip([p.x, p.y, p.z, q.x, q.y, q.z, q.w]) {
            assert!((found - expected).abs() < 1e-6, "{line}");
        }
    }
}

#[test]
fn exported_images_are_those_of_the_source_byte_for_byte() {
    let room = Room::with_walk();
    let session = session_of(&room, "log.mcap");
    room.run(&format!("export {session} --to images -o frames")).succeeds();
    let table = fs::read_to_string(room.path("frames/tags.csv")).unwrap();
    let mut lines = table.lines();
    let head: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| head.iter().position(|field| *field == name).unwrap();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    assert_eq!(rows.len(), images.len());
    let jsonl = fs::read_to_string(room.path("frames/tags.jsonl")).unwrap();
    let objects: Vec<Value> = jsonl.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(objects.len(), rows.len());
    for (((row, object), image), tag) in rows.iter().zip(&objects).zip(&images).zip(&walk().tags) {
        assert_eq!(row.len(), head.len());
        assert!(fs::read(room.path("frames").join(row[column("file")])).unwrap() == image.data);
        assert_eq!(row[column("stamp_ns")].parse(), Ok(tag.header.stamp.to_nanoseconds()));
        assert_eq!(row[column("valid")].parse(), Ok(tag.valid));
        assert_eq!(object["file"], row[column("file")]);
        for (name, expected) in [
            ("x", tag.pose.pose.position.x),
            ("y", tag.pose.pose.position.y),
            ("yaw_deg", tag.yaw.to_degrees()),
            ("roll_deg", tag.roll.to_degrees()),
        ] {
            assert!((row[column(name)].parse::<f64>().unwrap() - expected).abs() < 1e-5, "{name}");
            assert!((object[name].as_f64().unwrap() - expected).abs() < 1e-9, "{name}");
        }
    }
    // tags.csv, tags.jsonl, poses.csv, camera_info.yaml, field.toml.
    assert_eq!(fs::read_dir(room.path("frames")).unwrap().count(), images.len() + 5);
}

#[test]
fn a_database_of_an_export_has_the_poses_of_the_capture() {
    let room = Room::with_walk();
    let session = session_of(&room, "log.mcap");
    room.run(&format!("export {session} --to images -o frames")).succeeds();
    let of_capture = room.run(&format!("db add {session} --db own --json")).succeeds().json();
    let run = room.run("db add frames --db other --field kid-2009 --json").succeeds();
    assert_eq!(run.json()["images"], of_capture["images"]);
    assert_eq!(run.json()["assumed"], 0, "standard deviations are stated");
    let database = |name: &str| ImageDatabase::open(&room.path(name), &Settings::default().views).unwrap();
    let sorted = |database: &ImageDatabase| {
        let mut records: Vec<_> = database.index().records().collect();
        records.sort_by_key(|record| record.crc);
        records
    };
    for (one, other) in sorted(&database("own")).iter().zip(sorted(&database("other"))) {
        assert!((one.pose().translation - other.pose().translation).length() < 1e-5);
        assert!((one.sigma_m - other.sigma_m).abs() < 0.45 * one.sigma_m, "{one:?} {other:?}");
        assert!((one.sigma_rad - other.sigma_rad).abs() < 1e-6, "{one:?} {other:?}");
    }
}

#[test]
fn an_export_goes_into_a_folder_of_its_own() {
    let room = Room::with_walk();
    let session = session_of(&room, "log.mcap");
    room.run(&format!("export {session} --to images -o frames")).succeeds();
    let shorter = session_of(&room, "log.mcap --set recording.segment_s=1");
    let names = || {
        let mut names: Vec<_> =
            fs::read_dir(room.path("frames")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = (names(), fs::read(room.path("frames/tags.csv")).unwrap());
    room.run(&format!("export {shorter}/0000.mcap --to images -o frames"))
        .fails(2, &["frames: is not empty", "name another, or remove what is in it"]);
    assert_eq!((names(), fs::read(room.path("frames/tags.csv")).unwrap()), before);
    fs::create_dir(room.path("empty")).unwrap();
    room.run(&format!("export {shorter}/0000.mcap --to images -o empty")).succeeds();
    // A file of tags is replaced by one.
    room.run(&format!("export {session} --to tum -o tags.tum")).succeeds();
    room.run(&format!("export {session} --to tum -o tags.tum")).succeeds();
}

#[test]
fn what_is_no_capture_cannot_be_exported_or_judged() {
    let room = Room::with_walk();
    room.run("export log.mcap --to tum -o x.tum").fails(1, &["log.mcap", "/frame_tag", "realitysim replay"]);
    room.run("eval log.mcap --truth log.mcap").fails(1, &["log.mcap", "/frame_tag"]);
    let session = session_of(&room, "log.mcap");
    let words = [session.as_str(), "/ground_truth/camera_pose", "--truth-topic"];
    room.run(&format!("eval {session} --truth {session}")).fails(1, &words);
    room.run(&format!("export {session} --to tum -o none/x.tum")).fails(1, &["none/x.tum"]);
}

#[test]
fn info_tells_what_a_log_holds() {
    let room = Room::with_walk();
    let info = room.run("log info log.mcap --json").succeeds().json();
    let topic = |info: &Value, name: &str| {
        info["topics"].as_array().unwrap().iter().find(|topic| topic["topic"] == name).cloned().unwrap()
    };
    assert_eq!(info["messages"], walk().messages.len());
    assert_eq!(topic(&info, IMAGE)["messages"], walk().frames());
    assert_eq!(topic(&info, IMAGE)["type"], "sensor_msgs/msg/CompressedImage");
    assert!((topic(&info, IMU)["rate_hz"].as_f64().unwrap() - 100.0).abs() < 1.0);
    assert!(info["files"][0]["indexed"].as_bool().unwrap());

    let session = session_of(&room, "log.mcap --set recording.segment_s=1");
    let info = room.run(&format!("log info {session} --json")).succeeds().json();
    assert!(info["files"].as_array().unwrap().len() >= 3);
    assert_eq!(topic(&info, "/frame_tag")["messages"], walk().frames());
    assert_eq!(info["files"][1]["attachments"][0], "filter_state");

    room.write("torn.mcap", &walk().log[..walk().log.len() - 10_000]);
    let torn = room.run("log info torn.mcap").fails(3, &[]);
    assert!(torn.stdout.contains("torn"), "{torn:?}");
    assert!(torn.stdout.contains("/odom"), "what is left is told all the same");
}

#[test]
fn replay_tells_programs_one_object_and_everything_else_on_standard_error() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap --threads 2 --particles 400 --iterations 4");
    let report = replayed.run.json();
    let keys = ["session", "frames", "tagged", "valid", "particles", "iterations", "threads", "filter_ms", "wall_s"];
    for key in keys {
        assert!(!report[key].is_null(), "{key} is missing: {report}");
    }
    let number = |pointer: &str| report.pointer(pointer).and_then(Value::as_f64).unwrap();
    assert_eq!((report["particles"].as_u64(), report["iterations"].as_u64()), (Some(400), Some(4)));
    assert_eq!((replayed.count("frames"), replayed.count("tagged")), (walk().frames(), walk().frames()));
    assert_eq!(replayed.count("valid"), replayed.tags.iter().filter(|tag| tag.valid).count());
    assert!(0.0 < number("/filter_ms/p50") && number("/filter_ms/p50") <= number("/filter_ms/p99"));
    assert!(number("/filter_ms/p99") <= number("/filter_ms/max") && number("/wall_s") > 0.0);
    assert!(room.path(report["session"].as_str().unwrap()).join("session.json").is_file());

    // Also when there is something to complain about, and for people in words.
    room.write("torn.mcap", &walk().log[..walk().log.len() - 1000]);
    let torn = room.replay("torn.mcap").run;
    assert!(torn.stderr.contains("damaged"), "{torn:?}");
    let spoken = room.run("replay log.mcap -o captures").succeeds();
    assert!(spoken.stdout.lines().last().unwrap().starts_with("captures/"), "{spoken:?}");
    assert!(serde_json::from_str::<Value>(&spoken.stdout).is_err());
}
