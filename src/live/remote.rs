//! A recorder that is watched from elsewhere: its control socket, forwarded by ssh, asked again and again.
//!
//! Nothing runs on the robot for that but its recorder, which answers from its control socket alone. A robot that goes away and comes
//! back is asked again. What is not asked costs nothing: frames are fetched while somebody looks, one after the other, so that a thin
//! link carries fewer.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::Status;
use super::control::{Answer, ControlClient, ask};
use super::watched_frame::WatchedFrame;
use crate::service::LiveRobot;

/// Where a recorder's control socket is.
#[derive(Clone, Debug)]
pub struct RemoteSocket {
    /// `user@host` as for ssh; `None` for this machine.
    pub host: Option<String>,
    /// Path of the control socket there.
    pub socket: PathBuf,
    /// The command that opens a shell on the robot, with its arguments.
    pub ssh: Vec<String>,
}

/// A watched recorder. Dropping it ends the watching.
#[derive(Debug)]
pub struct RemoteRecorder {
    shared: Arc<Shared>,
    watcher: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    at: RemoteSocket,
    describe: fn(&Status) -> Vec<String>,
    seen: Mutex<Seen>,
    stop: AtomicBool,
}

/// What is known of a watched recorder, for viewers.
#[derive(Clone, Debug)]
pub struct WatchedRecorder {
    /// Its host.
    pub robot: String,
    pub connected: bool,
    /// Why it is away, or why it has no frame; empty if all is well.
    pub why: String,
    /// Its status in words.
    pub words: Vec<String>,
    /// The latest frame.
    pub frame: Option<Arc<WatchedFrame>>,
}

/// What was last seen of the recorder.
#[derive(Debug, Default)]
struct Seen {
    /// The socket to ask; `None` while the robot is away.
    socket: Option<PathBuf>,
    /// Why the robot is away.
    why: String,
    status: Value,
    words: Vec<String>,
    /// The latest frames, the newest last.
    recent: VecDeque<Arc<WatchedFrame>>,
    /// What the recorder says of the newest one.
    frame: Value,
    /// Number of the latest frame that came, understood or not.
    known: Option<u64>,
    /// Why there is no frame.
    no_frame: Option<String>,
    /// When somebody last looked.
    looked: Option<Instant>,
}

/// Time between two questions about the status.
const STATUS_EVERY: Duration = Duration::from_secs(1);
/// Smallest time between two frames: five a second are enough to watch.
const FRAME_EVERY: Duration = Duration::from_millis(200);
/// Frames that are held: three seconds of them, in which a page on a thin link has read the tag and asks for its picture.
const MAX_RECENT: usize = 16;
/// Bytes of their pictures; one is held in any case.
const MAX_RECENT_BYTES: usize = 32 << 20;
/// Time after the last look within which frames are fetched.
const LOOKED_WITHIN: Duration = Duration::from_secs(3);
/// Time between two attempts to reach the robot.
const RETRY_EVERY: Duration = Duration::from_secs(2);
/// Longest time for ssh to forward the socket.
const MAX_CONNECT: Duration = Duration::from_secs(20);
/// Time between two looks at the stop flag.
const TICK: Duration = Duration::from_millis(50);
/// Bytes of ssh's complaint that are kept.
const MAX_COMPLAINT_BYTES: u64 = 4096;

impl Seen {
    fn latest(&self) -> Option<&Arc<WatchedFrame>> {
        self.recent.back()
    }

    /// Holds a frame, and lets the oldest go.
    fn hold(&mut self, frame: WatchedFrame) {
        self.recent.push_back(Arc::new(frame));
        let bytes =
            |recent: &VecDeque<Arc<WatchedFrame>>| recent.iter().map(|frame| frame.picture.len()).sum::<usize>();
        while self.recent.len() > MAX_RECENT || (self.recent.len() > 1 && bytes(&self.recent) > MAX_RECENT_BYTES) {
            self.recent.pop_front();
        }
    }

    /// The frame of a tag. Where a recorder began to count anew, the newest.
    fn of_sequence(&self, number: u64) -> Option<Arc<WatchedFrame>> {
        self.recent.iter().rev().find(|frame| frame.tag.sequence == number).cloned()
    }
}

