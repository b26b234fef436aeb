//! The recorder as a process: killed, starved of its folder, asked to keep up.

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use realitysim::ros2::{LogReader, Selection};
use serde_json::Value;

use crate::replay::support::{CAPTURES, IMAGE, Room};

const PATIENCE: Duration = Duration::from_secs(60);

/// Whatever is left on the disk of whoever tests.
const ROOM_ENOUGH: &str = "--set recording.floor_mb=1 --set recording.floor_percent=0";

/// A recorder with a stream of its own.
struct Soak {
    process: Child,
    states: std::io::Lines<BufReader<std::process::ChildStdout>>,
}

impl Soak {
    fn start(room: &Room, arguments: &str) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["soak", "-o", CAPTURES, "--states", "--json"])
            .args(arguments.split_whitespace())
            .args(ROOM_ENOUGH.split_whitespace())
            .current_dir(room.path(""))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let states = BufReader::new(process.stdout.take().unwrap()).lines();
        Self { process, states }
    }

    fn state(&mut self) -> Value {
        serde_json::from_str(&self.states.next().expect("it is running").unwrap()).unwrap()
    }

    fn waits_for(&mut self, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let state = self.state();
            if is(&state) {
                return state;
            }
            assert!(began.elapsed() < PATIENCE, "{what}: {state}");
        }
    }
}

