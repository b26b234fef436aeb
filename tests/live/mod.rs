//! The agent as on a robot: a simulated walk comes in real time over a socket (frames) and a serial line (MAVLink).

mod delay;
mod doctor;
mod load;
mod play;
mod ports;
mod robot;
mod sender;

use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::replay::support::{CAPTURES, IMAGE, Room, TAG, TRUTH, decode_all, on, read_capture, walk};
use mavlink::dialects::common::{MavFrame, ODOMETRY_DATA};
use realitysim::ros2::messages::{DiagnosticArray, FrameTag, PoseStamped};
use robot::Robot;

const CONFIG: &str = r#"
robot = "r1"
[camera]
lens = "lens.toml"
[capture]
device = "unix:camera.sock"
delay_ms = 4.0
[mount]
torso_height_m = 0.38
camera_xyz_m = [0.04, 0.0, 0.11]
camera_rpy_deg = [0.0, 17.0, 0.0]
[recording]
floor_mb = 1
floor_percent = 0.0
"#;

struct Recorder {
    room: Room,
    process: Option<std::process::Child>,
}

impl Recorder {
    fn start(tty: Option<&str>) -> Self {
        Self::start_at(tty, CONFIG, "-2.06,0.153,14.5")
    }

    fn start_at(tty: Option<&str>, config: &str, initial: &str) -> Self {
        let room = Room::new();
        room.write_scene("scene.toml", |text| text);
        let ports = tty.map_or(String::new(), |tty| {
            format!("[serial]\nports = [{{ device = \"{tty}\", baud = 921600, poses = true }}]\n")
        });
        room.write("robot.toml", format!("{config}{ports}"));
        let process = Some(Self::process(&room, initial));
        Self { room, process }
    }