impl RemoteRecorder {
    /// Begins to watch. `describe` puts a status into words.
    pub fn watch(at: RemoteSocket, describe: fn(&Status) -> Vec<String>) -> std::io::Result<Self> {
        let why = "the robot has not been reached yet".to_owned();
        let seen = Mutex::new(Seen { why, ..Seen::default() });
        let shared = Arc::new(Shared { at, describe, seen, stop: AtomicBool::new(false) });
        let own = Arc::clone(&shared);
        let watcher = std::thread::Builder::new().name("watcher".to_owned()).spawn(move || own.watch())?;
        Ok(Self { shared, watcher: Some(watcher) })
    }

    /// Returns what is known of the recorder. Frames are fetched while somebody looks.
    pub fn watched(&self, somebody_looks: bool) -> WatchedRecorder {
        let mut seen = self.shared.seen();
        if somebody_looks {
            seen.looked = Some(Instant::now());
        }
        let connected = seen.socket.is_some();
        let why = if connected { seen.no_frame.clone().unwrap_or_default() } else { seen.why.clone() };
        let (robot, words) = (self.shared.host().to_owned(), seen.words.clone());
        WatchedRecorder { robot, connected, why, words, frame: seen.latest().cloned() }
    }
}

impl Drop for RemoteRecorder {
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(watcher) = self.watcher.take() {
            let _ = watcher.join();
        }
    }
}

impl LiveRobot for RemoteRecorder {
    fn state(&self) -> Value {
        let mut seen = self.shared.seen();
        seen.looked = Some(Instant::now());
        json!({
            "robot": self.shared.host(),
            "connected": seen.socket.is_some(),
            "why": seen.why,
            "status": seen.status,
            "words": seen.words,
            "frame": seen.frame,
            "no_frame": seen.no_frame,
            "age_s": seen.latest().map(|frame| frame.came.elapsed().as_secs_f64()),
        })
    }

    fn picture(&self, sequence: Option<u32>) -> Option<Vec<u8>> {
        let frame = match sequence {
            None => self.shared.seen().latest().cloned(),
            Some(number) => self.shared.seen().of_sequence(number.into()),
        }?;
        (!frame.picture.is_empty()).then(|| frame.picture.to_vec())
    }

    fn order(&self, order: &str) -> Result<Value, String> {
        let socket = self.shared.seen().socket.clone();
        let socket = socket.ok_or_else(|| "the robot is away".to_owned())?;
        let answer = ask(&socket, order).map_err(|error| format!("the recorder does not answer: {error}"))?;
        match answer["error"].as_str() {
            Some(error) => Err(error.to_owned()),
            None => Ok(answer),
        }
    }
}

impl Shared {
    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn host(&self) -> &str {
        self.at.host.as_deref().unwrap_or("this machine")
    }

    fn has_ended(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Watches until it is told to stop, however often the robot goes away.
    fn watch(&self) {
        while !self.has_ended() {
            let why = match self.connect() {
                Ok(connection) => self.follow(&connection),
                Err(why) => why,
            };
            let mut seen = self.seen();
            (seen.socket, seen.why) = (None, why);
            drop(seen);
            self.pause(RETRY_EVERY);
        }
    }

    fn pause(&self, time: Duration) {
        let began = Instant::now();
        while began.elapsed() < time && !self.has_ended() {
            std::thread::sleep(TICK);
        }
    }

    /// Forwards the socket here, unless it is here.
    fn connect(&self) -> Result<Connection, String> {
        let Some(host) = &self.at.host else {
            return Ok(Connection { socket: self.at.socket.clone(), ssh: None, _folder: None });
        };
        let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
        let socket = folder.path().join("control.sock");
        let [program, arguments @ ..] = &self.at.ssh[..] else { return Err("--ssh names no program".to_owned()) };
        let forward = format!("{}:{}", socket.display(), self.at.socket.display());
        let ssh = Command::new(program)
            .args(arguments)
            .args(["-N", "-T", "-o", "ExitOnForwardFailure=yes", "-L", &forward, host])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| format!("{program} cannot be started: {error}"))?;
        let mut connection = Connection { socket, ssh: Some(ssh), _folder: Some(folder) };
        let began = Instant::now();
        while !connection.socket.exists() {
            if let Some(why) = connection.has_gone() {
                return Err(why);
            }
            if began.elapsed() > MAX_CONNECT || self.has_ended() {
                return Err(format!("{host} does not answer"));
            }
            std::thread::sleep(TICK);
        }
        Ok(connection)
    }

