//! One recording on a simulated disk, driven as the recorder's thread drives it.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use super::disk::{SimulatedDisk, Trouble};
use super::prng::Prng;
use crate::entry::{Entry, Kind, SegmentStart};
use crate::folder::manifest_lines;
use crate::manifest::{Counts, FORMAT_VERSION, SESSION_FILE, SessionInfo};
use crate::record_queue::{QueueLimits, QueuedEntry, RecordQueue};
use crate::recorder::{Plan, Recorder};
use crate::segment::segment_index;
use crate::storage::{Kind as Listed, Storage, write_atomically};
use realitysim_config::{Settings, load_field, load_lens};
use realitysim_ros2::mcap_read::{Channel, LogMessage, LogReader, Selection};
use realitysim_ros2::messages::{CompressedImage, FrameTag, Imu, Message, TFMessage};
use realitysim_ros2::topics;

pub const CAPTURES: &str = "/captures";
pub const SYNC_INTERVAL: Duration = Duration::from_millis(200);
pub const IMAGE: &str = "/camera/image/compressed";
const LATCHED: &str = "/tf_static";
/// Time between two frames.
const FRAME: Duration = Duration::from_millis(33);

/// The recording, and what the disk has confirmed of it.
pub struct Run {
    pub disk: SimulatedDisk,
    pub shared: Arc<RecordQueue>,
    pub script: Vec<Scripted>,
    recorder: Option<Recorder>,
    taken: usize,
    /// Number of entries of the script that the disk has confirmed.
    pub confirmed: usize,
    /// Greatest age of an entry that was not confirmed, without the times at which the disk refused.
    pub oldest_unconfirmed: Duration,
    pub is_finished: bool,
}

/// An entry of a script; its place becomes its sequence number.
#[derive(Clone)]
pub enum Scripted {
    Begin(Vec<u8>),
    Message(Kind, Vec<u8>),
    Thinned,
}

impl Scripted {
    pub fn is_beginning(&self) -> bool {
        matches!(self, Self::Begin(_))
    }

    pub fn is_message(&self) -> bool {
        matches!(self, Self::Message(..))
    }

    pub fn is_frame(&self) -> bool {
        matches!(self, Self::Message(Kind::Frame, _))
    }

    pub fn data(&self) -> &[u8] {
        match self {
            Self::Begin(data) | Self::Message(_, data) => data,
            Self::Thinned => &[],
        }
    }
}

/// Script of a walk: constants, measurements, frames with their tags, some of them thinned out, and now and then a
/// segment.
pub fn script(seed: u64) -> Vec<Scripted> {
    let mut prng = Prng::new(seed);
    let mut bytes = |least: u64, most: u64| {
        let length = least + prng.below(most - least + 1);
        (0..length).map(|_| prng.next() as u8).collect::<Vec<u8>>()
    };
    let mut all = vec![Scripted::Begin(bytes(50, 300)), Scripted::Message(Kind::Latched, bytes(60, 60))];
    let frames = 24 + bytes(0, 16).len();
    for frame in 0..frames {
        if frame > 0 && frame % 11 == 0 {
            all.push(Scripted::Begin(bytes(50, 300)));
        }
        for _ in 0..bytes(0, 3).len() {
            all.push(Scripted::Message(Kind::Other, bytes(20, 80)));
        }
        all.push(match frame % 3 {
            2 => Scripted::Thinned,
            _ => Scripted::Message(Kind::Frame, bytes(200, 3000)),
        });
        all.push(Scripted::Message(Kind::Tag(None), bytes(100, 100)));
    }
    all
}

