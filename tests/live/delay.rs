//! `realitysim doctor --estimate-delay` against a walk whose camera is late by a known time.

use crate::replay::support::{IMAGE, Room, own_log, read_log, stamp_later};

/// The robot stands and its head looks left and right, as its IMU and joints say with their noise.
fn turning_head(room: &Room) {
    room.write_scene("scene.toml", |text| {
        let (before, walk) = text.split_once("kind = \"walk\"").expect("a walk");
        let (_, after) = walk.split_once("[odometry]").expect("odometry");
        let (after, effects) = after.split_once("[[effect]]").expect("effects");
        let (_, effects) = effects.split_once("[[effect]]").expect("the sway, and others");
        let head = "[[effect]]\nkind = \"head_motion\"\nrole = \"base\"\npan_amplitude_deg = 30.0\npan_period_s = 2.0\n\
                    tilt_amplitude_deg = 6.0\ntilt_period_s = 2.7\nencoder_noise_deg = 0.05\n\n";
        let before = before.replace("rate_hz = 10.0", "rate_hz = 30.0");
        format!(
            "{before}kind = \"still\"\nposes = [[-1.0, 0.2, 20.0]]\nhold_s = 6.0\n\n[odometry]{after}{head}[[effect]]{effects}"
        )
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
}

/// The robot turns at the corners of its way, and has no head.
fn turning_body(room: &Room) {
    room.write_scene("scene.toml", |text| {
        let (before, walk) = text.split_once("[route]").expect("a walk");
        let (_, after) = walk.split_once("[odometry]").expect("odometry");
        let before = before.replace("rate_hz = 10.0", "rate_hz = 30.0");
        format!(
            "{before}[route]\nkind = \"walk\"\nwaypoints = [[-1.0, -0.2], [-0.7, 0.1], [-1.0, 0.4], [-0.7, 0.7], [-1.0, 1.0]]\n\
             speed_m_s = 0.35\nturn_deg_s = 130.0\n\n[odometry]{after}"
        )
    });
    room.run("scene render scene.toml -o log.mcap").succeeds();
}

#[test]
fn a_camera_s_delay_is_found_from_turns_of_the_head() {
    finds_delays(turning_head);
}

#[test]
fn a_camera_s_delay_is_found_from_turns_of_the_body() {
    finds_delays(turning_body);
}

fn finds_delays(turning: fn(&Room)) {
    let room = Room::new();
    turning(&room);
    let messages = read_log(&room.path("log.mcap"));
    for late_ms in [0, 35, -20] {
        let mut late = messages.clone();
        late.iter_mut()
            .filter(|message| message.channel.topic == IMAGE)
            .for_each(|message| stamp_later(message, late_ms * 1_000_000));
        room.write("late.mcap", own_log(&late));
        let report = room.run("doctor --estimate-delay late.mcap --json").succeeds().json();
        let (delay_ms, uncertainty_ms) =
            (report["delay_ms"].as_f64().expect("a number"), report["uncertainty_ms"].as_f64().expect("a number"));
        assert!((delay_ms - late_ms as f64).abs() < 4.0, "{late_ms} ms: {report}");
        assert!((delay_ms - late_ms as f64).abs() <= uncertainty_ms + 1.0, "{late_ms} ms: {report}");
    }
}

#[test]
fn a_recording_without_turns_says_what_to_do() {
    let room = Room::with_walk();
    // Ten frames a second, four seconds.
    room.run("doctor --estimate-delay log.mcap").fails(1, &["pairs of frames"]);
    room.run("doctor -o captures --estimate-delay").fails(1, &["no capture in it"]);
}
