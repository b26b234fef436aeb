//! Control socket of a running recorder: a Unix socket that takes one command a line and answers with one line of JSON.
//!
//! Commands are `status`, `mark TEXT`, `place X,Y,YAW_DEG`, `start` and `stop`. `frame` is answered with a line that states the number
//! of bytes of the latest frame's image, and then these; `frame N` without them if the latest is still frame N. `poses` is answered with a line for each tag until the client hangs up.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Builder;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use listeners::Listeners;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use serde_json::{Value, json};

use super::control_clients::{ClientSlot, Clients};
use crate::devices::stale_socket::clear_away;
use crate::geometry::{Physical, Pose2};
use crate::recording::MAX_FINISH;
use crate::ros2::messages::FrameTag;

/// A command for the event loop, and the channel that takes its answer.
pub struct Order {
    pub what: ControlCommand,
    pub answer: Sender<Answer>,
}

/// The answer to a command: a line of JSON, and bytes behind it, whose number it states as `bytes` if there are any.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Answer {
    pub line: Value,
    pub bytes: Vec<u8>,
}

impl From<Value> for Answer {
    fn from(line: Value) -> Self {
        Self { line, bytes: Vec::new() }
    }
}

/// Commands that clients of the control socket can give.
pub enum ControlCommand {
    Status,
    Mark(String),
    /// The robot stands at this pose of `base_footprint` in `map`.
    Place(Pose2),
    Start,
    Stop,
    /// The latest frame with its tag, unless it is the one of this number.
    Frame(Option<u64>),
}

/// Commands that can wait for the event loop.
const MAX_ORDERS: usize = 16;
/// Longest command line that is accepted, bytes.
const MAX_ORDER_BYTES: usize = 4096;
/// Line that `poses` clients get after the last tag, when the recorder ends.
const END_LINE: &str = r#"{"ended":true}"#;
/// Time within which a client must send a complete command; after that its connection is closed.
const MAX_SILENCE: Duration = Duration::from_secs(60);
/// Wait after a failed `accept`, since file descriptors may be short for a moment.
const ACCEPT_RETRY_DELAY: Duration = Duration::from_millis(100);
/// How often a `poses` connection is checked for a hang-up while there are no tags.
const HANG_UP_CHECK_INTERVAL: Duration = Duration::from_millis(250);
/// Time that the event loop has to answer a command. Longer than it takes to end a session on a disk that accepts nothing.
const ANSWER_TIMEOUT: Duration = MAX_FINISH.saturating_add(Duration::from_secs(5));
/// Time that `poses` clients have to take the last tags when the recorder ends.
const CLOSING_TIME: Duration = Duration::from_millis(500);
/// Bytes of an overlong command that are read and dropped, so that its sender gets to read the refusal.
const MAX_SWALLOWED_BYTES: u64 = 1 << 20;
/// Largest number of bytes behind the line of an answer that is believed: a raw image of a large camera.
const MAX_ANSWER_BYTES: u64 = 64 << 20;
/// Tags that wait for a slow reader of `poses`; the reader misses those beyond.
const MAX_TAGS_BEHIND: usize = 64;

/// The listening control socket. Dropping it ends the accepting thread and removes the socket file.
pub struct Control {
    path: PathBuf,
    pub orders: Receiver<Order>,
    listeners: Arc<Listeners>,
    ended: Arc<AtomicBool>,
}

impl Control {
    /// Binds the socket and starts the thread that accepts connections.
    ///
    /// Fails with `AddrInUse` if another recorder answers on the socket; a stale socket file is removed.
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
        let accepting = move || accept_clients(&listener, &send, &shared, &is_over);
        Builder::new().name("control".to_owned()).spawn(accepting)?;
        Ok(Self { path: path.to_owned(), orders, listeners, ended })
    }

    /// Sends the tag to every `poses` client.
    pub fn tell(&self, tag: &FrameTag) {
        self.listeners.tell(tag);
    }
}