impl Run {
    pub fn new(seed: u64, trouble: Trouble) -> Self {
        let disk = SimulatedDisk::new(seed, trouble);
        let shared =
            Arc::new(RecordQueue::new(QueueLimits { frames_bytes: usize::MAX / 4, reserve_bytes: usize::MAX / 4 }));
        let plan = Plan {
            captures: CAPTURES.into(),
            name: "2026-01-01T00-00-00Z-robot".to_owned(),
            info: info().clone(),
            sync_interval: SYNC_INTERVAL,
            is_synced_from: true,
        };
        let recorder = Recorder::new(Arc::new(disk.clone()), Arc::clone(&shared), plan);
        Self {
            disk,
            shared,
            script: script(seed),
            recorder: Some(recorder),
            taken: 0,
            confirmed: 0,
            oldest_unconfirmed: Duration::ZERO,
            is_finished: false,
        }
    }

    pub fn feed_half(&mut self) {
        self.feed(self.script.len() / 2);
    }

    pub fn until_the_end(mut self) -> Self {
        self.feed(self.script.len());
        self.finish();
        self
    }

    /// Sequence numbers of the messages that the disk has confirmed.
    pub fn confirmed_sequences(&self) -> impl Iterator<Item = u32> {
        let confirmed = self.script[..self.confirmed].iter().enumerate();
        confirmed.filter(|(_, entry)| entry.is_message()).map(|(place, _)| place as u32)
    }

    fn feed(&mut self, until: usize) {
        let mut recorder = self.recorder.take().unwrap();
        let mut times = Vec::new();
        while self.taken < until && !self.disk.is_dead() {
            let entry = entry(self.taken, &self.script[self.taken]);
            self.disk.pass(if entry.is_frame() { FRAME } else { Duration::from_millis(1) });
            let taken = self.disk.now();
            times.push(taken);
            self.shared.hold_unqueued(&entry);
            self.taken += 1;
            let mut done = recorder.take(QueuedEntry { entry, taken }).and_then(|()| recorder.sync_if_due());
            let was_sound = done.is_ok();
            // The recorder's thread keeps trying while other entries come. Here a few tries are enough, since the
            // next entry tries again.
            for _ in 0..3 {
                if done.is_ok() || self.disk.is_dead() {
                    break;
                }
                self.disk.pass(Duration::from_millis(20));
                done = recorder.write_pending();
            }
            if !self.disk.is_dead() || was_sound {
                self.confirmed = self.taken - recorder.kept();
            }
            if was_sound && let Some(oldest) = times.get(times.len().saturating_sub(recorder.kept())) {
                self.oldest_unconfirmed = self.oldest_unconfirmed.max(self.disk.now().saturating_sub(*oldest));
            }
        }
        self.recorder = Some(recorder);
    }

    fn finish(&mut self) {
        let mut recorder = self.recorder.take().unwrap();
        for _ in 0..200 {
            if self.disk.is_dead() {
                break;
            }
            if recorder.finish().is_ok() {
                self.is_finished = true;
                self.confirmed = self.taken;
                return;
            }
            self.confirmed = self.taken - recorder.kept();
            self.disk.pass(Duration::from_millis(100));
        }
        recorder.abandon("disk_error");
    }
}

fn entry(place: usize, scripted: &Scripted) -> Entry {
    let log_time_ns = 1_000_000_000 + place as i64 * 1_000_000;
    match scripted {
        Scripted::Begin(state) => {
            Entry::Begin(SegmentStart { log_time_ns, name: "filter_state".to_owned(), state: state.clone() })
        }
        Scripted::Thinned => Entry::Thinned,
        Scripted::Message(kind, data) => {
            let channel = Arc::clone(
                &channels()[match kind {
                    Kind::Frame => 0,
                    Kind::Tag(_) => 1,
                    Kind::Latched => 2,
                    Kind::Other => 3,
                }],
            );
            let sequence = place as u32;
            let data = data.clone();
            Entry::Message(LogMessage { channel, sequence, log_time_ns, publish_time_ns: log_time_ns, data }, *kind)
        }
    }
}

