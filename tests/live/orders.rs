//! Sessions that begin and end, and orders to a recorder that runs.

use std::time::Duration;

use super::recorder::{PATIENCE, Recorder};
use super::robot::Robot;
use crate::replay::support::{CAPTURES, Room, walk};

#[test]
fn a_session_can_be_stopped_and_another_begun() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    let stopped = recorder.asks("stop");
    assert_eq!(stopped["state"], "stopped");
    let first = stopped["session"].as_str().expect("a session").to_owned();
    assert!(recorder.room.path(&first).join("0000.mcap").is_file(), "whole, while the recorder runs");
    assert_eq!(recorder.asks("start")["state"], "recording");
    recorder.waits_for("another session", |status| status["session"].as_str().is_some_and(|session| session != first));
    let status = recorder.asks("status");
    assert_eq!((&status["earlier"]["sessions"], &status["earlier"]["unfinished"]), (&1.into(), &0.into()), "{status}");
    assert!(recorder.ends().status.success());
    assert!(recorder.room.run("recorder status --socket control.sock").code == Some(1), "nobody answers any more");
    // Neither had a camera.
    recorder.room.run(&format!("db add {CAPTURES} --db db")).fails(1, &["nothing was added"]);
}

#[test]
fn who_orders_a_stop_before_the_first_session_is_obeyed() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    recorder.waits_for("it answers", |status| status["state"] == "listening");
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
    recorder.waits_for("it answers", |status| status["state"] == "listening");
    assert!(recorder.ends().status.success());
    let sessions = std::fs::read_dir(recorder.room.path(CAPTURES)).into_iter().flatten().flatten();
    assert_eq!(sessions.filter(|entry| entry.path().is_dir()).count(), 0);
}

/// As `timeout` sends it: to the process, and to its group.
#[test]
fn a_signal_that_comes_twice_is_one() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    let process = recorder.process.as_ref().expect("running").id();
    let id = rustix::process::Pid::from_raw(process as i32).expect("a process");
    rustix::process::kill_process(id, rustix::process::Signal::TERM).expect("alive");
    std::thread::sleep(Duration::from_millis(20));
    let output = recorder.ends();
    assert!(output.status.success(), "{output:?}");
}

/// Nobody at its socket can keep it from being asked, or make it do what was not said.
#[test]
fn orders_are_taken_whole_or_not_at_all() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    let order = |line: &str| recorder.room.run(&format!("recorder {line} --socket control.sock"));
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
    // Those who say nothing, or drip a byte now and then, give way to others.
    let connect = || std::os::unix::net::UnixStream::connect(recorder.room.path("control.sock")).expect("a recorder");
    let idle: Vec<_> = (0..40).map(|_| connect()).collect();
    idle.iter().for_each(|mut asker| drop(std::io::Write::write_all(&mut asker, b"s")));
    for _ in 0..20 {
        assert_eq!(recorder.asks("status")["state"], "stopped");
    }
    drop(idle);
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

/// Whether a process has opened a connection, beside its three streams.
fn has_a_socket(process: &std::process::Child) -> bool {
    let open = std::fs::read_dir(format!("/proc/{}/fd", process.id())).into_iter().flatten().flatten();
    let sockets = open.filter_map(|file| std::fs::read_link(file.path()).ok());
    sockets.filter(|to| to.to_string_lossy().starts_with("socket:")).count() > 0
}

#[test]
fn what_a_kill_left_is_finished_when_the_next_recording_starts() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    let torn = recorder.asks("status")["session"].as_str().expect("a session").to_owned();
    let active = recorder.room.path(&torn).join("0000.mcap.active");
    let listener = recorder.listens_to_poses();
    let began = std::time::Instant::now();
    while !(active.is_file() && has_a_socket(&listener)) {
        assert!(began.elapsed() < PATIENCE, "no segment, or nobody who listens");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let mut process = recorder.process.take().expect("running");
    process.kill().expect("alive");
    process.wait().expect("ended");
    assert_eq!(listener.wait_with_output().expect("ended").status.code(), Some(1), "nobody ended the recording");
    assert!(active.is_file(), "never finished");
    recorder.process = Some(Recorder::process(&recorder.room, "-2.06,0.153,14.5"));
    recorder.waits_for("it is told", |status| status["repaired"].as_array().is_some_and(|all| !all.is_empty()));
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
    room.run("recorder status --socket control.sock").fails(1, &["no recorder is running there"]);
}

/// Files, sockets and pipes of the whole process are short for a moment, as when something else leaks them.
#[test]
fn a_connection_that_cannot_be_accepted_is_not_the_last() {
    use rustix::process::{Pid, Resource, Rlimit, prlimit};

    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    let process = recorder.process.as_ref().expect("running").id();
    let process = Pid::from_raw(process as i32);
    let socket = recorder.room.path("control.sock");
    // The kernel has accepted it, the recorder cannot.
    let few = Rlimit { current: Some(3), ..rustix::process::getrlimit(Resource::Nofile) };
    let before = prlimit(process, Resource::Nofile, few).expect("its limit");
    let refused = std::os::unix::net::UnixStream::connect(&socket).expect("a recorder");
    std::thread::sleep(Duration::from_millis(300));
    prlimit(process, Resource::Nofile, before).expect("its limit");
    assert_eq!(recorder.asks("status")["state"], "recording");
    drop(refused);
    assert!(recorder.ends().status.success());
}