    fn process(room: &Room, initial: &str) -> std::process::Child {
        Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["record", "-o", CAPTURES, "--config", "robot.toml", "--socket", "control.sock"])
            .args(["--initial", initial, "--json"])
            .current_dir(room.path(""))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("started")
    }

    fn asks(&self, order: &str) -> serde_json::Value {
        self.room.run(&format!("{order} --socket control.sock --json")).succeeds().json()
    }

    fn waits_for(&self, what: &str, seconds: u64, is: impl Fn(&serde_json::Value) -> bool) {
        let began = Instant::now();
        loop {
            let run = self.room.run("status --socket control.sock --json");
            if run.code == Some(0) && is(&run.json()) {
                return;
            }
            assert!(began.elapsed() < Duration::from_secs(seconds), "{what}: {run:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// As soon as there is somebody to listen to: until the recorder ends.
    fn listens_to_poses(&self) -> std::process::Child {
        self.waits_for("it answers", 30, |_| true);
        Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["poses", "--socket", "control.sock"])
            .current_dir(self.room.path(""))
            .stdout(Stdio::piped())
            .spawn()
            .expect("started")
    }

    /// As systemd does it.
    fn ends(&mut self) -> Output {
        let process = self.process.take().expect("running");
        let id = rustix::process::Pid::from_raw(process.id() as i32).expect("a process");
        rustix::process::kill_process(id, rustix::process::Signal::TERM).expect("alive");
        let asked = Instant::now();
        let output = process.wait_with_output().expect("ended");
        assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
        output
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        if let Some(process) = &mut self.process {
            let _ = process.kill();
            let _ = process.wait();
        }
    }
}

#[test]
fn a_walk_is_tagged_live_and_its_capture_gives_the_same_tags() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    let frames = robot.frames();
    let socket = recorder.room.path("camera.sock");
    let line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&socket));
    let listener = recorder.listens_to_poses();
    recorder.waits_for("the walk begins", 30, |status| status["counts"]["written"].as_u64() > Some(5));
    assert_eq!(recorder.asks("mark goal!")["marked"], "goal!");
    let (stamps, robot) = walking.join().expect("walked");
    recorder.waits_for("all frames", 20, |status| status["counts"]["written"].as_u64() == Some(frames as u64));
    let status = recorder.asks("status");
    let port = &status["ports"].as_object().expect("ports").values().next().expect("one").clone();
    assert_eq!((port["lost"].as_u64(), port["crc_failures"].as_u64()), (Some(0), Some(0)), "{status}");
    assert!(status["budget"]["p50_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{status}");
    assert!(status["filter"]["particles"].as_f64().is_some_and(|particles| particles > 10.0), "{status}");
    assert!(status["filter"]["spread_m"].as_f64().is_some_and(|spread_m| spread_m > 0.0), "{status}");
    assert!(status["coverage"]["map"].as_array().is_some_and(|rows| !rows.is_empty()), "{status}");
    assert!(status["validity"]["valid"].as_u64().is_some_and(|valid| valid as usize * 10 >= frames * 8), "{status}");
    let counted = |key: &str| status["counts"][key].as_u64().expect("a count");
    let dropped: u64 =
        status["counts"]["dropped"].as_object().expect("causes").values().filter_map(|n| n.as_u64()).sum();
    let disk = &status["recorder"];
    let waiting = disk["frames_waiting"].as_u64().expect("a count");
    assert_eq!(counted("captured"), counted("written") + counted("thinned") + dropped + waiting, "{status}");
    assert_eq!(disk["conserved"], true);
    assert!(disk["free_bytes"].as_u64().is_some_and(|bytes| bytes > 0), "{status}");
    assert!(disk["loss_bound_ms"].as_f64() >= disk["worst_stall_ms"].as_f64(), "{status}");
    let said = recorder.room.run("status --socket control.sock");
    for part in [
        "last second:",
        "wait for the agent",
        "wait for the disk",
        "ms each",
        "of the last",
        "of the disk free",
        " s behind to ",
    ] {
        assert!(said.stdout.contains(part), "{part}: {said:?}");
    }
    let output = recorder.ends();
    assert!(output.status.success(), "{output:?}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let session = recorder.room.path(report["session"].as_str().expect("a session"));

    let recorded = read_capture(&session);
    let tags: Vec<FrameTag> = decode_all(&recorded, TAG);
    assert_eq!(tags.len(), frames);
    assert_eq!(on(&recorded, IMAGE).count(), frames);
    // Byte for byte what the camera sent.
    for (one, sent) in on(&recorded, IMAGE).zip(on(&walk().messages, IMAGE)) {
        let data =
            |bytes: &[u8]| realitysim::ros2::messages::CompressedImageView::decode(bytes).map(|v| v.data.to_vec());
        assert!(data(&one.data).expect("an image") == data(&sent.data).expect("an image"));
    }
    the_robot_was_told_its_poses(&line.join().expect("listened"), &tags);
    whoever_listened_heard_every_tag(listener, &tags);
    drop(robot);
    for (tag, stamp_ns) in tags.iter().zip(&stamps) {
        assert_eq!(tag.kernel_stamp_ns, *stamp_ns, "the kernel's own stamp");
        assert_eq!(tag.header.stamp.to_nanoseconds(), stamp_ns + tag.utc_offset_ns - 4_000_000, "less the delay");
    }
    let marks: Vec<DiagnosticArray> = decode_all(&recorded, "/diagnostics");
    assert!(marks.iter().flat_map(|report| &report.status).any(|status| status.message == "goal!"));

    let truth: Vec<PoseStamped> = decode_all(&walk().messages, TRUTH);
    let valid: Vec<f64> = tags
        .iter()
        .zip(&truth)
        .filter(|(tag, _)| tag.valid)
        .map(|(tag, truth)| {
            let (p, q) = (&tag.pose.pose.position, &truth.pose.position);
            (p.x - q.x).hypot(p.y - q.y)
        })
        .collect();
    assert!(valid.len() * 10 >= frames * 8, "{} of {frames} valid", valid.len());
    let mean = valid.iter().sum::<f64>() / valid.len() as f64;
    assert!(mean < 0.03, "{mean} m");

    let name = format!("{CAPTURES}/{}", session.file_name().expect("a name").to_string_lossy());
    let replayed = recorder.room.replay(&format!("{name} --config robot.toml"));
    assert_eq!(replayed.tags.len(), tags.len());
    for (again, tag) in replayed.tags.iter().zip(&tags) {
        let live = (tag.sequence, tag.valid, &tag.reason, &tag.pose, &tag.best_particle, tag.odometry_until);
        let later =
            (again.sequence, again.valid, &again.reason, &again.pose, &again.best_particle, again.odometry_until);
        assert_eq!(later, live);
    }
}

/// A line of JSON each, as they were recorded.
fn whoever_listened_heard_every_tag(listener: std::process::Child, tags: &[FrameTag]) {
    let output = listener.wait_with_output().expect("ended with the recorder");
    assert!(output.status.success(), "{output:?}");
    let lines: Vec<serde_json::Value> =
        output.stdout.split(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice(line).ok()).collect();
    assert_eq!(lines.len(), tags.len());
    for (line, tag) in lines.iter().zip(tags) {
        assert_eq!((line["sequence"].as_u64(), line["valid"].as_bool()), (Some(tag.sequence), Some(tag.valid)));
        assert_eq!(line["pose"]["pose"]["position"]["x"].as_f64(), Some(tag.pose.pose.position.x));
    }
}

/// Every valid tag, as ODOMETRY on the line, by the clock that its time questions were answered with.
fn the_robot_was_told_its_poses(told: &[ODOMETRY_DATA], tags: &[FrameTag]) {
    let valid: Vec<&FrameTag> = tags.iter().filter(|tag| tag.valid).collect();
    assert_eq!(told.len(), valid.len());
    for (said, tag) in told.iter().zip(valid) {
        let exposed_ns = tag.header.stamp.to_nanoseconds() - tag.utc_offset_ns;
        assert_eq!(said.time_usec as i64, exposed_ns / 1_000);
        let p = &tag.pose.pose.position;
        assert_eq!([said.x, said.y, said.z], [p.x, p.y, p.z].map(|part| part as f32));
        assert_eq!(said.pose_covariance[0], tag.pose.covariance[0] as f32);
        assert_eq!(said.frame_id, MavFrame::MAV_FRAME_LOCAL_FLU);
    }
}

#[test]
fn poses_go_out_although_the_disk_takes_nothing() {
    let robot = Robot::of(&walk().messages);
    let config = CONFIG.replace("floor_mb = 1", "floor_mb = 100000000");
    let mut recorder = Recorder::start_at(Some(robot.tty()), &config, "-2.06,0.153,14.5");
    let (frames, socket) = (robot.frames(), recorder.room.path("camera.sock"));
    let line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&socket));
    let (_, robot) = walking.join().expect("walked");
    recorder.waits_for("all frames", 20, |status| {
        let dropped = status["counts"]["dropped"].as_object().into_iter().flatten();
        dropped.filter_map(|(_, count)| count.as_u64()).sum::<u64>() == frames as u64
    });
    let status = recorder.asks("status");
    assert_eq!(
        (&status["recorder"]["stopped"]["cause"], status["counts"]["written"].as_u64()),
        (&"disk_full".into(), Some(0))
    );
    recorder.ends();
    let told = line.join().expect("listened");
    drop(robot);
    assert!(10 * told.len() >= 8 * frames, "{} poses of {frames} frames", told.len());
}

