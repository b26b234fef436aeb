//! What a running recorder says of its ports and of its camera's socket.

use std::io::{Read, Write};
use std::time::{Duration, Instant};

use super::doctor::{Board, odometry};
use super::recorder::{CONFIG, PATIENCE, Recorder};
use crate::replay::support::{CAPTURES, Room, decode_all, read_capture};
use crate::serial::Cable;
use realitysim::ros2::messages::DiagnosticArray;

#[test]
fn a_port_that_is_silent_garbled_or_useless_is_named_until_it_is_right() {
    let cable = Cable::new();
    let tty = cable.ends[1].clone();
    let mut recorder = Recorder::start(Some(&tty));
    let cause = |status: &serde_json::Value| status["ports"][&tty]["trouble"]["cause"].clone();
    recorder.waits_for("silent", |status| cause(status) == "silent");
    let said = recorder.room.run("recorder status --socket control.sock").succeeds().stdout;
    assert!(said.contains(&format!("{tty}: TROUBLE: silent")) && said.contains("tags: none yet"), "{said}");

    let mut line = std::fs::OpenOptions::new().write(true).open(&cable.ends[0]).expect("the line");
    let began = Instant::now();
    while cause(&recorder.asks("status")) != "no_messages" {
        assert!(began.elapsed() < PATIENCE, "{}", recorder.asks("status"));
        line.write_all(b"$GPGGA,no MAVLink at all\r\n").expect("sent");
        std::thread::sleep(Duration::from_millis(50));
    }

    let crooked = |ms: u64| match odometry(ms) {
        mavlink::dialects::common::MavMessage::ODOMETRY(mut data) => {
            data.q = [f32::NAN; 4];
            mavlink::dialects::common::MavMessage::ODOMETRY(data)
        }
        other => other,
    };
    let board = Board::at(&cable.ends[0], 1, crooked);
    recorder.waits_for("useless", |status| cause(status) == "unusable");
    drop(board);
    let board = Board::at(&cable.ends[0], 1, odometry);
    recorder.waits_for("right", |status| cause(status).is_null());
    drop(board);

    let output = recorder.ends();
    let journal = String::from_utf8_lossy(&output.stderr).into_owned();
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let recorded = read_capture(&recorder.room.path(report["session"].as_str().expect("a session")));
    let notes: Vec<DiagnosticArray> = decode_all(&recorded, "/diagnostics");
    let notes: Vec<&str> = notes.iter().flat_map(|note| &note.status).map(|status| status.message.as_str()).collect();
    for said in ["silent", "bytes and no MAVLink 2 message", "messages cannot be used: ", "all is well again"] {
        assert!(journal.contains(said), "{said}: {journal}");
        assert!(notes.iter().any(|note| note.contains(said)), "{said}: {notes:?}");
    }
}

#[test]
fn a_camera_socket_that_cannot_be_made_is_named_and_removes_nothing() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text);
    room.write("diary.txt", "mine");
    room.write("robot.toml", CONFIG);
    for (device, said) in [
        ("unix:nowhere/camera.sock", "unix:nowhere/camera.sock: there is no folder nowhere for the socket"),
        ("unix:diary.txt", "unix:diary.txt: something is there that is no socket"),
    ] {
        let mut process = std::process::Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["record", "-o", CAPTURES, "--config", "robot.toml", "--socket", "control.sock"])
            .args(["--set", &format!("capture.device={device}")])
            .current_dir(room.path(""))
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .expect("started");
        let mut stderr = process.stderr.take().expect("piped");
        let (mut journal, began) = (Vec::new(), Instant::now());
        let mut piece = [0; 512];
        while !String::from_utf8_lossy(&journal).contains(said) && began.elapsed() < PATIENCE {
            let count = stderr.read(&mut piece).expect("a journal");
            journal.extend(&piece[..count]);
        }
        let _ = process.kill().and_then(|()| process.wait());
        assert!(String::from_utf8_lossy(&journal).contains(said), "{}", String::from_utf8_lossy(&journal));
    }
    assert_eq!(std::fs::read_to_string(room.path("diary.txt")).expect("still there"), "mine");
    room.run("record -o captures --config robot.toml --socket diary.txt")
        .fails(1, &["something is there that is no socket"]);
    assert_eq!(std::fs::read_to_string(room.path("diary.txt")).expect("still there"), "mine");
}
