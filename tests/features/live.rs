//! A watched robot in Foxglove: a client of its protocol subscribes, the robot goes away and comes back, and frames go on.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, ChildStdout, Command, Stdio};

use serde_json::Value;

use crate::live::recorder::Recorder;
use crate::live::robot::Robot;
use crate::live::watch::Watch;
use crate::replay::support::{Room, walk};

/// Names a Python interpreter that has `websockets` and `mcap-ros2-support`.
const INTERPRETER: &str = "REALITYSIM_PYTHON";

/// A viewer that says what it sees, a line at a time; ends with the test.
struct Viewer {
    process: Child,
    said: BufReader<ChildStdout>,
}

impl Viewer {
    /// `None` without an interpreter.
    fn of(watch: &Watch) -> Option<Self> {
        let Some(python) = std::env::var_os(INTERPRETER) else {
            println!("skipped: {INTERPRETER} names no interpreter");
            return None;
        };
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/features/view_live.py");
        let mut viewer = Command::new(python);
        viewer.arg("-B").arg(script).arg(format!("ws://{}", watch.foxglove()));
        let mut process = viewer.stdout(Stdio::piped()).spawn().expect("python");
        let said = BufReader::new(process.stdout.take().expect("piped"));
        Some(Self { process, said })
    }

    fn says(&mut self) -> String {
        let mut line = String::new();
        self.said.read_line(&mut line).expect("a line");
        line.trim().to_owned()
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn a_viewer_sees_frames_before_and_after_the_robot_was_away() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    let watch = Watch::of(&recorder.room.path(""), &["control.sock", "--foxglove", "0"]);
    let Some(mut viewer) = Viewer::of(&watch) else { return };
    assert_eq!(viewer.says(), "subscribed");
    let camera = recorder.room.path("camera.sock");
    let (to_camera, _line) = (camera.clone(), robot.listens());
    let walking = std::thread::spawn(move || robot.walk(&to_camera));
    assert_eq!(viewer.says(), "frames");
    let (_, robot) = walking.join().expect("walked");

    let mut process = recorder.process.take().expect("running");
    process.kill().expect("alive");
    process.wait().expect("ended");
    let away = viewer.says();
    assert!(away.starts_with("away: no recorder answers at control.sock"), "{away}");

    recorder.process = Some(Recorder::process(&recorder.room, "-2.06,0.153,14.5"));
    recorder.waits_for("it is back", |status| status["state"] == "recording");
    let _line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&camera));
    assert_eq!(viewer.says(), "frames");
    assert!(viewer.process.wait().expect("ended").success());
    walking.join().expect("walked");
    assert!(recorder.ends().status.success());
}

#[test]
fn a_port_alone_is_one_of_this_machine_and_a_taken_one_is_named() {
    let room = Room::new();
    let watch = Watch::of(&room.path(""), &["control.sock", "--foxglove", "0"]);
    assert!(watch.foxglove().ip().is_loopback());
    let taken = watch.foxglove();
    let again = format!("live control.sock --listen 127.0.0.1:0 --foxglove {}", taken.port());
    room.run(&again).fails(1, &[&format!("--foxglove {taken}"), "in use"]);
    room.run("live control.sock --foxglove here").fails(2, &["a port is needed, as in 8766"]);
}

#[test]
fn without_the_option_no_port_is_opened_for_viewers() {
    let room = Room::new();
    assert_eq!(Watch::of(&room.path(""), &["control.sock"]).ready()["foxglove"], Value::Null);
}