/// Its frames are lost, and told to be, also after another session that had nothing to lose.
#[test]
fn what_an_earlier_session_lost_is_in_the_last_account() {
    let robot = Robot::of(&walk().messages);
    let config = CONFIG.replace("floor_mb = 1", "floor_mb = 100000000");
    let mut recorder = Recorder::start_at(Some(robot.tty()), &config, "-2.06,0.153,14.5");
    let (frames, socket) = (robot.frames(), recorder.room.path("camera.sock"));
    std::thread::spawn(move || robot.walk(&socket)).join().expect("walked");
    recorder.waits_for("all frames", 20, |status| status["counts"]["captured"].as_u64() == Some(frames as u64));
    recorder.asks("stop");
    assert_eq!(recorder.asks("start")["state"], "recording");
    let output = recorder.ends();
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let earlier = &report["earlier"];
    assert_eq!((&earlier["sessions"], &earlier["counts"]["captured"]), (&1.into(), &frames.into()), "{report}");
    assert!(earlier["frames_refused"].as_u64() > Some(0) && report["counts"]["captured"] == 0, "{report}");
}

#[test]
fn a_session_can_be_stopped_and_another_begun() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", 30, |status| status["state"] == "recording");
    let stopped = recorder.asks("stop");
    assert_eq!(stopped["state"], "stopped");
    let first = stopped["session"].as_str().expect("a session").to_owned();
    assert!(recorder.room.path(&first).join("0000.mcap").is_file(), "whole, while the recorder runs");
    assert_eq!(recorder.asks("start")["state"], "recording");
    recorder
        .waits_for("another session", 5, |status| status["session"].as_str().is_some_and(|session| session != first));
    let status = recorder.asks("status");
    assert_eq!((&status["earlier"]["sessions"], &status["earlier"]["unfinished"]), (&1.into(), &0.into()), "{status}");
    assert!(recorder.ends().status.success());
    assert!(recorder.room.run("status --socket control.sock").code == Some(1), "nobody answers any more");
}

#[test]
fn who_orders_a_stop_before_the_first_session_is_obeyed() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    recorder.waits_for("it answers", 30, |status| status["state"] == "listening");
    assert_eq!(recorder.asks("stop")["state"], "stopped");
    std::thread::sleep(Duration::from_secs(3));
    assert_eq!(recorder.asks("status")["state"], "stopped");
    assert_eq!(recorder.asks("start")["state"], "recording");
    assert!(recorder.ends().status.success());
}

