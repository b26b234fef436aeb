//! The control socket of a recorder that runs: while a hostile program says what it likes, another is answered.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::case::{Case, Class, Finding, Outcome, Taken};
use crate::draw::Draw;
use crate::support::LENS;
use crate::worker::{MAX_MEMORY_MB, peak_mb_of};
use crate::{bytes, text};

const CONFIG: &str = "robot = \"r1\"\n[camera]\nlens = \"lens.toml\"\n[capture]\ndevice = \"unix:camera.sock\"\n[mount]\n\
    torso_height_m = 0.38\ncamera_xyz_m = [0.04, 0.0, 0.11]\ncamera_rpy_deg = [0.0, 17.0, 0.0]\n[recording]\nfloor_mb = 1\n\
    floor_percent = 0.0\n";
/// What a healthy program waits for its answer.
const PATIENCE: Duration = Duration::from_secs(8);
const HOSTILE_WAITS: Duration = Duration::from_millis(300);

/// Without a camera; ends with the process that runs cases.
pub struct Recorder {
    socket: PathBuf,
    child: Child,
}

impl Recorder {
    pub fn of(folder: &Path) -> Self {
        let _ = fs::remove_dir_all(folder);
        fs::create_dir_all(folder).expect("the folder can be written");
        fs::write(folder.join("lens.toml"), LENS).expect("the folder can be written");
        fs::write(folder.join("robot.toml"), CONFIG).expect("the folder can be written");
        let child = Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["record", "-o", "captures", "--config", "robot.toml", "--socket", "control.sock"])
            .args(["--initial=-2.06,0.153,14.5", "--json"])
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the program starts");
        let recorder = Self { socket: folder.join("control.sock"), child };
        recorder.answers().expect("a recorder that nobody disturbs answers");
        recorder
    }

    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().is_ok_and(|ended| ended.is_some())
    }

    /// Somebody who only wants to know how it is.
    fn answers(&self) -> Result<(), Finding> {
        let (started, mut last) = (Instant::now(), String::new());
        while started.elapsed() < PATIENCE {
            match self.status() {
                Ok(status) if status["state"].is_string() => return Ok(()),
                Ok(status) => last = status.to_string(),
                Err(error) => last = error.to_string(),
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        Err(Finding::new(Class::Starved, format!("no answer within {} s: {last}", PATIENCE.as_secs())))
    }

    fn status(&self) -> std::io::Result<Value> {
        let mut stream = UnixStream::connect(&self.socket)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.write_all(b"status\n")?;
        let mut line = String::new();
        BufReader::new(stream).read_line(&mut line)?;
        Ok(serde_json::from_str(&line)?)
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn run(case: &mut Case) -> Outcome {
    let mut recorder = case.walks.recorder();
    let orders = orders(&mut case.draw);
    let clients = *case.draw.one_of(&[1, 1, 1, 1, 1, 1, 4, 40]);
    // As a program that asks, that is gone at once, that reads nothing.
    let (reads, leaves) = *case.draw.one_of(&[(true, false), (true, false), (false, true), (false, false)]);
    case.tell(format!(
        "{clients} times {:?}, reads: {reads}",
        String::from_utf8_lossy(&orders[..orders.len().min(300)])
    ));
    let mut streams: Vec<UnixStream> =
        (0..clients).filter_map(|_| UnixStream::connect(&recorder.socket).ok()).collect();
    let mut refused = false;
    for stream in &mut streams {
        // What it does not take is not said.
        let _ = stream.set_write_timeout(Some(HOSTILE_WAITS));
        let _ = stream.set_read_timeout(Some(HOSTILE_WAITS));
        let _ = stream.write_all(&orders);
        if leaves {
            let _ = stream.shutdown(std::net::Shutdown::Both);
        }
    }
    if let (true, Some(stream)) = (reads, streams.first_mut()) {
        let mut answer = [0; 65_536];
        let count = stream.read(&mut answer).unwrap_or(0);
        let answer = String::from_utf8_lossy(&answer[..count]).into_owned();
        refused = answer.contains("\"error\"");
    }
    let answered = recorder.answers();
    drop(streams);
    if recorder.has_ended() {
        return Err(Finding::new(Class::Panic, format!("the recorder ended: {:?}", recorder.child.try_wait())));
    }
    let peak_mb = peak_mb_of(&recorder.child.id().to_string());
    if peak_mb > MAX_MEMORY_MB {
        return Err(Finding::new(Class::Memory, format!("the recorder holds {peak_mb} MB")));
    }
    answered?;
    Ok(if refused { Taken::Refused } else { Taken::Accepted })
}

/// Some in a row, most of them damaged.
fn orders(draw: &mut Draw) -> Vec<u8> {
    const SOUND: [&str; 9] = [
        "status",
        "mark kick-off",
        "place -1.9,0.1,14.5",
        "place -1.9,0.1,14.5",
        "poses",
        "start",
        "stop",
        "mark \u{1f916} \"}",
        "place 1e308,-1e308,1e308",
    ];
    let mut all = Vec::new();
    for _ in 0..1 + draw.below(4) {
        let sound = format!("{}\n", draw.one_of(&SOUND));
        all.extend(if draw.chance(0.6) { text::damage(draw, &sound) } else { sound.into_bytes() });
    }
    if draw.chance(0.2) {
        bytes::damage(draw, &mut all);
    }
    if draw.chance(0.1) {
        // An order without end.
        all.retain(|byte| *byte != b'\n');
    }
    all
}