impl Drop for Soak {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn only_session(room: &Room) -> PathBuf {
    let folders = fs::read_dir(room.path(CAPTURES)).unwrap().map(|entry| entry.unwrap().path());
    folders.into_iter().find(|path| path.join("session.json").is_file()).expect("a session")
}

/// Sequence numbers of all frames in the files that end like this.
fn frames(session: &Path, endings: &[&str]) -> Vec<u32> {
    let names: BTreeSet<String> =
        fs::read_dir(session).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    let mut found = Vec::new();
    for name in names.iter().filter(|name| endings.iter().any(|ending| name.ends_with(ending))) {
        let file = fs::File::open(session.join(name)).unwrap();
        let Ok(reader) = LogReader::open(file, Selection::topics([IMAGE])) else { continue };
        found.extend(reader.map(|message| message.unwrap().sequence));
    }
    found
}

fn assert_in_a_row(frames: &[u32], what: &str) {
    let expected: Vec<u32> = (0..frames.len() as u32).collect();
    assert!(frames == expected, "{what}: {} frames, not in a row", frames.len());
}

/// How often the recorder is killed: `REALITYSIM_KILLS`.
fn kills() -> u64 {
    std::env::var("REALITYSIM_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(8)
}

#[test]
fn a_recorder_that_is_killed_at_any_moment_keeps_what_the_disk_had() {
    for kill in 0..kills() {
        let room = Room::new();
        let mut soak = Soak::start(
            &room,
            "--rate 100 --frame-kb 20 --set recording.segment_s=1 --set recording.sync_interval_ms=50",
        );
        soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(0));
        // Moments that share nothing with the recorder's own rhythm.
        std::thread::sleep(Duration::from_millis(1 + (kill * 7919) % 2400));
        let _ = soak.process.kill();
        let _ = soak.process.wait();
        let synced = soak
            .states
            .by_ref()
            .map_while(Result::ok)
            .filter_map(|line| serde_json::from_str(&line).ok())
            .fold(0, |most: u64, state: Value| most.max(state["frames_synced"].as_u64().unwrap_or(0)));
        let session = only_session(&room);
        let at_once = frames(&session, &[".mcap", ".mcap.active"]);
        assert_in_a_row(&at_once, "as it lies there");
        assert!(at_once.len() as u64 >= synced, "kill {kill}: {} of {synced}", at_once.len());

        let repaired = room.run(&format!("sessions repair {CAPTURES} --json"));
        assert!(matches!(repaired.code, Some(0 | 3)), "{repaired:?}");
        let whole = frames(&session, &[".mcap"]);
        assert_in_a_row(&whole, "repaired");
        assert!(whole.len() >= at_once.len(), "kill {kill}: {} of {}", whole.len(), at_once.len());
        room.run(&format!("sessions verify {CAPTURES}")).succeeds();
        let again = room.run(&format!("sessions repair {CAPTURES}")).succeeds();
        assert!(again.stdout.trim_end().ends_with(": whole"), "{again:?}");
        let info = room.run(&format!("info {CAPTURES}/{}", session.file_name().unwrap().display()));
        assert_eq!(info.code, Some(0), "{info:?}");
        if kill == 0 {
            other_readers_agree(&session, whole.len());
        }
    }
}

/// With the readers that people use in Python, if `REALITYSIM_PYTHON` names one that has them.
fn other_readers_agree(session: &Path, frames: usize) {
    let Some(python) = std::env::var_os("REALITYSIM_PYTHON") else {
        println!("skipped: REALITYSIM_PYTHON names no interpreter");
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recording/check_repaired.py");
    let output = Command::new(python).arg(script).arg(session).arg(frames.to_string()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_mount_that_vanishes_for_a_while_is_named_and_recovered_from() {
    let room = Room::new();
    let mut soak = Soak::start(&room, "--seconds 8 --rate 30 --frame-kb 20 --set recording.segment_s=1");
    soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(10));
    let (there, away) = (room.path(CAPTURES), room.path("away"));
    fs::rename(&there, &away).unwrap();
    soak.waits_for("named", |state| state["fault"]["cause"] == "disk_gone");
    fs::rename(&away, &there).unwrap();
    soak.waits_for("recovered", |state| state["fault"].is_null() && state["faults"]["disk_gone"].as_u64() > Some(0));
    let report: Value = soak.states.by_ref().map(|line| serde_json::from_str(&line.unwrap()).unwrap()).last().unwrap();
    assert!(soak.process.wait().unwrap().success(), "{report}");
    let counts = &report["counts"];
    assert_eq!((&counts["captured"], &counts["dropped"]), (&counts["written"], &serde_json::json!({})), "{report}");
    room.run(&format!("sessions repair {CAPTURES}")).succeeds();
    let all = frames(&only_session(&room), &[".mcap"]);
    assert_in_a_row(&all, "all of it waited in memory");
    assert_eq!(Some(all.len() as u64), counts["captured"].as_u64());
    room.run(&format!("sessions verify {CAPTURES}")).succeeds();
}

#[test]
fn a_session_that_is_being_recorded_is_left_alone() {
    let room = Room::new();
    let mut soak = Soak::start(&room, "--rate 30 --frame-kb 20");
    soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(0));
    let repaired = room.run(&format!("sessions repair {CAPTURES}")).succeeds();
    assert!(repaired.stdout.contains("is being recorded"), "{repaired:?}");
    assert!(only_session(&room).join("0000.mcap.active").is_file());
    soak.waits_for("it goes on", |state| state["segments_given_up"] == 0);
}

/// The stream of the issue, for a few seconds; `./dev soak` takes ten minutes.
#[test]
fn the_recorder_keeps_up_with_sixty_frames_and_five_hundred_measurements_a_second() {
    let room = Room::new();
    let run = room.run(&format!("soak -o {CAPTURES} --seconds 4 --json {ROOM_ENOUGH}")).succeeds();
    let report = run.json();
    assert_eq!(report["counts"]["dropped"], serde_json::json!({}), "{report}");
    assert!(report["counts"]["written"].as_u64() > Some(200), "{report}");
    assert!(report["recorder"]["conserved"] == true, "{report}");
    room.run(&format!("sessions verify {CAPTURES}")).succeeds();
}

#[test]
fn what_is_no_session_is_neither_touched_nor_followed() {
    let room = Room::new();
    room.run(&format!("soak -o {CAPTURES} --seconds 1 {ROOM_ENOUGH}")).succeeds();
    let session = only_session(&room);
    fs::write(session.join("notes.txt"), "mine").unwrap();
    fs::write(session.join("x.mcap.active"), "not ours").unwrap();
    std::os::unix::fs::symlink("/etc/passwd", session.join("0007.mcap.active")).unwrap();
    fs::create_dir(room.path(CAPTURES).join("other")).unwrap();
    fs::write(room.path(CAPTURES).join("other/0000.mcap.active"), "no session").unwrap();
    let whole = room.run(&format!("sessions repair {CAPTURES}")).succeeds();
    assert!(whole.stdout.trim_end().ends_with(": whole"), "{whole:?}");
    assert_eq!(fs::read_to_string(session.join("notes.txt")).unwrap(), "mine");
    assert!(session.join("x.mcap.active").is_file() && session.join("0007.mcap.active").is_symlink());

    // A name that leads out of the folder, and a version that is not known.
    let manifest = session.join("manifest.jsonl");
    let line = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, format!("{line}{}", line.replace("0000.mcap", "../../etc.mcap"))).unwrap();
    room.run(&format!("sessions verify {CAPTURES}")).fails(3, &[]);
    fs::write(&manifest, line).unwrap();
    let info = fs::read_to_string(session.join("session.json")).unwrap();
    fs::write(session.join("session.json"), info.replace("\"format\": 1", "\"format\": 9")).unwrap();
    room.run(&format!("sessions repair {CAPTURES}")).fails(1, &["written by a newer version (format 9"]);
}
