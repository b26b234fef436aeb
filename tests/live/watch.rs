//! A recorder that is watched in the page, over its control socket and through ssh.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use super::no_frames::slower;
use super::recorder::{PATIENCE, Recorder};
use super::robot::Robot;
use crate::replay::support::{INITIAL, Room, walk};
use crate::service::client::{get, post};
use crate::sync::site::Site;

/// The program as a watcher; ends with the test.
pub struct Watch {
    /// What it said when it was ready.
    ready: Value,
    process: Child,
}

impl Watch {
    pub fn of(folder: &Path, arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
        command.arg("live").args(arguments).args(["--listen", "127.0.0.1:0", "--json"]).current_dir(folder);
        let mut process = command.stdout(Stdio::piped()).spawn().expect("started");
        let mut line = String::new();
        BufReader::new(process.stdout.take().expect("piped")).read_line(&mut line).expect("a line");
        let ready: Value = serde_json::from_str(&line).expect("where it listens");
        Self { ready, process }
    }

    pub fn address(&self) -> SocketAddr {
        self.ready["listening"].as_str().and_then(|text| text.parse().ok()).expect("an address")
    }

    pub fn waits_for(&self, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let state = get(self.address(), "/v1/live").json();
            if is(&state) {
                return state;
            }
            assert!(began.elapsed() < PATIENCE, "{what}: {state}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    #[cfg(feature = "live")]
    pub fn foxglove(&self) -> SocketAddr {
        self.ready["foxglove"].as_str().and_then(|text| text.parse().ok()).expect("an address")
    }

    #[cfg(feature = "live")]
    pub fn ready(&self) -> &Value {
        &self.ready
    }

    fn order(&self, order: &str) -> (u16, Value) {
        let answer = post(self.address(), "/v1/live/order", &serde_json::json!({ "order": order }).to_string());
        (answer.status, answer.json())
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

#[test]
fn a_watched_robot_shows_its_frames_with_lines_and_takes_orders() {
    let robot = Robot::of(&walk().messages);
    let mut recorder = Recorder::start(Some(robot.tty()));
    let watch = Watch::of(&recorder.room.path(""), &["control.sock"]);
    let camera = recorder.room.path("camera.sock");
    let walking = std::thread::spawn(move || robot.walk(&camera));
    let state = watch.waits_for("a valid frame", |state| state["frame"]["tag"]["valid"] == true);
    assert_eq!((&state["connected"], &state["frame"]["lens"]["width"]), (&true.into(), &320.into()), "{state}");
    assert!(state["frame"]["lines"].as_array().is_some_and(|lines| lines.len() > 3), "{state}");
    assert!(state["words"].as_array().is_some_and(|words| words.len() > 3), "{state}");
    let picture = get(watch.address(), "/v1/live/frame");
    assert!(picture.status == 200 && picture.body.starts_with(&[0xff, 0xd8]), "{}", picture.status);
    // Lines are drawn on the picture of their own frame, whatever came since.
    let state = watch.waits_for("a frame", |state| state["frame"]["tag"]["sequence"].is_u64());
    let of_tag = || get(watch.address(), &format!("/v1/live/frame?sequence={}", state["frame"]["tag"]["sequence"]));
    let its_picture = of_tag().body;
    watch.waits_for("another frame", |now| now["frame"]["tag"]["sequence"] != state["frame"]["tag"]["sequence"]);
    assert!(of_tag().body == its_picture && its_picture.len() as u64 == state["frame"]["bytes"], "{state}");
    assert_eq!(get(watch.address(), "/v1/live/frame?sequence=4000000000").status, 404);
    // What a thin link carries: a small picture, and lines of few points.
    let small = get(watch.address(), "/v1/live/frame?width=100&quality=50");
    assert!(small.status == 200 && small.body.starts_with(&[0xff, 0xd8]), "{}", small.status);
    assert!(4 * small.body.len() < picture.body.len(), "{} of {} bytes", small.body.len(), picture.body.len());
    assert!(get(watch.address(), "/v1/live").body.len() < 12_000, "bytes of the state");
    assert_eq!(watch.order("mark goal kick"), (200, serde_json::json!({ "marked": "goal kick" })));
    assert_eq!(watch.order("place 100,0,0").0, 409, "off the field");
    assert_eq!(watch.order("poses").0, 400);
    walking.join().expect("walked");
    assert_eq!(watch.order("stop").1["state"], "stopped");
    assert!(recorder.ends().status.success());
    watch.waits_for("it is away", |state| state["connected"] == false);
}

/// Pictures of the page for a person: on a desk, on a phone, in the dark.
#[test]
#[ignore = "writes target/live-*.png, by a Chromium"]
fn pictures_of_the_page_of_a_watched_robot() {
    let messages = walk().messages.iter().filter(|message| message.channel.topic != INITIAL);
    let robot = Robot::of(&slower(&messages.cloned().collect::<Vec<_>>(), 8));
    let mut recorder = Recorder::start(Some(robot.tty()));
    let watch = Watch::of(&recorder.room.path(""), &["control.sock"]);
    let camera = recorder.room.path("camera.sock");
    let walking = std::thread::spawn(move || robot.walk(&camera));
    watch.waits_for("some frames", |state| state["frame"]["tag"]["sequence"].as_u64() > Some(8));
    for (name, size, dark) in [("desk", "1280,1100", false), ("phone", "400,1600", false), ("dark", "1280,1100", true)]
    {
        let profile = tempfile::tempdir().expect("a folder");
        let mut browser = Command::new("chromium");
        browser.args(["--headless=new", "--no-sandbox", "--disable-gpu", "--timeout=4000", "--hide-scrollbars"]);
        browser.args(dark.then_some("--force-dark-mode"));
        browser.arg(format!("--user-data-dir={}", profile.path().display())).arg(format!("--window-size={size}"));
        browser.arg(format!("--screenshot={}/target/live-{name}.png", env!("CARGO_MANIFEST_DIR")));
        browser.stderr(std::process::Stdio::null());
        assert!(browser.arg(format!("http://{}/#live", watch.address())).status().expect("Chromium").success());
    }
    walking.join().expect("walked");
    assert!(recorder.ends().status.success());
}

#[test]
fn a_robot_that_goes_away_and_comes_back_is_watched_again() {
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    let watch = Watch::of(&recorder.room.path(""), &["control.sock"]);
    let state = watch.waits_for("it is there", |state| state["connected"] == true);
    assert_eq!(state["status"]["state"], "recording");
    watch.waits_for("it has no camera", |state| state["no_frame"] == "there is no frame yet");
    let mut process = recorder.process.take().expect("running");
    process.kill().expect("alive");
    process.wait().expect("ended");
    let away = watch.waits_for("it is away", |state| state["connected"] == false);
    assert!(away["why"].as_str().is_some_and(|why| why.contains("no recorder answers at control.sock")), "{away}");
    assert_eq!(watch.order("start").0, 409);
    assert_eq!(get(watch.address(), "/").status, 200, "the page stays");
    recorder.process = Some(Recorder::process(&recorder.room, "-2.06,0.153,14.5"));
    watch.waits_for("it is back", |state| state["connected"] == true);
    assert_eq!(get(watch.address(), "/v1/view?x=0&y=0&z=0.5&yaw_deg=0").status, 404, "no database is served");
    assert_eq!(get(watch.address(), "/v1/info").json()["field"], Value::Null);
    assert!(recorder.ends().status.success());
}

#[test]
fn ssh_forwards_the_socket_of_a_robot() {
    let Some(site) = Site::with_ssh() else { return };
    let mut recorder = Recorder::start(None);
    recorder.waits_for("it runs", |status| status["state"] == "recording");
    let robot = format!("127.0.0.1:{}", recorder.room.path("control.sock").display());
    let watch = Watch::of(&site.path(""), &[&robot, "--ssh", site.ssh()]);
    let state = watch.waits_for("it is there", |state| state["connected"] == true);
    assert_eq!((&state["robot"], &state["status"]["state"]), (&"127.0.0.1".into(), &"recording".into()));
    assert_eq!(watch.order("mark over ssh").1["marked"], "over ssh");
    assert!(recorder.ends().status.success());
    watch.waits_for("it is away", |state| state["connected"] == false);
}

#[test]
fn a_robot_that_cannot_be_one_is_a_wrong_call() {
    let room = Room::new();
    room.write("frame.jpg", "no socket");
    for (robot, words) in [("-oProxyCommand=x:", "host"), (".", "it is no socket"), ("frame.jpg", "it is no socket")] {
        room.run(&format!("live --listen 127.0.0.1:0 -- {robot}")).fails(2, &[words]);
    }
    let watch = Watch::of(&room.path(""), &["nobody.invalid:", "--ssh", "false"]);
    let state = watch.waits_for("ssh ends", |state| state["why"].as_str().is_some_and(|why| why.contains("ssh")));
    assert_eq!(state["connected"], false);
}
