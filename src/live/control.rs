//! Questions and orders to a running agent, over a Unix socket: a line in, a line of JSON out.
//!
//! `status`, `mark TEXT`, `start`, `stop`; `poses` answers with a line for each tag until the asker hangs up.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Builder;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use parking::Listeners;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde_json::{Value, json};

use super::control_clients::{Askers, Place};
use crate::devices::stale_socket::clear_away;
use crate::geometry::{Physical, Pose2};
use crate::recording::MAX_FINISH;
use crate::ros2::messages::FrameTag;

/// What the agent is to do, and where its answer goes.
pub struct Order {
    pub what: ControlCommand,
    pub answer: Sender<Value>,
}

pub enum ControlCommand {
    Status,
    Mark(String),
    /// `base_footprint` in `map`.
    Place(Pose2),
    Start,
    Stop,
}

/// Orders that wait for the agent.
const MAX_ORDERS: usize = 16;
/// A longer line is no order.
const MAX_ORDER_BYTES: usize = 4096;
/// After the last tag of a recorder that ends.
const LAST_WORD: &str = r#"{"ended":true}"#;
/// A connection on which no order comes to its end within this time is closed.
const MAX_SILENCE: Duration = Duration::from_secs(60);
/// Until the next connection is accepted after one could not be: descriptors may be short for a moment.
const ACCEPT_AGAIN: Duration = Duration::from_millis(100);
/// How often a listener to poses is looked after while there are none.
const LOOK_AFTER: Duration = Duration::from_millis(250);
/// So long the agent may take to answer: longer than a session takes that ends on a disk which takes nothing.
const ANSWER_WITHIN: Duration = MAX_FINISH.saturating_add(Duration::from_secs(5));
/// So long listeners to poses have for the last ones, when the recorder ends.
const LAST_WORDS: Duration = Duration::from_millis(500);
/// Of an order that is too long, what is still taken of it, so that who sends it comes to hear why it was not.
const MAX_SWALLOWED_BYTES: u64 = 1 << 20;
/// Tags that a slow reader of poses may be behind; it misses those beyond.
const MAX_TAGS_BEHIND: usize = 64;

/// Where orders come in. The socket goes away with it.
pub struct Control {
    path: PathBuf,
    pub orders: Receiver<Order>,
    listeners: Arc<Listeners>,
    ended: Arc<AtomicBool>,
}

