//! A short simulated walk, ways to change its log, and the program to replay it with.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, OnceLock};

use mcap::WriteOptions;
use realitysim::ros2::messages::{FrameTag, Stamp};
use realitysim::ros2::{Channel, LogMessage, LogReader, LogWriter, Message, Selection};
use serde_json::Value;
use tempfile::TempDir;

pub const IMAGE: &str = "/camera/image/compressed";
pub const CAMERA_INFO: &str = "/camera/camera_info";
pub const TRUTH: &str = "/ground_truth/camera_pose";
pub const IMU: &str = "/imu/data";
pub const INITIAL: &str = "/initialpose";
pub const ODOMETRY: &str = "/odom";
pub const TF: &str = "/tf";
pub const TF_STATIC: &str = "/tf_static";
pub const TAG: &str = "/frame_tag";
pub const POSE: &str = "/camera/pose";
/// Where its sessions go, in a test's folder.
pub const CAPTURES: &str = "captures";

/// The shipped `fisheye-640`, half as large: a quarter of the pixels to render and to read.
pub const LENS: &str = include_str!("lens.toml");

const SCENE: &str = include_str!("scene.toml");

/// The walk's log, and what its replay gives.
pub struct Walk {
    pub log: Vec<u8>,
    pub messages: Vec<LogMessage>,
    pub tags: Vec<FrameTag>,
}

impl Walk {
    pub fn frames(&self) -> usize {
        self.tags.len()
    }
}

/// Simulated and replayed once for all tests.
pub fn walk() -> &'static Walk {
    static WALK: OnceLock<Walk> = OnceLock::new();
    WALK.get_or_init(|| {
        let room = Room::new();
        room.write_scene("scene.toml", |text| text);
        room.run("scene render scene.toml -o log.mcap").succeeds();
        let log = fs::read(room.path("log.mcap")).unwrap();
        let messages = read_log(&room.path("log.mcap"));
        let tags = room.replay("log.mcap").tags;
        Walk { log, messages, tags }
    })
}

/// A test's own folder: the program runs in it, so that all paths are short.
pub struct Room {
    folder: TempDir,
}

impl Room {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// With the walk's log as `log.mcap`.
    pub fn with_walk() -> Self {
        let room = Self::new();
        room.write("log.mcap", &walk().log);
        room
    }

