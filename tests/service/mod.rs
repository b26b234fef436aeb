//! `realitysim serve`, asked by real clients over real sockets: what is right, what is wrong, and those who mean no good.

pub mod client;
mod figures;
mod hostile;
mod openapi;
mod page;
mod python;
mod requests;
mod thin_link;
mod view_rate;

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::replay::support::{Room, session_name};

pub const POSES: &str = "file,x,y,z,yaw_deg,pitch_deg,roll_deg\n";
pub const CAMERA_INFO: &str = include_str!("camera_info.yaml");

/// A database `db` of four images around (0.2, 0.2), and the service on it; ends with the test.
pub struct Served {
    pub room: Room,
    pub address: SocketAddr,
    child: Child,
}

/// Images of another colour each, with something to see.
pub fn add_images(room: &Room, folder: &str, poses: &[(f64, f64, f64)]) {
    std::fs::create_dir(room.path(folder)).expect("a folder");
    room.write(&format!("{folder}/camera_info.yaml"), CAMERA_INFO);
    let mut table = POSES.to_owned();
    for (number, (x, y, yaw_deg)) in poses.iter().enumerate() {
        let picture = image::RgbImage::from_fn(320, 240, |u, v| {
            let stripe = if (u / 16 + v / 16) % 2 == 0 { 200 } else { 60 };
            image::Rgb([stripe, (u / 2) as u8 + 40, 40 + 20 * number as u8])
        });
        picture.save(room.path(&format!("{folder}/{number}.png"))).expect("saved");
        table.push_str(&format!("{number}.png,{x},{y},0.5,{yaw_deg},20,0\n"));
    }
    room.write(&format!("{folder}/poses.csv"), table);
    room.run(&format!("db add {folder} --db db --field kid-2009")).succeeds();
}

pub const PLACES: [(f64, f64, f64); 4] = [(0.1, 0.2, 10.0), (0.3, 0.2, 10.0), (0.2, 0.1, 12.0), (0.2, 0.3, 8.0)];

/// The service on the same database, which shows the walk's capture, and the name of the capture.
pub fn with_captures() -> (Served, String) {
    let room = Room::with_walk();
    let session = session_name(&room.replay("log.mcap"));
    add_images(&room, "images", &PLACES);
    let name = session.rsplit('/').next().expect("a name").to_owned();
    (Served::of(room, "--captures captures"), name)
}

impl Served {
    pub fn new(arguments: &str) -> Self {
        let room = Room::new();
        add_images(&room, "images", &PLACES);
        Self::of(room, arguments)
    }

    pub fn of(room: Room, arguments: &str) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_realitysim"));
        command.args(["serve", "--db", "db", "--json"]).args(arguments.split_whitespace());
        if !arguments.contains("--listen") {
            command.args(["--listen", "127.0.0.1:0"]);
        }
        let command = command.current_dir(room.path("")).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("the program");
        let mut line = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut line).expect("a line");
        let ready: Value = serde_json::from_str(&line).expect("where it listens");
        let address = ready["listening"].as_str().and_then(|text| text.parse().ok()).expect("an address");
        Self { room, address, child }
    }

    /// The most memory that it has had, kB.
    pub fn peak_kb(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("running");
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("its peak");
        peak.trim().trim_end_matches(" kB").parse().expect("kilobytes")
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("a child").is_none()
    }

    /// With SIGTERM; its exit code.
    pub fn ended(&mut self) -> Option<i32> {
        let pid = rustix::process::Pid::from_raw(self.child.id() as i32).expect("a process");
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).expect("sent");
        let started = Instant::now();
        while started.elapsed() < Duration::from_secs(60) {
            if let Some(status) = self.child.try_wait().expect("a child") {
                return status.code();
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        None
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
