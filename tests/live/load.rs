//! What the whole agent costs at a camera's full rate: `./dev load`.

use std::fs;
use std::time::{Duration, Instant};

use serde_json::json;

use super::recorder::{CONFIG, Recorder};
use super::robot::Robot;
use super::watch::Watch;
use crate::replay::support::{Room, read_log};

/// Of Linux on every machine this is built for.
const USER_HZ: f64 = 100.0;

const MAX_CORE_SHARE: f64 = 0.25;
const MAX_MEMORY_MB: f64 = 150.0;

#[test]
#[ignore = "a measurement, for a machine that does nothing else: `./dev load`"]
fn thirty_frames_a_second_of_640_by_480() {
    let room = Room::new();
    let scene = fs::read_to_string("replay/scenes/straight.toml").expect("a scene");
    assert!(scene.contains("rate_hz = 10.0\njpeg_quality"), "{scene}");
    room.write("scene.toml", scene.replace("rate_hz = 10.0\njpeg_quality", "rate_hz = 30.0\njpeg_quality"));
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let robot = Robot::of(&read_log(&room.path("log.mcap")));
    let frames = robot.frames() as u64;

    let config = CONFIG.replace("lens.toml", "fisheye-640");
    let mut recorder = Recorder::start_at(Some(robot.tty()), &config, "-2.96,0.153,2");
    let socket = recorder.room.path("camera.sock");
    let _line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&socket));
    recorder.waits_for("the walk begins", |status| status["counts"]["tagged"].as_u64() > Some(30));
    let process = recorder.process.as_ref().expect("running").id();
    let (began, cpu_s) = (std::time::Instant::now(), cpu_s(process));
    let (_, _robot) = walking.join().expect("walked");
    let share = (self::cpu_s(process) - cpu_s) / began.elapsed().as_secs_f64();
    recorder.waits_for("all frames", |status| status["counts"]["tagged"].as_u64() == Some(frames));
    let status = recorder.asks("status");
    let counts = &status["counts"];
    let peak_mb = peak_mb(process);
    println!(
        "{}",
        json!({
            "frames": frames, "seconds": began.elapsed().as_secs_f64(), "dropped": counts["dropped"], "valid": counts["valid"],
            "of_a_core": share, "peak_mb": peak_mb, "tagging": status["budget"],
        })
    );
    assert!(share < MAX_CORE_SHARE && peak_mb < MAX_MEMORY_MB, "{share} of a core, {peak_mb} MB");
    assert!(counts["valid"].as_u64() > Some(frames * 9 / 10), "{status}");
    assert!(recorder.ends().status.success());
}

/// Length of each of the measurements.
const WINDOW: Duration = Duration::from_secs(6);
/// What being watched may cost the recorder, as a share of a core.
const MAX_WATCHED_SHARE: f64 = 0.02;

#[test]
#[ignore = "a measurement, for a machine that does nothing else: `./dev load`"]
fn being_watched_costs_less_than_two_percent_of_a_core_and_no_frame() {
    let room = Room::new();
    let scene = fs::read_to_string("replay/scenes/loop.toml").expect("a scene");
    room.write("scene.toml", scene);
    room.run("scene render scene.toml -o log.mcap").succeeds();
    let robot = Robot::of(&read_log(&room.path("log.mcap")));
    let config = CONFIG.replace("lens.toml", "fisheye-640");
    let mut recorder = Recorder::start_at(Some(robot.tty()), &config, "-2.15,-1.24,-5.7");
    let socket = recorder.room.path("camera.sock");
    let _line = robot.listens();
    let walking = std::thread::spawn(move || robot.walk(&socket));
    // To begin with the whole field is searched, which costs more than anything later.
    recorder.waits_for("it follows its pose", |status| status["counts"]["valid"].as_u64() > Some(30));
    let process = recorder.process.as_ref().expect("running").id();
    let tagged = || recorder.asks("status")["counts"]["tagged"].as_u64().unwrap_or(0);
    let share = |looks: &dyn Fn()| {
        let frames = tagged();
        let (began, before) = (Instant::now(), cpu_s(process));
        while began.elapsed() < WINDOW {
            looks();
            std::thread::sleep(Duration::from_millis(200));
        }
        let share = (cpu_s(process) - before) / began.elapsed().as_secs_f64();
        let tagged = tagged() - frames;
        assert!(tagged > 40, "{tagged} frames: the robot has stopped walking");
        share
    };
    let before = share(&|| ());
    let watch = Watch::of(&recorder.room.path(""), &["control.sock"]);
    watch.waits_for("a frame", |state| state["frame"]["tag"]["sequence"].is_u64());
    let watched = share(&|| drop(watch.waits_for("an answer", |_| true)));
    drop(watch);
    let after = share(&|| ());
    let alone = (before + after) / 2.0;
    let dropped = recorder.asks("status")["counts"]["dropped"].clone();
    println!("{}", json!({ "of_a_core": [before, after], "of_a_core_watched": watched, "dropped": dropped }));
    assert!(watched - alone < MAX_WATCHED_SHARE && dropped == json!({}), "{alone} alone, {watched} watched, {dropped}");
    assert!(recorder.ends().status.success());
    drop(walking);
}

/// Of all threads so far.
fn cpu_s(process: u32) -> f64 {
    let stat = fs::read_to_string(format!("/proc/{process}/stat")).expect("a process");
    let (_, fields) = stat.rsplit_once(')').expect("its name");
    let ticks: u64 = fields.split_whitespace().skip(11).take(2).map(|field| field.parse::<u64>().expect("ticks")).sum();
    ticks as f64 / USER_HZ
}

fn peak_mb(process: u32) -> f64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).expect("a process");
    let line = status.lines().find(|line| line.starts_with("VmHWM")).expect("a peak");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<f64>().ok()).expect("kB") / 1e3
}