impl Control {
    pub fn listen(path: &Path) -> io::Result<Self> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder)?;
        }
        if UnixStream::connect(path).is_ok() {
            return Err(io::Error::new(io::ErrorKind::AddrInUse, "another recorder is running"));
        }
        clear_away(path)?;
        let listener = UnixListener::bind(path)?;
        let (send, orders) = bounded(MAX_ORDERS);
        let listeners = Arc::<Listeners>::default();
        let ended = Arc::<AtomicBool>::default();
        let (shared, is_over) = (Arc::clone(&listeners), Arc::clone(&ended));
        let accepting = move || accept(&listener, &send, &shared, &is_over);
        Builder::new().name("control".to_owned()).spawn(accepting)?;
        Ok(Self { path: path.to_owned(), orders, listeners, ended })
    }

    /// To everybody who wants poses.
    pub fn tell(&self, tag: &FrameTag) {
        self.listeners.tell(tag);
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        // Wakes the thread that accepts.
        let _ = UnixStream::connect(&self.path);
        self.listeners.close(LAST_WORDS);
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Every connection gets a thread, until the recorder ends. Whatever goes wrong with one, the next is accepted.
fn accept(listener: &UnixListener, orders: &Sender<Order>, listeners: &Arc<Listeners>, ended: &AtomicBool) {
    let askers = Arc::<Askers>::default();
    while !ended.load(Ordering::Relaxed) {
        let Ok((asker, _)) = listener.accept() else {
            std::thread::sleep(ACCEPT_AGAIN);
            continue;
        };
        match askers.admit(asker) {
            Err((asker, what)) => {
                // What does not fit into its buffer at once is not waited for.
                let _ = asker.set_nonblocking(true);
                let _ = writeln!(&asker, "{}", json!({ "error": what }));
            }
            Ok(place) => {
                let (orders, listeners) = (orders.clone(), Arc::clone(listeners));
                // Without a thread it is closed: its place is dropped.
                let _ = Builder::new().name("asker".to_owned()).spawn(move || {
                    // An error ends this connection: its other end has gone, or has been told.
                    let _ = converse(&place, &orders, &listeners);
                });
            }
        }
    }
}

fn converse(place: &Place, orders: &Sender<Order>, listeners: &Listeners) -> io::Result<()> {
    let mut asker: &UnixStream = &place.stream;
    asker.set_write_timeout(Some(ANSWER_WITHIN))?;
    let mut reader = BufReader::new(Within { stream: asker, deadline: Instant::now() });
    loop {
        let mut line = Vec::new();
        reader.get_mut().deadline = Instant::now() + MAX_SILENCE;
        if reader.by_ref().take(MAX_ORDER_BYTES as u64 + 1).read_until(b'\n', &mut line)? == 0 {
            return Ok(());
        }
        // Its rest is no order of its own.
        if line.len() > MAX_ORDER_BYTES {
            writeln!(asker, "{}", json!({ "error": format!("an order has at most {MAX_ORDER_BYTES} bytes") }))?;
            reader.get_mut().deadline = Instant::now() + LAST_WORDS;
            io::copy(&mut reader.take(MAX_SWALLOWED_BYTES), &mut io::sink())?;
            return Ok(());
        }
        let Ok(line) = str::from_utf8(&line) else {
            return writeln!(asker, "{}", json!({ "error": "an order is UTF-8 text" }));
        };
        let (word, text) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
        let what = match word {
            "status" => ControlCommand::Status,
            "mark" if !text.trim().is_empty() => ControlCommand::Mark(text.to_owned()),
            "place" if let Some(place) = place_of(text) => ControlCommand::Place(place),
            "start" => ControlCommand::Start,
            "stop" => ControlCommand::Stop,
            "poses" => match place.listens() {
                Ok(()) => return stream(asker, listeners),
                Err(what) => return writeln!(asker, "{}", json!({ "error": what })),
            },
            _ => {
                writeln!(
                    asker,
                    "{}",
                    json!({ "error": "expected status, mark TEXT, place X,Y,YAW_DEG, start, stop or poses" })
                )?;
                continue;
            }
        };
        let value = place.waiting(|| {
            let (answer, answered) = bounded(1);
            orders.send_timeout(Order { what, answer }, ANSWER_WITHIN).ok()?;
            answered.recv_timeout(ANSWER_WITHIN).ok()
        });
        writeln!(asker, "{}", value.unwrap_or_else(|| json!({ "error": "the recorder does not answer" })))?;
    }
}

/// Reads until a deadline, however many bytes come meanwhile.
struct Within<'a> {
    stream: &'a UnixStream,
    deadline: Instant,
}

impl Read for Within<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        self.stream.set_read_timeout(Some(left))?;
        self.stream.read(buffer)
    }
}

/// Metres and degrees.
fn place_of(text: &str) -> Option<Pose2> {
    let numbers: Vec<f64> = text.split(',').map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    let [x, y, yaw_deg] = numbers[..] else { return None };
    Some(Pose2::new(x, y, yaw_deg.to_radians())).filter(Physical::is_possible)
}

fn stream(mut asker: &UnixStream, listeners: &Listeners) -> io::Result<()> {
    let Some((tags, _listening)) = listeners.add() else { return Ok(()) };
    loop {
        match tags.recv_timeout(LOOK_AFTER) {
            Ok(tag) => {
                let mut line = serde_json::to_vec(&tag)?;
                line.push(b'\n');
                asker.write_all(&line)?;
            }
            Err(RecvTimeoutError::Timeout) if has_hung_up(asker)? => return Ok(()),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return writeln!(asker, "{LAST_WORD}"),
        }
    }
}

