//! `realitysim doctor`: what is right, what is wrong, and what to do.

use std::io::Write;
use std::os::unix::process::CommandExt;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use mavlink::dialects::common::{ATTITUDE_QUATERNION_DATA, HEARTBEAT_DATA, MavFrame, MavMessage, ODOMETRY_DATA};
use mavlink::{MAVLinkV2MessageRaw, MavHeader};
use serde_json::Value;

use super::recorder::CONFIG;
use crate::replay::support::Room;
use crate::serial::Cable;

/// A microcontroller that says one thing, fifty times a second, and its heartbeat.
pub struct Board {
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Board {
    pub fn at(tty: &str, component_id: u8, message: fn(u64) -> MavMessage) -> Self {
        let mut line = std::fs::OpenOptions::new().write(true).open(tty).expect("the line");
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut header = MavHeader { system_id: 1, component_id, sequence: 0 };
            for tick in 0.. {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                let beat = (tick % 50 == 0).then_some(MavMessage::HEARTBEAT(HEARTBEAT_DATA::DEFAULT));
                for message in [message(tick * 20)].into_iter().chain(beat) {
                    let mut raw = MAVLinkV2MessageRaw::new();
                    raw.serialize_message(header, &message);
                    header.sequence = header.sequence.wrapping_add(1);
                    // The cable may be gone.
                    if line.write_all(raw.raw_bytes()).is_err() {
                        return;
                    }
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for Board {
    /// Waits until the board is silent. One that is stuck in a line that nobody reads any more ends with its cable.
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let is_silent = || self.thread.as_ref().is_none_or(std::thread::JoinHandle::is_finished);
        let until = Instant::now() + Duration::from_secs(1);
        while !is_silent() && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

pub fn odometry(ms: u64) -> MavMessage {
    MavMessage::ODOMETRY(ODOMETRY_DATA {
        time_usec: 1_000_000 + ms * 1_000,
        frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
        child_frame_id: MavFrame::MAV_FRAME_LOCAL_FLU,
        q: [1.0, 0.0, 0.0, 0.0],
        ..ODOMETRY_DATA::DEFAULT
    })
}

fn attitude(ms: u64) -> MavMessage {
    MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
        time_boot_ms: 1_000 + ms as u32,
        q1: 1.0,
        ..ATTITUDE_QUATERNION_DATA::DEFAULT
    })
}

fn room(ports: &[&str]) -> Room {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text);
    let ports: Vec<String> = ports.iter().map(|tty| format!("{{ device = \"{tty}\", baud = 115200 }}")).collect();
    room.write("robot.toml", format!("{CONFIG}[serial]\nports = [{}]\n", ports.join(", ")));
    room
}

struct Findings(Vec<Value>);

impl Findings {
    fn of(json: &Value) -> Self {
        Self(json.as_array().expect("findings").clone())
    }

    /// The lines whose name begins so: whether they are good, what they say, what to do.
    fn about(&self, what: &str) -> Vec<(bool, String, String)> {
        let text = |value: &Value| value.as_str().expect("text").to_owned();
        let lines = self.0.iter().filter(|line| text(&line["what"]).starts_with(what));
        let found: Vec<_> =
            lines.map(|line| (line["good"] == true, text(&line["said"]), text(&line["remedy"]))).collect();
        assert!(!found.is_empty(), "{what}: {:?}", self.0);
        found
    }
}

#[test]
fn it_names_what_is_wrong_and_what_to_do() {
    let cable = Cable::new();
    let room = room(&[&cable.ends[1]]);
    let examined = room.run("doctor -o captures --config robot.toml --json");
    assert_eq!(examined.code, Some(1), "{examined:?}");
    let findings = Findings::of(&examined.json());
    assert_eq!(findings.about("lens")[0], (true, "320 x 240".to_owned(), String::new()));
    assert!(findings.about("mount")[0].0 && findings.about("field")[0].0);
    let (good, said, remedy) = &findings.about("serial")[0];
    assert_eq!((*good, said.as_str()), (false, "silent"));
    assert!(remedy.contains("TX to RX"), "{remedy}");
    let (good, said, remedy) = &findings.about("measurements")[0];
    assert_eq!((*good, said.as_str()), (false, "no odometry, no attitude, no head"));
    assert!(remedy.contains("no port carries ODOMETRY or ATTITUDE_QUATERNION"), "{remedy}");
    for part in ["the worst of 40", "MiB for frames that wait", "a power cut costs at most"] {
        assert!(findings.about("disk")[0].1.contains(part), "{part}: {:?}", findings.0);
    }
    room.run("doctor -o captures").fails(1, &[]);
    let arguments = "doctor -o captures --set capture.device=/dev/no-such-camera --json";
    let findings = Findings::of(&room.run(arguments).json());
    let (good, said, _) = &findings.about("camera")[0];
    assert!(!good && said.contains("/dev/no-such-camera"), "{said}");
}

#[test]
fn two_boards_that_share_the_work_are_a_robot_that_is_ready() {
    let cables = [Cable::new(), Cable::new()];
    let _boards = [Board::at(&cables[0].ends[0], 1, odometry), Board::at(&cables[1].ends[0], 2, attitude)];
    let room = room(&[&cables[0].ends[1], &cables[1].ends[1]]);
    let findings = Findings::of(&room.run("doctor -o captures --config robot.toml --json").json());
    let ports = findings.about("serial");
    for ((good, said, _), (name, number)) in ports.iter().zip([("ODOMETRY", 1), ("ATTITUDE_QUATERNION", 2)]) {
        assert!(good, "{said}");
        assert!(said.contains(&format!("{name} ")) && said.contains("HEARTBEAT 1 Hz"), "{said}");
        let clock = format!("clock of 1.{number}, from its start: this machine's less ");
        assert!(said.contains(&clock) && said.contains("by Arrivals"), "{said}");
    }
    let (good, said, _) = &findings.about("measurements")[0];
    assert!(good, "{said}");
    for (name, cable) in [("odometry", &cables[0]), ("attitude", &cables[1])] {
        assert!(said.contains(name) && said.contains(&format!(" Hz from {}", cable.ends[1])), "{said}");
    }
}

#[test]
fn what_is_no_serial_port_is_said_to_be_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("odometry.txt");
    std::fs::write(&file, "x").expect("written");
    for device in ["/dev/null", file.to_str().expect("ASCII"), folder.path().to_str().expect("ASCII")] {
        let room = room(&[device]);
        let findings = Findings::of(&room.run("doctor -o captures --config robot.toml --json").json());
        let said = &findings.about("serial")[0].1;
        assert!(said.starts_with(&format!("{device} is no serial port; present are ")), "{said}");
    }
}

#[test]
fn what_is_no_camera_is_said_to_be_none() {
    let folder = tempfile::tempdir().expect("a folder");
    for device in ["/dev/null", folder.path().to_str().expect("ASCII")] {
        let room = room(&[]);
        let arguments = format!("doctor -o captures --config robot.toml --set capture.device={device} --json");
        let findings = Findings::of(&room.run(&arguments).json());
        let (good, said, _) = &findings.about("camera")[0];
        assert!(!good && said.starts_with(&format!("{device} is no camera that streams; present are ")), "{said}");
    }
}

/// Whoever runs this test may be root, who may do everything: nobody tries it then.
#[test]
fn who_may_not_open_a_port_is_told_the_group() {
    let cable = Cable::new();
    let tty = cable.ends[1].as_str();
    let is_root = rustix::process::geteuid().is_root();
    rustix::fs::chmod(tty, rustix::fs::Mode::from(if is_root { 0o600 } else { 0o000 })).expect("mine");
    let room = room(&[tty]);
    let program = room.path("program");
    std::fs::copy(env!("CARGO_BIN_EXE_realitysim"), &program).expect("copied");
    let open = |path: &str| rustix::fs::chmod(room.path(path), rustix::fs::Mode::from(0o777)).expect("mine");
    open("");
    open("program");
    let mut doctor = Command::new(&program);
    doctor.args(["doctor", "-o", "/tmp", "--config", "robot.toml", "--json"]).current_dir(room.path(""));
    if is_root {
        doctor.uid(65_534).gid(65_534);
    }
    let output = doctor.output().expect("started");
    let findings = Findings::of(&serde_json::from_slice(&output.stdout).expect("JSON"));
    let (good, said, _) = &findings.about("serial")[0];
    assert!(!good && said.starts_with(&format!("{tty}: no permission: ")), "{said}");
    // A pty is of the group tty or of whoever made it, for whom nothing is allowed here: udev is told to.
    assert!(said.contains("a udev rule must give it to the group dialout"), "{said}");
}