    /// With these messages as `log.mcap`.
    pub fn with_log(messages: &[LogMessage]) -> Self {
        let room = Self::new();
        room.write("log.mcap", own_log(messages));
        room
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).unwrap();
    }

    /// The walk's scene, changed, and its lens.
    pub fn write_scene(&self, name: &str, change: impl Fn(String) -> String) {
        self.write("lens.toml", LENS);
        self.write(name, change(SCENE.to_owned()));
    }

    /// Arguments are split at spaces.
    pub fn run(&self, arguments: &str) -> Run {
        self.run_with(arguments, &[])
    }

    /// The same with these variables in the environment.
    pub fn run_with(&self, arguments: &str, variables: &[(&str, &str)]) -> Run {
        self.run_words(&arguments.split_whitespace().collect::<Vec<_>>(), variables)
    }

    /// The same with arguments that may have spaces in them.
    pub fn run_words(&self, arguments: &[&str], variables: &[(&str, &str)]) -> Run {
        let program = env!("CARGO_BIN_EXE_realitysim");
        let mut command = Command::new(program);
        command.envs(variables.iter().copied());
        let output = command.args(arguments).current_dir(&self.folder).output().unwrap();
        Run {
            arguments: arguments.join(" "),
            code: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// Into the folder `captures`; the replay may lose data, or place not one frame, but must come to its end.
    pub fn replay(&self, arguments: &str) -> Replayed {
        let run = self.run(&format!("replay {arguments} -o {CAPTURES} --json"));
        assert!(matches!(run.code, Some(0 | 1 | 3)), "{run:?}");
        let report = run.json();
        let is_in_vain = report["valid"] == 0 && report["tagged"] != 0;
        assert_eq!(run.code == Some(1), is_in_vain, "{run:?}");
        let session = self.path(report["session"].as_str().unwrap());
        let tags = decode_all(&read_capture(&session), TAG);
        Replayed { run, report, session, tags }
    }
}

/// What a finished process left.
#[derive(Debug)]
pub struct Run {
    pub arguments: String,
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Run {
    pub fn succeeds(self) -> Self {
        self.ends_with(0);
        self
    }

    fn ends_with(&self, code: i32) {
        assert_eq!(self.code, Some(code), "realitysim {}: {self:?}", self.arguments);
    }

    /// Ends with this exit code, and one line on standard error has all of these words.
    pub fn fails(self, code: i32, words: &[&str]) -> Self {
        self.ends_with(code);
        for word in words {
            assert!(self.stderr.contains(word), "{word:?} is missing: {self:?}");
        }
        assert!(!self.stderr.contains("panicked"), "{self:?}");
        self
    }

    /// The only line of standard output.
    pub fn json(&self) -> Value {
        assert_eq!(self.stdout.lines().count(), 1, "{self:?}");
        serde_json::from_str(&self.stdout).unwrap()
    }
}

pub struct Replayed {
    pub run: Run,
    pub report: Value,
    pub session: PathBuf,
    pub tags: Vec<FrameTag>,
}

impl Replayed {
    pub fn count(&self, key: &str) -> usize {
        self.report[key].as_u64().unwrap_or_else(|| panic!("{key}: {}", self.report)) as usize
    }
}

/// The session's folder as an argument of the next command.
pub fn session_name(replayed: &Replayed) -> String {
    format!("{CAPTURES}/{}", replayed.session.file_name().unwrap().to_str().unwrap())
}

/// Every message of one file, in the reader's order.
pub fn read_log(path: &Path) -> Vec<LogMessage> {
    read_bytes(&fs::read(path).unwrap())
}

pub fn read_bytes(log: &[u8]) -> Vec<LogMessage> {
    LogReader::open(Cursor::new(log), Selection::All).unwrap().map(Result::unwrap).collect()
}

/// The segments of a session, in order.
pub fn segments(session: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(session).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = files.filter(|path| path.extension().is_some_and(|e| e == "mcap")).collect();
    files.sort();
    files
}

pub fn read_capture(session: &Path) -> Vec<LogMessage> {
    segments(session).iter().flat_map(|path| read_log(path)).collect()
}

pub fn on<'a>(messages: &'a [LogMessage], topic: &'a str) -> impl Iterator<Item = &'a LogMessage> {
    messages.iter().filter(move |message| message.channel.topic == topic)
}

pub fn decode_all<M: Message>(messages: &[LogMessage], topic: &str) -> Vec<M> {
    on(messages, topic).map(|message| M::decode(&message.data).unwrap()).collect()
}

pub fn without(messages: &[LogMessage], topic: &str) -> Vec<LogMessage> {
    messages.iter().filter(|message| message.channel.topic != topic).cloned().collect()
}

/// Changes every message of a topic.
pub fn changed<M: Message>(messages: &[LogMessage], topic: &str, mut change: impl FnMut(&mut M)) -> Vec<LogMessage> {
    let mut messages = messages.to_vec();
    for message in messages.iter_mut().filter(|message| message.channel.topic == topic) {
        let mut content = M::decode(&message.data).unwrap();
        change(&mut content);
        message.data = content.encode();
    }
    messages
}

/// Moves the stamp of a message that has one.
pub fn stamp_later(message: &mut LogMessage, later_ns: i64) {
    // Every type that moves begins with a header, and a header with its stamp.
    if ![TF_STATIC, CAMERA_INFO].contains(&message.channel.topic.as_str()) {
        let sec = i32::from_le_bytes(message.data[4..8].try_into().unwrap());
        let nanosec = u32::from_le_bytes(message.data[8..12].try_into().unwrap());
        let stamp = Stamp::from_nanoseconds(Stamp { sec, nanosec }.to_nanoseconds() + later_ns);
        message.data[4..8].copy_from_slice(&stamp.sec.to_le_bytes());
        message.data[8..12].copy_from_slice(&stamp.nanosec.to_le_bytes());
    }
}

/// A message of a topic that the log does not have yet; `id` must be the topic's own.
pub fn message<M: Message>(id: u16, topic: &str, log_time_ns: i64, content: &M) -> LogMessage {
    let channel = Channel::of::<M>(id, topic, Default::default());
    let data = content.encode();
    LogMessage { channel: Arc::new(channel), sequence: 0, log_time_ns, publish_time_ns: log_time_ns, data }
}

/// As the crate writes logs.
pub fn own_log(messages: &[LogMessage]) -> Vec<u8> {
    let mut writer = LogWriter::new(Vec::new()).unwrap();
    for message in messages {
        let id = writer.add_raw_channel(&message.channel.as_ref().into()).unwrap();
        writer.write(id, message.sequence, message.log_time_ns, message.publish_time_ns, &message.data).unwrap();
    }
    writer.finish().unwrap()
}

/// As other programs write logs.
pub fn foreign_log(options: WriteOptions, messages: &[LogMessage]) -> Vec<u8> {
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    for message in messages {
        let LogMessage { channel, sequence, log_time_ns, publish_time_ns, data } = message;
        let schema = writer.add_schema(&channel.type_name, &channel.schema_encoding, &channel.definition).unwrap();
        let id = writer.add_channel(schema, &channel.topic, &channel.message_encoding, &channel.metadata).unwrap();
        let header = mcap::records::MessageHeader {
            channel_id: id,
            sequence: *sequence,
            log_time: *log_time_ns as u64,
            publish_time: *publish_time_ns as u64,
        };
        writer.write_to_known_channel(&header, data).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Bit for bit, but for the time that it took.
pub fn assert_same(found: &[FrameTag], expected: &[FrameTag], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let bits = |tag: &FrameTag| FrameTag { elapsed_ms: 0.0, ..tag.clone() }.encode();
    for (one, other) in found.iter().zip(expected) {
        assert!(bits(one) == bits(other), "{what}: frame {}:\n{one:?}\n{other:?}", other.sequence);
    }
}

/// Largest distance in x and y between two replays of the same frames, metres.
pub fn farthest_apart(found: &[FrameTag], expected: &[FrameTag]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let apart = |(one, other): (&FrameTag, &FrameTag)| {
        let (p, q) = (&one.pose.pose.position, &other.pose.pose.position);
        (p.x - q.x).hypot(p.y - q.y)
    };
    found.iter().zip(expected).map(apart).fold(0.0, f64::max)
}
