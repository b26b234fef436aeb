//! The program as a recorder, asked over its control socket.

use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use crate::replay::support::{CAPTURES, Room};

pub const CONFIG: &str = r#"
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

/// How long is waited for what must come: as long as a machine takes that has much else to do.
pub const PATIENCE: Duration = Duration::from_secs(90);

pub struct Recorder {
    pub room: Room,
    pub process: Option<std::process::Child>,
}

impl Recorder {
    pub fn start(tty: Option<&str>) -> Self {
        Self::start_at(tty, CONFIG, "-2.06,0.153,14.5")
    }

    pub fn start_at(tty: Option<&str>, config: &str, initial: &str) -> Self {
        let room = Room::new();
        room.write_scene("scene.toml", |text| text);
        let ports = tty.map_or(String::new(), |tty| {
            format!("[serial]\nports = [{{ device = \"{tty}\", baud = 921600, poses = true }}]\n")
        });
        room.write("robot.toml", format!("{config}{ports}"));
        let process = Some(Self::process(&room, initial));
        Self { room, process }
    }

    pub fn process(room: &Room, initial: &str) -> std::process::Child {
        Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["record", "-o", CAPTURES, "--config", "robot.toml", "--socket", "control.sock"])
            .args(["--initial", initial, "--json"])
            .current_dir(room.path(""))
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("started")
    }

    pub fn asks(&self, order: &str) -> serde_json::Value {
        self.room.run(&format!("recorder {order} --socket control.sock --json")).succeeds().json()
    }

    pub fn waits_for(&self, what: &str, is: impl Fn(&serde_json::Value) -> bool) {
        let began = Instant::now();
        loop {
            let run = self.room.run("recorder status --socket control.sock --json");
            if run.code == Some(0) && is(&run.json()) {
                return;
            }
            assert!(began.elapsed() < PATIENCE, "{what}: {run:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// As soon as there is somebody to listen to: until the recorder ends.
    pub fn listens_to_poses(&self) -> std::process::Child {
        self.waits_for("it answers", |_| true);
        Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["recorder", "poses", "--socket", "control.sock"])
            .current_dir(self.room.path(""))
            .stdout(Stdio::piped())
            .spawn()
            .expect("started")
    }

    /// As systemd does it.
    pub fn ends(&mut self) -> Output {
        let process = self.process.take().expect("running");
        let id = rustix::process::Pid::from_raw(process.id() as i32).expect("a process");
        rustix::process::kill_process(id, rustix::process::Signal::TERM).expect("alive");
        let asked = Instant::now();
        let output = process.wait_with_output().expect("ended");
        assert!(asked.elapsed() < PATIENCE, "{:?}", asked.elapsed());
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
