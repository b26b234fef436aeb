//! A camera calibrated by a walk, from a rendered walk whose truth is known to the files that the program reads.

use std::fs;

use realitysim::config::{Settings, load_lens};
use realitysim::geometry::LensModel;
use serde_json::Value;

use super::support::{Room, session_name};

/// A walk of some seconds around one corner, with a mount and a lens that are announced wrongly.
fn wrong_walk() -> Room {
    let room = Room::new();
    room.write_scene("scene.toml", |text| {
        let around = "[[-2.0, -0.9], [-1.0, -0.9], [-1.0, 0.5], [-2.0, 0.5], [-2.0, -0.9]]";
        let text = text.replace("[[-2.0, 0.1], [-1.1, 0.3]]", around).replace("turn_deg_s = 30.0", "turn_deg_s = 60.0");
        let error = "focal_percent = 0.6\ncentre_px = [1.5, -1.5]\nmount_pitch_deg = 1.0\nmount_roll_deg = 0.5\nheight_m = 0.015\n";
        format!("{text}\n[[effect]]\nkind = \"calibration_error\"\nrole = \"base\"\n{error}")
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
    room
}

fn constant<'a>(report: &'a Value, name: &str) -> &'a Value {
    let constants = report["constants"].as_array().expect("constants");
    constants.iter().find(|found| found["name"] == name).expect("there")
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

#[test]
fn a_walk_on_a_field_of_wrong_size_gives_lens_mount_and_field() {
    let room = wrong_walk();
    let run = room.run("calibrate --walk log.mcap --field-size 6.06x3.96 -o found --json").succeeds();
    let report = run.json();
    println!("{report:#}");
    let [length, width] = [0, 1].map(|i| number(&report["field_size_m"][i]));
    assert!((length - 6.0).abs() < 0.02 && (width - 4.0).abs() < 0.02, "{report:#}");
    let height = constant(&report, "height");
    assert!((number(&height["value"]) + 0.015).abs() < 0.003, "{report:#}");

    // All of it can be read: the lens, and the config that names it.
    let lens = load_lens(&room.path("found/lens.toml").display().to_string()).expect("a lens file").lens;
    assert!(matches!(lens.parameters().model, LensModel::KannalaBrandt { .. }));
    let settings = Settings::load(&room.path("found/robot.toml").display().to_string()).expect("a robot config");
    assert_eq!(settings.camera.lens, Some(room.path("found/lens.toml").display().to_string()));
    assert_eq!(settings.field_size_m.map(|size| size[0] > 5.9), Some(true));
    for map in ["uncertainty", "cross-validation", "residuals", "views"] {
        let svg = fs::read_to_string(room.path(&format!("found/{map}.svg"))).expect("a map");
        assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"));
    }
    let words = fs::read_to_string(room.path("found/report.txt")).expect("a report");
    assert!(words.contains("at the rim") && words.contains("two halves"), "{words}");
    // The mount of a log is in its transforms: what a config says of it would be of no use there, and wrong on the robot.
    let config = fs::read_to_string(room.path("found/robot.toml")).expect("a config");
    assert!(config.contains("turned in its own frame") && !config.contains("[mount]"), "{config}");
}

/// On a robot the announced mount is the config's own, and the calibration corrects it.
#[test]
#[ignore = "takes half a minute: `cargo test --release --test integration -- replay::calibrate --ignored`"]
fn the_mount_of_a_recorded_walk_is_corrected_in_its_config() {
    let room = wrong_walk();
    let session = session_name(&room.replay("log.mcap"));
    let description = room.path(&session).join("session.json");
    let mut info: Value = serde_json::from_slice(&fs::read(&description).expect("there")).expect("a description");
    info["live"] = serde_json::json!({ "utc_offset_ns": 0, "camera_delay_ns": 0, "camera": null });
    info["settings"]["mount"] = serde_json::json!({
        "torso_height_m": 0.395, "camera_xyz_m": [0.04, 0.0, 0.11], "camera_rpy_deg": [0.5, 18.0, 0.0]
    });
    fs::write(&description, serde_json::to_vec(&info).expect("JSON")).expect("written");
    room.run(&format!("calibrate --walk {session} -o found")).succeeds();
    let mount = Settings::load(&room.path("found/robot.toml").display().to_string()).expect("a robot config").mount;
    assert!((mount.torso_height_m.expect("written") - 0.38).abs() < 0.003, "{mount:?}");
    assert_eq!(mount.camera_xyz_m, [0.04, 0.0, 0.11]);
    // The mount's 17 degrees, and what levels an IMU that leans by half a degree in roll and pitch.
    let [roll, pitch, _] = mount.camera_rpy_deg;
    assert!((roll + 0.5).abs() < 0.2 && (pitch - 17.5).abs() < 0.2, "{mount:?}");
}

#[test]
fn what_a_walk_does_not_determine_is_named_and_not_written() {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    let report = room.run(&format!("calibrate --walk {session} -o found --json")).succeeds().json();
    // In four seconds the torso sways by more than what odometry gets wrong.
    let missing = report["not_determined"].as_array().expect("names");
    assert!(missing.iter().any(|name| name == "odometry's distance"), "{report:#}");
    let config = fs::read_to_string(room.path("found/robot.toml")).expect("a config");
    assert!(config.contains("not determined"), "{config}");
    // The size of the field is written if both lengths are determined, and else not at all.
    let is_missing = |name: &str| missing.iter().any(|missing| missing == name);
    let has_size = !is_missing("field length") && !is_missing("field width");
    assert_eq!(config.contains("field_size_m"), has_size, "{config}");
}

#[test]
#[ignore = "takes half a minute: `cargo test --release --test integration -- replay::calibrate --ignored`"]
fn what_cannot_be_calibrated_is_told() {
    let room = Room::with_walk();
    room.write_scene("scene.toml", |text| text);
    room.run("calibrate --walk scene.toml -o found").fails(2, &["scene render"]);
    let session = session_name(&room.replay("log.mcap"));
    room.run(&format!("calibrate --walk {session} -o {session}/found"))
        .fails(2, &["into which nothing else is written"]);
    room.run(&format!("calibrate --walk {session} --field kid-2020 -o found")).fails(2, &["its own settings"]);
    room.run("calibrate --walk log.mcap --field adult-2020 -o found").fails(1, &["could be placed", "check the field"]);
    assert!(!room.path("found").exists());
}