fn channels() -> &'static [Arc<Channel>; 4] {
    fn of<M: Message>(topic: &str) -> Arc<Channel> {
        Arc::new(Channel::of::<M>(0, topic, Default::default()))
    }
    static CHANNELS: OnceLock<[Arc<Channel>; 4]> = OnceLock::new();
    CHANNELS.get_or_init(|| {
        [
            of::<CompressedImage>(IMAGE),
            of::<FrameTag>(topics::FRAME_TAG),
            of::<TFMessage>(LATCHED),
            of::<Imu>("/imu/data"),
        ]
    })
}

fn info() -> &'static SessionInfo {
    static INFO: OnceLock<SessionInfo> = OnceLock::new();
    INFO.get_or_init(session_info)
}

pub const SESSION_ID: &str = "5e5500000000000000000000000000e5";

pub fn session_info() -> SessionInfo {
    SessionInfo {
        format: FORMAT_VERSION,
        id: Some(SESSION_ID.to_owned()),
        software: "test".to_owned(),
        robot: "robot".to_owned(),
        started: String::new(),
        source: None,
        settings: Settings::default(),
        field: load_field("kid-2009").unwrap(),
        lens: load_lens("fisheye-640").unwrap().lens.parameters().clone(),
        body_masks: Vec::new(),
        live: None,
    }
}

pub fn is_latched(message: &LogMessage) -> bool {
    message.channel.topic == LATCHED
}

pub fn is_frame(message: &LogMessage) -> bool {
    message.channel.topic == IMAGE
}

/// The only session, once it has begun.
pub fn session(disk: &SimulatedDisk) -> Option<PathBuf> {
    let folders = disk.list(Path::new(CAPTURES)).ok()?;
    let mut sessions = folders.into_iter().filter(|entry| entry.kind == Listed::Folder);
    let session = Path::new(CAPTURES).join(sessions.next()?.name);
    assert!(sessions.next().is_none(), "one session");
    disk.read(&session.join(SESSION_FILE)).is_ok().then_some(session)
}

/// All messages of the segments, finished or not, in their order.
pub fn read(disk: &SimulatedDisk, session: &Path) -> Vec<LogMessage> {
    let mut files: Vec<String> = disk.list(session).unwrap().into_iter().map(|file| file.name).collect();
    files.retain(|name| segment_index(name).is_some());
    files.sort_by_key(|name| segment_index(name));
    files.iter().flat_map(|name| read_file(disk, &session.join(name))).collect()
}

pub fn read_file(disk: &SimulatedDisk, path: &Path) -> Vec<LogMessage> {
    match LogReader::open(disk.read(path).unwrap(), Selection::All) {
        Ok(reader) => reader.map(Result::unwrap).collect(),
        // Nothing of the file has reached the disk.
        Err(_) => Vec::new(),
    }
}

/// Counts of all segments.
pub fn counts_of_manifest(disk: &SimulatedDisk, session: &Path) -> Counts {
    let mut sum = Counts::default();
    for line in manifest_lines(disk, session).unwrap() {
        assert!(line.frames.is_conserved(), "{line:?}");
        sum.add(&line.frames);
    }
    sum
}

/// Bytes that could not be kept, according to the manifest.
pub fn cut_bytes(disk: &SimulatedDisk, session: &Path) -> u64 {
    manifest_lines(disk, session).unwrap().iter().filter_map(|line| line.cut_bytes).sum()
}

/// Puts the session of `from` onto a disk, with only this content of its first segment, as if that had never been
/// finished.
pub fn put(disk: &SimulatedDisk, captures: &str, session: &Path, from: &SimulatedDisk, content: &[u8]) {
    disk.create_folder(Path::new(captures)).unwrap();
    disk.create_folder(session).unwrap();
    let info = from.snapshot().remove(&session.join(SESSION_FILE)).unwrap();
    write_atomically(disk, &session.join(SESSION_FILE), &info).unwrap();
    let file = disk.create(&session.join("0000.mcap.active")).unwrap();
    let mut written = 0;
    while written < content.len() {
        written += file.write(&content[written..]).unwrap();
    }
}