#[test]
fn who_is_ended_before_the_first_session_leaves_none() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    recorder.waits_for("it answers", 30, |status| status["state"] == "listening");
    assert!(recorder.ends().status.success());
    let sessions = std::fs::read_dir(recorder.room.path(CAPTURES)).into_iter().flatten().flatten();
    assert_eq!(sessions.filter(|entry| entry.path().is_dir()).count(), 0);
}

/// Nobody at its socket can keep it from being asked, or make it do what was not said.
#[test]
fn orders_are_taken_whole_or_not_at_all() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", 30, |status| status["state"] == "recording");
    let order = |line: &str| recorder.room.run(&format!("{line} --socket control.sock"));
    order(&format!("mark {}stop", "a".repeat(4091))).fails(1, &["an order has at most 4096 bytes"]);
    order(&format!("mark {}", "é".repeat(3000))).fails(1, &["an order has at most 4096 bytes"]);
    // Larger than the socket's own buffer.
    let mut long = std::os::unix::net::UnixStream::connect(recorder.room.path("control.sock")).expect("a recorder");
    std::io::Write::write_all(&mut long, "a".repeat(500_000).as_bytes()).expect("taken");
    let mut said = String::new();
    std::io::Read::read_to_string(&mut long, &mut said).expect("answered");
    assert!(said.contains("an order has at most 4096 bytes"), "{said}");
    assert_eq!(recorder.asks("status")["state"], "recording");
    recorder.asks("stop");
    order("mark goal!").fails(1, &["nothing is being recorded"]);
    // One asker too many is told, whatever it asks.
    let idle: Vec<_> = (0..16)
        .map(|_| std::os::unix::net::UnixStream::connect(recorder.room.path("control.sock")).expect("a recorder"))
        .collect();
    std::thread::sleep(Duration::from_millis(200));
    for _ in 0..5 {
        let run = recorder.room.run("poses --socket control.sock");
        assert!(run.code == Some(1) && run.stdout.is_empty() && run.stderr.contains("16 others"), "{run:?}");
    }
    drop(idle);
    std::thread::sleep(Duration::from_millis(200));
    // While there are no poses.
    let socket = recorder.room.path("control.sock");
    for _ in 0..3 {
        for _ in 0..16 {
            let mut listener = std::os::unix::net::UnixStream::connect(&socket).expect("a recorder");
            std::io::Write::write_all(&mut listener, b"poses\n").expect("asked");
        }
        std::thread::sleep(Duration::from_millis(600));
    }
    // Who has said all it will still listens.
    let patient = std::os::unix::net::UnixStream::connect(&socket).expect("a recorder");
    std::io::Write::write_all(&mut (&patient), b"poses\n").expect("asked");
    patient.shutdown(std::net::Shutdown::Write).expect("half closed");
    patient.set_read_timeout(Some(Duration::from_millis(700))).expect("set");
    let waited = std::io::Read::read(&mut (&patient), &mut [0; 1]).map_err(|error| error.kind());
    assert_eq!(waited, Err(std::io::ErrorKind::WouldBlock), "hung up on");
    assert_eq!(recorder.asks("start")["state"], "recording");
    assert!(recorder.ends().status.success());
}

#[test]
fn what_a_kill_left_is_finished_when_the_next_recording_starts() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", 30, |status| status["state"] == "recording");
    let torn = recorder.asks("status")["session"].as_str().expect("a session").to_owned();
    let mut process = recorder.process.take().expect("running");
    process.kill().expect("alive");
    process.wait().expect("ended");
    let active = recorder.room.path(&torn).join("0000.mcap.active");
    assert!(active.is_file(), "never finished");
    recorder.process = Some(Recorder::process(&recorder.room, "-2.06,0.153,14.5"));
    recorder.waits_for("it is told", 30, |status| status["repaired"].as_array().is_some_and(|all| !all.is_empty()));
    assert!(!active.exists());
    recorder.room.run(&format!("sessions verify {torn}")).succeeds();
    assert!(recorder.ends().status.success());
}

#[test]
fn what_a_recording_needs_is_asked_for() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text);
    let record = |arguments: &str| room.run(&format!("record -o {CAPTURES} --socket control.sock {arguments}"));
    record("").fails(2, &["camera.lens is not set"]);
    record("--lens lens.toml").fails(2, &["mount.torso_height_m is not set"]);
    record("--lens lens.toml --set mount.torso_height_m=0.4 --set mount.camera_rpy_deg=[0,-90,0]").fails(2, &["up"]);
    record("--set capture.device=unix:").fails(2, &["capture.device", "unix:/run/realitysim/camera.sock"]);
    assert!(!room.path(CAPTURES).exists(), "nothing was begun");
    room.run("status --socket control.sock").fails(1, &["no recorder is running there"]);
}