impl Drop for Control {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        // This connection wakes the accepting thread.
        let _ = UnixStream::connect(&self.path);
        self.listeners.close(CLOSING_TIME);
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Accepts connections until the recorder ends and gives each a thread. An error on one connection does not stop the next.
fn accept_clients(listener: &UnixListener, orders: &Sender<Order>, listeners: &Arc<Listeners>, ended: &AtomicBool) {
    let clients = Arc::<Clients>::default();
    while !ended.load(Ordering::Relaxed) {
        let Ok((client, _)) = listener.accept() else {
            std::thread::sleep(ACCEPT_RETRY_DELAY);
            continue;
        };
        match clients.admit(client) {
            Err((client, what)) => {
                // The refusal is dropped if it does not fit into the socket's buffer: nothing waits for this client.
                let _ = client.set_nonblocking(true);
                let _ = writeln!(&client, "{}", json!({ "error": what }));
            }
            Ok(slot) => {
                let (orders, listeners) = (orders.clone(), Arc::clone(listeners));
                // If no thread can be started, the connection is closed, since its slot is dropped.
                let _ = Builder::new().name("asker".to_owned()).spawn(move || {
                    // An error ends this connection only: its client has gone, or has been told.
                    let _ = converse(&slot, &orders, &listeners);
                });
            }
        }
    }
}

/// Reads commands from one client and answers them until the client hangs up.
fn converse(slot: &ClientSlot, orders: &Sender<Order>, listeners: &Listeners) -> io::Result<()> {
    let mut client: &UnixStream = &slot.stream;
    client.set_write_timeout(Some(ANSWER_TIMEOUT))?;
    let mut reader = BufReader::new(DeadlineReader { stream: client, deadline: Instant::now() });
    loop {
        let mut line = Vec::new();
        reader.get_mut().deadline = Instant::now() + MAX_SILENCE;
        if reader.by_ref().take(MAX_ORDER_BYTES as u64 + 1).read_until(b'\n', &mut line)? == 0 {
            return Ok(());
        }
        // The rest of an overlong line must not be taken for another command.
        if line.len() > MAX_ORDER_BYTES {
            writeln!(client, "{}", json!({ "error": format!("an order has at most {MAX_ORDER_BYTES} bytes") }))?;
            reader.get_mut().deadline = Instant::now() + CLOSING_TIME;
            io::copy(&mut reader.take(MAX_SWALLOWED_BYTES), &mut io::sink())?;
            return Ok(());
        }
        let Ok(line) = str::from_utf8(&line) else {
            return writeln!(client, "{}", json!({ "error": "an order is UTF-8 text" }));
        };
        let (word, text) = line.trim().split_once(' ').unwrap_or((line.trim(), ""));
        let what = match word {
            "status" => ControlCommand::Status,
            "mark" if !text.trim().is_empty() => ControlCommand::Mark(text.to_owned()),
            "place" if let Some(place) = parse_place(text) => ControlCommand::Place(place),
            "place" => {
                let what = "a place is X,Y,YAW_DEG in metres and degrees, as in place 1,-2,90";
                writeln!(client, "{}", json!({ "error": what }))?;
                continue;
            }
            "start" => ControlCommand::Start,
            "stop" => ControlCommand::Stop,
            "frame" => ControlCommand::Frame(text.trim().parse().ok()),
            "poses" => match slot.start_listening() {
                Ok(()) => return stream_tags(client, listeners),
                Err(what) => return writeln!(client, "{}", json!({ "error": what })),
            },
            _ => {
                writeln!(
                    client,
                    "{}",
                    json!({ "error": "expected status, mark TEXT, place X,Y,YAW_DEG, start, stop, frame or poses" })
                )?;
                continue;
            }
        };
        let value = slot.while_waiting(|| {
            let (answer, answered) = bounded(1);
            orders.send_timeout(Order { what, answer }, ANSWER_TIMEOUT).ok()?;
            answered.recv_timeout(ANSWER_TIMEOUT).ok()
        });
        let answer = value.unwrap_or_else(|| json!({ "error": "the recorder does not answer" }).into());
        writeln!(client, "{}", answer.line)?;
        client.write_all(&answer.bytes)?;
    }
}

/// Reader that fails with `TimedOut` at a deadline, however many bytes arrive until then.
struct DeadlineReader<'a> {
    stream: &'a UnixStream,
    deadline: Instant,
}

impl Read for DeadlineReader<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        self.stream.set_read_timeout(Some(left))?;
        self.stream.read(buffer)
    }
}

/// Parses `X,Y,YAW_DEG` (metres and degrees); `None` if it is not a possible pose.
fn parse_place(text: &str) -> Option<Pose2> {
    let numbers: Vec<f64> = text.split(',').map(|part| part.trim().parse().ok()).collect::<Option<_>>()?;
    let [x, y, yaw_deg] = numbers[..] else { return None };
    Some(Pose2::new(x, y, yaw_deg.to_radians())).filter(Physical::is_possible)
}

/// Writes a line of JSON for each tag until the client hangs up or the recorder ends.
fn stream_tags(mut client: &UnixStream, listeners: &Listeners) -> io::Result<()> {
    let Some((tags, _listening)) = listeners.add() else { return Ok(()) };
    loop {
        match tags.recv_timeout(HANG_UP_CHECK_INTERVAL) {
            Ok(tag) => {
                let mut line = serde_json::to_vec(&tag)?;
                line.push(b'\n');
                client.write_all(&line)?;
            }
            Err(RecvTimeoutError::Timeout) if has_hung_up(client)? => return Ok(()),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return writeln!(client, "{END_LINE}"),
        }
    }
}