/// One that has said all it will, as `echo poses | socat` does, still listens.
fn has_hung_up(asker: &UnixStream) -> io::Result<bool> {
    let mut ends = [PollFd::new(asker, PollFlags::empty())];
    poll(&mut ends, Some(&Timespec { tv_sec: 0, tv_nsec: 0 }))?;
    Ok(ends[0].revents().intersects(PollFlags::HUP | PollFlags::ERR))
}

/// One question to the recorder behind a socket, and its answer.
pub fn ask(path: &Path, line: &str) -> io::Result<Value> {
    let mut stream = UnixStream::connect(path)?;
    stream.set_read_timeout(Some(2 * ANSWER_WITHIN))?;
    // Who has no room for another asker, or for so long an order, says so before all of it has come.
    let sent = writeln!(stream, "{}", line.replace('\n', " "));
    let mut answer = String::new();
    if BufReader::new(stream).read_line(&mut answer)? == 0 {
        sent?;
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    Ok(serde_json::from_str(&answer)?)
}

/// Every tag from now on, a line of JSON each, until the recorder ends. One that is killed does not say so.
pub fn poses(path: &Path, stop: &AtomicBool, mut take: impl FnMut(&str) -> io::Result<()>) -> io::Result<()> {
    let mut stream = UnixStream::connect(path)?;
    // Who has no room for another asker says so at once.
    let asked = writeln!(stream, "poses");
    for (number, line) in BufReader::new(stream).lines().enumerate() {
        let line = line?;
        if line == LAST_WORD {
            return Ok(());
        }
        if number == 0
            && let Ok(Value::Object(refusal)) = serde_json::from_str(&line)
            && let Some(why) = refusal.get("error").and_then(Value::as_str)
        {
            return Err(io::Error::other(why.to_owned()));
        }
        take(&line)?;
        if stop.load(Ordering::Relaxed) {
            return Ok(());
        }
    }
    asked.map_err(|error| io::Error::new(io::ErrorKind::ConnectionAborted, error))?;
    Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the recorder was killed, or broke off"))
}

mod parking {
    //! Who wants poses.

    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant};

    use super::{FrameTag, MAX_TAGS_BEHIND, Receiver, Sender, bounded};

    pub struct Listeners {
        /// `None` once there will be no more tags.
        all: Mutex<Option<Vec<Sender<FrameTag>>>>,
        listening: Arc<AtomicUsize>,
    }

    impl Default for Listeners {
        fn default() -> Self {
            Self { all: Mutex::new(Some(Vec::new())), listening: Arc::default() }
        }
    }

    /// One that still listens.
    pub struct Listening(Arc<AtomicUsize>);

    impl Drop for Listening {
        fn drop(&mut self) {
            self.0.fetch_sub(1, Ordering::Release);
        }
    }

    impl Listeners {
        pub fn add(&self) -> Option<(Receiver<FrameTag>, Listening)> {
            let (send, receive) = bounded(MAX_TAGS_BEHIND);
            // Counted before it can be told anything.
            self.listening.fetch_add(1, Ordering::Release);
            let listening = Listening(Arc::clone(&self.listening));
            self.all.lock().ok()?.as_mut()?.push(send);
            Some((receive, listening))
        }

        pub fn tell(&self, tag: &FrameTag) {
            let Ok(mut all) = self.all.lock() else { return };
            all.iter_mut().for_each(|all| {
                all.retain(|listener| match listener.try_send(tag.clone()) {
                    Ok(()) => true,
                    Err(error) => error.is_full(),
                });
            });
        }

        /// They get what they were told and go; who reads nothing is not waited for longer than this.
        pub fn close(&self, within: Duration) {
            if let Ok(mut all) = self.all.lock() {
                *all = None;
            }
            let began = Instant::now();
            while self.listening.load(Ordering::Acquire) > 0 && began.elapsed() < within {
                std::thread::sleep(Duration::from_millis(2));
            }
        }
    }
}
