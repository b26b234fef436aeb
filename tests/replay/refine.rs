//! Tags made better afterwards, from a capture to its refined tags and its views.

use std::fs;

use realitysim::config::Settings;
use realitysim::geometry::LensParameters;
use realitysim::ros2::LogMessage;

use super::support::{IMU, Room, read_log, session_name, without};

#[test]
fn refined_tags_are_nearer_to_the_truth_and_nothing_recorded_is_touched() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap");
    let session = session_name(&replayed);
    let content = || -> Vec<Vec<u8>> {
        super::support::segments(&replayed.session).iter().map(|path| fs::read(path).expect("a segment")).collect()
    };
    let before = content();
    let run = room.run(&format!("refine {session} --truth log.mcap --views 6 --json")).succeeds();
    assert_eq!(content(), before);
    let report = run.json();
    let figure = |when: &str, what: &str, which: &str| report[when][what][which].as_f64().expect("judged");
    println!("{report:#}");
    // Calibrated, the tags are good already, and become better by the ground that neighbouring images share.
    for (what, aim) in [("position_cm", 0.2), ("angle_deg", 0.04)] {
        let better = |which: &str| figure("after", what, which) < figure("before", what, which);
        assert!(figure("after", what, "mean") < aim && better("mean") && better("p95"), "{report:#}");
    }
    assert!(figure("after", "view_psnr_db", "median") >= 30.0, "{report:#}");
    assert_eq!(report["constants"].as_array().map(Vec::len), Some(8));

    // Again: from the recorded tags, not from the refined ones.
    let again = room.run(&format!("refine {session} --truth log.mcap --views 0 --json")).succeeds().json();
    assert_eq!(again["before"]["position_cm"], report["before"]["position_cm"]);
    assert_eq!(again["after"]["position_cm"], report["after"]["position_cm"]);
    // The database takes the refined ones.
    room.run(&format!("db add {session} --db db")).succeeds();
    let database =
        realitysim::database::ImageDatabase::open(&room.path("db"), &Settings::default().views).expect("a database");
    let info = fs::read(replayed.session.join("refined/refined.json")).expect("written");
    let info: serde_json::Value = serde_json::from_slice(&info).expect("JSON");
    let refined: LensParameters = serde_json::from_value(info["lens"].clone()).expect("a lens");
    assert!(database.contents().sources[0].lens.maps_as(&refined));
}

#[test]
fn one_walk_shows_a_wrong_lens_and_a_wrong_mount() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        format!(
            "{text}\n[[effect]]\nkind = \"calibration_error\"\nrole = \"base\"\nfocal_percent = 0.6\ncentre_px = [1.5, -1.5]\n\
             mount_pitch_deg = 1.0\nmount_roll_deg = 0.5\nheight_m = 0.015\n"
        )
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let session = session_name(&room.replay("log.mcap"));
    let report = room.run(&format!("refine {session} --truth log.mcap --views 6 --json")).succeeds().json();
    let median = |when: &str, what: &str| report[when][what]["median"].as_f64().expect("judged");
    assert!(median("before", "position_cm") < 0.4, "tags have learnt what is wrong: {report:#}");
    assert!(median("after", "position_cm") < 0.25 && median("after", "angle_deg") < 0.12, "{report:#}");
    assert!(median("after", "view_psnr_db") >= 30.0, "{report:#}");
    let found = |name: &str| {
        let constants = report["constants"].as_array().expect("constants");
        let found = constants.iter().find(|found| found["name"] == name).expect("there");
        assert_eq!(found["observable"], true, "{found}");
        found["value"].as_f64().expect("a number")
    };
    // What the announced calibration has too much must come off.
    assert!((found("focal length") + 0.006).abs() < 0.0015, "{report:#}");
    assert!((found("centre u") + 1.5).abs() < 0.3 && (found("centre v") - 1.5).abs() < 0.3, "{report:#}");
    assert!((found("height") + 0.015).abs() < 0.002, "{report:#}");
}

#[test]
fn a_sensor_that_is_read_row_by_row_is_found_out_by_tags_and_refinement() {
    refined_row_by_row(<[LogMessage]>::to_vec, 0.002);
}

/// Feet tell how it turns, and not how it rocks.
#[test]
fn a_sensor_that_is_read_row_by_row_is_found_out_without_a_gyro() {
    refined_row_by_row(|log| without(log, IMU), 0.004);
}

/// The readout, of 20 ms, is found as nearly as said.
fn refined_row_by_row(heard: impl Fn(&[LogMessage]) -> Vec<LogMessage>, readout_s: f64) {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        let turning =
            text.replace("[[-2.0, 0.1], [-1.1, 0.3]]", "[[-2.0, 0.1], [-1.5, 0.1], [-1.5, 0.6], [-2.0, 0.6]]");
        let turning = turning.replace("turn_deg_s = 30.0", "turn_deg_s = 90.0");
        let shutter = "[[effect]]\nkind = \"shutter\"\nrole = \"base\"\nexposure_ms = 2.0\nreadout_ms = 20.0\n\n";
        let (moves, senses) = turning.split_once("[[effect]]\nkind = \"odometry_error\"").expect("there");
        format!("{moves}{shutter}[[effect]]\nkind = \"odometry_error\"{senses}")
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let room = Room::with_log(&heard(&read_log(&room.path("log.mcap"))));
    let session = session_name(&room.replay("log.mcap"));
    let judged = room.run(&format!("eval {session} --truth log.mcap --json")).succeeds().json();
    assert!(judged["ellipse95_share"].as_f64().expect("a share") >= 0.9, "{judged:#}");
    let report = room.run(&format!("refine {session} --truth log.mcap --views 0 --json")).succeeds().json();
    println!("{report:#}");
    for (when, cm, deg) in [("before", 0.3, 0.08), ("after", 0.15, 0.04)] {
        let median = |what: &str| report[when][what]["median"].as_f64().expect("judged");
        assert!(median("position_cm") < cm && median("angle_deg") < deg, "{report:#}");
    }
    let constants = report["constants"].as_array().expect("constants");
    let readout = constants.iter().find(|found| found["name"] == "readout of the sensor").expect("there");
    assert!((readout["value"].as_f64().expect("a number") - 0.020).abs() < readout_s, "{readout}");
}

#[test]
fn what_cannot_be_refined_is_told() {
    let room = Room::with_walk();
    room.run("refine log.mcap").fails(1, &["a capture's folder is needed"]);
    fs::create_dir(room.path("empty")).expect("a folder");
    room.run("refine empty").fails(1, &["session.json"]);
}