/// Whether the client has closed its connection. One that only ended its sending side, as `echo poses | socat` does, still
/// listens.
fn has_hung_up(client: &UnixStream) -> io::Result<bool> {
    let mut ends = [PollFd::new(client, PollFlags::empty())];
    poll(&mut ends, Some(&Timespec { tv_sec: 0, tv_nsec: 0 }))?;
    Ok(ends[0].revents().intersects(PollFlags::HUP | PollFlags::ERR))
}

/// Sends one command to the recorder behind the socket and returns its answer's line.
pub fn ask(path: &Path, line: &str) -> io::Result<Value> {
    ControlClient::connect(path)?.ask(line).map(|answer| answer.line)
}

/// A connection to a recorder that can be asked again and again.
pub struct ControlClient {
    reader: BufReader<UnixStream>,
}

impl ControlClient {
    /// Connects to the recorder behind the socket.
    pub fn connect(path: &Path) -> io::Result<Self> {
        let stream = UnixStream::connect(path)?;
        stream.set_read_timeout(Some(2 * ANSWER_TIMEOUT))?;
        Ok(Self { reader: BufReader::new(stream) })
    }

    /// Sends one command and returns its whole answer.
    pub fn ask(&mut self, line: &str) -> io::Result<Answer> {
        // A recorder that refuses another client, or an overlong line, answers before it has read everything.
        let sent = writeln!(self.reader.get_mut(), "{}", line.replace('\n', " "));
        let mut answer = String::new();
        if self.reader.read_line(&mut answer)? == 0 {
            sent?;
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        let line: Value = serde_json::from_str(&answer)?;
        let count = line["bytes"].as_u64().unwrap_or(0);
        if count > MAX_ANSWER_BYTES {
            return Err(io::Error::new(io::ErrorKind::InvalidData, format!("an answer of {count} bytes")));
        }
        let mut bytes = vec![0; count as usize];
        self.reader.read_exact(&mut bytes)?;
        Ok(Answer { line, bytes })
    }
}

/// Calls `take` with every tag from here on, a line of JSON each, until the recorder ends or `stop` is set.
///
/// A recorder that is killed closes the connection without a last line, which is the error `UnexpectedEof`.
pub fn poses(path: &Path, stop: &AtomicBool, mut take: impl FnMut(&str) -> io::Result<()>) -> io::Result<()> {
    let mut stream = UnixStream::connect(path)?;
    // A recorder that refuses another client answers at once, possibly before the command is written.
    let asked = writeln!(stream, "poses");
    for (number, line) in BufReader::new(stream).lines().enumerate() {
        let line = line?;
        if line == END_LINE {
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

mod listeners {
    //! The clients that listen to poses.

    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Arc, Mutex};
    use std::time::{Duration, Instant};

    use super::{FrameTag, MAX_TAGS_BEHIND, Receiver, Sender, bounded};

    /// Fans tags out to the clients of `poses`.
    pub struct Listeners {
        /// `None` once no more tags will come.
        all: Mutex<Option<Vec<Sender<FrameTag>>>>,
        listening: Arc<AtomicUsize>,
    }

    impl Default for Listeners {
        fn default() -> Self {
            Self { all: Mutex::new(Some(Vec::new())), listening: Arc::default() }
        }
    }

    /// Counts its client as listening until it is dropped.
    pub struct ListenerGuard(Arc<AtomicUsize>);

    impl Drop for ListenerGuard {
        fn drop(&mut self) {
            self.0.fetch_sub(1, Ordering::Release);
        }
    }

    impl Listeners {
        /// Registers a client; `None` if no more tags will come.
        pub fn add(&self) -> Option<(Receiver<FrameTag>, ListenerGuard)> {
            let (send, receive) = bounded(MAX_TAGS_BEHIND);
            // Counted before its sender is registered, so that `close` waits for it.
            self.listening.fetch_add(1, Ordering::Release);
            let listening = ListenerGuard(Arc::clone(&self.listening));
            self.all.lock().ok()?.as_mut()?.push(send);
            Some((receive, listening))
        }

        /// Queues the tag for every client. A client whose queue is full misses it; one that has gone is removed.
        pub fn tell(&self, tag: &FrameTag) {
            let Ok(mut all) = self.all.lock() else { return };
            all.iter_mut().for_each(|all| {
                all.retain(|listener| match listener.try_send(tag.clone()) {
                    Ok(()) => true,
                    Err(error) => error.is_full(),
                });
            });
        }

        /// Ends all streams and waits, at most for `within`, until the clients have read what is queued for them.
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