    /// Asks until the recorder does not answer any more. Returns why.
    fn follow(&self, connection: &Connection) -> String {
        let socket = &connection.socket;
        let mut client = match ControlClient::connect(socket) {
            Ok(client) => client,
            Err(error) => return self.explain(&error),
        };
        let mut status_at: Option<Instant> = None;
        while !self.has_ended() {
            if status_at.is_none_or(|at| at.elapsed() >= STATUS_EVERY) {
                status_at = Some(Instant::now());
                match client.ask("status") {
                    Ok(status) => self.take_status(socket, status.line),
                    Err(error) => return self.explain(&error),
                }
            }
            let is_watched = self.seen().looked.is_some_and(|looked| looked.elapsed() < LOOKED_WITHIN);
            if is_watched {
                match client.ask(&self.frame_order()) {
                    Ok(answer) => self.take_frame(answer),
                    Err(error) => return self.explain(&error),
                }
            }
            self.pause(FRAME_EVERY);
        }
        String::new()
    }

    /// The question for a frame that is not the one that is known already.
    fn frame_order(&self) -> String {
        match self.seen().known {
            Some(sequence) => format!("frame {sequence}"),
            None => "frame".to_owned(),
        }
    }

    fn explain(&self, error: &std::io::Error) -> String {
        let socket = self.at.socket.display();
        match error.kind() {
            ErrorKind::NotFound
            | ErrorKind::ConnectionRefused
            | ErrorKind::UnexpectedEof
            | ErrorKind::ConnectionReset
            | ErrorKind::BrokenPipe => {
                format!("no recorder answers at {socket} (systemctl status realitysim); it is tried again")
            }
            ErrorKind::PermissionDenied => {
                format!("{socket}: no permission: your user must be in the group realitysim")
            }
            _ => format!("{socket}: {error}; it is tried again"),
        }
    }

    fn take_status(&self, socket: &Path, status: Value) {
        let words = match serde_json::from_value::<Status>(status.clone()) {
            Ok(known) => (self.describe)(&known),
            Err(_) => vec!["the recorder is of another version: not all that it says is understood".to_owned()],
        };
        let mut seen = self.seen();
        (seen.socket, seen.why, seen.status, seen.words) = (Some(socket.to_owned()), String::new(), status, words);
    }

    fn take_frame(&self, answer: Answer) {
        let Answer { mut line, bytes } = answer;
        if line["unchanged"] == true {
            return;
        }
        if let Some(error) = line["error"].as_str() {
            self.seen().no_frame = Some(match error.contains("expected status") {
                true => "the recorder on the robot is older and sends no pictures: update it".to_owned(),
                false => error.to_owned(),
            });
            return;
        }
        let latest = WatchedFrame::read(&line, bytes);
        let mut seen = self.seen();
        seen.known = line["tag"]["sequence"].as_u64();
        let Some(latest) = latest else {
            let strange = "the recorder on the robot is of another version: its frames are not understood";
            seen.no_frame = Some(strange.to_owned());
            return;
        };
        line["lines"] = latest.lines();
        (seen.frame, seen.no_frame) = (line, None);
        seen.hold(latest);
    }
}

/// A socket that can be asked, as long as this is held.
struct Connection {
    socket: PathBuf,
    /// The ssh that forwards it.
    ssh: Option<Child>,
    /// Where the forwarded socket lies.
    _folder: Option<tempfile::TempDir>,
}

impl Connection {
    /// Why ssh has ended, if it has.
    fn has_gone(&mut self) -> Option<String> {
        let ssh = self.ssh.as_mut()?;
        ssh.try_wait().ok().flatten()?;
        let mut said = String::new();
        let stderr = ssh.stderr.take()?;
        let _ = stderr.take(MAX_COMPLAINT_BYTES).read_to_string(&mut said);
        Some(said.lines().rev().find(|line| !line.trim().is_empty()).unwrap_or("ssh ended").to_owned())
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        if let Some(ssh) = &mut self.ssh {
            let _ = ssh.kill();
            let _ = ssh.wait();
        }
    }
}
