//! What makes tags worse than they need be is told, once, and is no failure.

use std::sync::Arc;

use realitysim::ros2::messages::{Imu, Quaternion, TFMessage};
use realitysim::ros2::{Channel, LogMessage};

use super::support::{IMU, Room, TF_STATIC, changed, session_name, walk, without};

/// One warning with these words: in the report, and once on standard error. The tags are whole all the same.
fn assert_warned(messages: &[LogMessage], arguments: &str, words: &[&str]) {
    let room = Room::with_log(messages);
    let replayed = room.replay(&format!("log.mcap --field kid-2009 {arguments}"));
    let run = &replayed.run;
    assert_eq!(run.code, Some(0), "{run:?}");
    let warnings = replayed.report["warnings"].as_array().unwrap();
    assert_eq!(warnings.len(), 1, "{run:?}");
    let warning = warnings[0].as_str().unwrap();
    for word in words {
        assert!(warning.contains(word), "{word:?} is missing: {warning}");
    }
    assert_eq!(run.stderr.matches(warning).count(), 1, "{run:?}");
    assert!(replayed.tags.len() == walk().frames());
    let spoken = room.run(&format!("replay log.mcap -o captures --field kid-2009 {arguments}")).succeeds();
    assert!(spoken.stdout.contains("1 warning") && spoken.stderr.contains(warning), "{spoken:?}");
}

fn all_frames() -> String {
    format!("{0} of {0} frames", walk().frames())
}

#[test]
fn a_log_with_an_attitude_is_no_reason_to_warn() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap --field kid-2009");
    assert_eq!(replayed.report["warnings"], serde_json::json!([]));
    assert!(!replayed.run.stderr.contains("warning"), "{:?}", replayed.run);
}

#[test]
fn a_lens_that_is_not_as_it_was_calibrated_is_told_and_allowed_for() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        format!(
            "{text}\n[[effect]]\nkind = \"calibration_error\"\nrole = \"base\"\nfocal_percent = 0.6\ncentre_px = [1.5, -1.5]\n"
        )
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let replayed = room.replay("log.mcap --field kid-2009");
    let warnings = replayed.report["warnings"].as_array().expect("warnings");
    let focal_percent = |said: &str| said.split("focal length ").nth(1)?.split(" %").next()?.parse::<f64>().ok();
    let told = warnings[0].as_str().and_then(focal_percent);
    assert!(warnings.len() == 1 && told.is_some_and(|percent| (percent + 0.6).abs() < 0.05), "{warnings:?}");
    // Nobody has told it, and the walk takes four seconds.
    let judged = room.run(&format!("eval {} --truth log.mcap --json", session_name(&replayed))).succeeds().json();
    assert!(judged["position_cm"]["median"].as_f64().is_some_and(|median| median < 0.5), "{judged}");
    assert!(judged["ellipse95_share"].as_f64().is_some_and(|share| share >= 0.9), "{judged}");
}

#[test]
fn a_log_without_an_imu_is_told() {
    let words = [&all_frames(), "as if the torso stood upright", "no topic of type sensor_msgs/msg/Imu"];
    assert_warned(&without(&walk().messages, IMU), "", &words);
}

#[test]
fn an_imu_without_an_orientation_is_told() {
    let unmeasured = changed::<Imu>(&walk().messages, IMU, |imu| imu.orientation_covariance[0] = -1.0);
    let words = [&all_frames(), IMU, "states no orientation", "orientation_covariance[0] is -1"];
    assert_warned(&unmeasured, "", &words);
    let zero = changed::<Imu>(&walk().messages, IMU, |imu| {
        imu.orientation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
    });
    assert_warned(&zero, "", &words);
}

#[test]
fn two_imus_of_other_names_are_to_be_chosen_from() {
    let renamed = |topic: &str, more: u16| -> Vec<LogMessage> {
        let imus = walk().messages.iter().filter(|message| message.channel.topic == IMU);
        imus.map(|message| {
            let mut channel = Channel::clone(&message.channel);
            (channel.topic, channel.id) = (topic.to_owned(), channel.id + more);
            LogMessage { channel: Arc::new(channel), ..message.clone() }
        })
        .collect()
    };
    let mut messages = without(&walk().messages, IMU);
    messages.extend(renamed("/head/imu", 100));
    messages.extend(renamed("/torso/imu", 200));
    messages.sort_by_key(|message| message.log_time_ns);
    assert_warned(&messages, "", &[&all_frames(), "topics.imu", "/head/imu, /torso/imu"]);
    let room = Room::with_log(&messages);
    let chosen = room.replay("log.mcap --field kid-2009 --set topics.imu=/torso/imu");
    assert_eq!(chosen.report["warnings"], serde_json::json!([]));
}

#[test]
fn an_imu_that_starts_late_is_told_with_the_frames_that_it_costs() {
    let start = walk().messages[0].log_time_ns + 1_000_000_000;
    let mut late = walk().messages.clone();
    late.retain(|message| message.channel.topic != IMU || message.log_time_ns > start);
    assert_warned(&late, "", &[&format!("of {} frames", walk().frames()), "/imu/data had told no attitude yet"]);
}

#[test]
fn a_chain_that_does_not_pass_the_torso_is_told() {
    let messages = changed::<TFMessage>(&walk().messages, TF_STATIC, |constants| {
        for transform in &mut constants.transforms {
            for name in [&mut transform.header.frame_id, &mut transform.child_frame_id] {
                if *name == "base_link" {
                    *name = "trunk".to_owned();
                }
            }
        }
    });
    assert_warned(&messages, "", &[&all_frames(), "base_link", "frames.base_link"]);
    let room = Room::with_log(&messages);
    let named = room.replay("log.mcap --field kid-2009 --set frames.base_link=trunk");
    assert_eq!(named.report["warnings"], serde_json::json!([]));
}

#[test]
fn a_field_that_nobody_named_is_told_with_its_size() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let told = replayed.report["warnings"].to_string();
    assert!(told.contains("kid-2009 is assumed, which is 6 x 4 m") && told.contains("--field NAME"), "{told}");
    assert!(replayed.run.stderr.contains("no field was named"), "{:?}", replayed.run);
    let is_silent = |arguments: &str| room.replay(arguments).report["warnings"] == serde_json::json!([]);
    room.write("robot.toml", "field = \"kid-2009\"\n");
    assert!(is_silent("log.mcap --config robot.toml") && is_silent("log.mcap --set field=kid-2009"));
    room.write("robot.toml", "robot = \"field\"\n");
    assert!(!is_silent("log.mcap --config robot.toml"));
    // A capture says on which field it was recorded, and a scene on which it plays.
    assert!(is_silent(&session_name(&replayed)));
    room.write_scene("scene.toml", |text| text);
    assert!(is_silent("scene.toml"));
    let other = room.replay("log.mcap --field-size 5.98x3.98 --set field=kid-2009");
    let told = room.replay(&session_name(&other)).report["warnings"].to_string();
    assert!(told.contains("the capture was recorded on kid-2009 of 5.98 x 3.98 m"), "{told}");
}
