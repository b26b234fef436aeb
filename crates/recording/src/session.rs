//! A session as the agent sees it: messages and tags in, one folder out.
//!
//! Either the caller writes itself and is told what fails, as a replay does, or a thread of its own does all writing and
//! the caller never waits, whatever the disk does, as on a robot.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::entry::{Beginning, Entry, Kind};
use super::error::RecordingError;
use super::gap::own_channel;
use super::manifest::{Counts, SessionInfo};
use super::record_queue::{QueueLimits, QueuedEntry, RecordQueue};
use super::recorder::{Plan, Recorder};
use super::status::RecorderStatus;
use super::storage::Storage;
use super::writer::{Limits, Writer};
use realitysim_config::RecordingSettings;
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{DiagnosticArray, FrameTag, Header, Message, PoseWithCovarianceStamped};
use realitysim_ros2::topics;

pub struct SessionWriter {
    storage: Arc<dyn Storage>,
    settings: RecordingSettings,
    shared: Arc<RecordQueue>,
    recorder: Where,
    own: BTreeMap<&'static str, Arc<Channel>>,
    /// The latest log time when the open segment began.
    first_ns: i64,
    bytes: u64,
    last_ns: i64,
}

enum Where {
    Here(Box<Recorder>),
    Behind(Writer),
}

/// Who writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Writing {
    /// The caller, who is told what fails.
    Here,
    /// A thread. Nothing fails for the caller; what is lost is counted. `bytes_per_s` is what frames will take.
    Behind { bytes_per_s: u64 },
}

/// Of a message's record, beside its data.
const RECORD_BYTES: u64 = 31;

impl SessionWriter {
    /// Makes `captures/<name>/` (with a suffix if that is taken) and its first segment, which opens with `state`.
    pub fn create(
        storage: Arc<dyn Storage>,
        captures: &Path,
        name: &str,
        info: &SessionInfo,
        state: SegmentState,
        writing: Writing,
    ) -> Result<Self, RecordingError> {
        let settings = info.settings.recording.clone();
        let plan = Plan {
            captures: captures.to_owned(),
            name: name.to_owned(),
            info: info.clone(),
            sync_interval: Duration::from_millis(settings.sync_interval_ms),
            is_synced_from: matches!(writing, Writing::Behind { .. }),
        };
        let bytes_per_s = if let Writing::Behind { bytes_per_s } = writing { bytes_per_s } else { 0 };
        let room = QueueLimits {
            frames_bytes: super::disk_latency::queue_bytes(storage.as_ref(), captures, &settings, bytes_per_s),
            reserve_bytes: mebibytes(settings.reserve_mb),
        };
        let shared = Arc::new(RecordQueue::new(room));
        let recorder = Recorder::new(Arc::clone(&storage), Arc::clone(&shared), plan);
        let recorder = match writing {
            Writing::Here => Where::Here(Box::new(recorder)),
            Writing::Behind { .. } => {
                let limits = Limits::new(captures, &settings);
                Where::Behind(Writer::start(recorder, Arc::clone(&shared), Arc::clone(&storage), limits))
            }
        };
        let mut session = Self {
            storage,
            settings,
            shared,
            recorder,
            own: BTreeMap::new(),
            first_ns: state.log_time_ns,
            bytes: 0,
            last_ns: state.log_time_ns,
        };
        session.next_segment(state)?;
        Ok(session)
    }

    /// Where it is recorded, once that is known.
    pub fn folder(&self) -> Option<PathBuf> {
        self.shared.folder()
    }

    /// Frames of all segments so far.
    pub fn counts(&self) -> Counts {
        self.shared.counts()
    }

    pub fn status(&self) -> RecorderStatus {
        self.shared.status()
    }

    /// Counts the rounds of the recorder's thread, if it has one of its own.
    pub fn rounds(&self) -> Option<u64> {
        matches!(self.recorder, Where::Behind(_)).then(|| self.shared.rounds())
    }

    /// Both, of one moment.
    pub fn account(&self) -> (Counts, RecorderStatus) {
        self.shared.account()
    }

    /// Whether the segment has lasted or grown long enough. It lasts from the latest log time before it to the latest one in it:
    /// times in no order make no segments.
    pub fn is_segment_full(&self, log_time_ns: i64) -> bool {
        let age_ns = self.last_ns.max(log_time_ns).saturating_sub(self.first_ns);
        let seconds = i64::try_from(self.settings.segment_s).unwrap_or(i64::MAX);
        age_ns >= seconds.saturating_mul(1_000_000_000)
            || self.bytes >= self.settings.segment_mb << 20
            || self.shared.wants_beginning()
    }

    /// Finishes the open segment and begins the next with the constants and the filter's state.
    pub fn next_segment(&mut self, state: SegmentState) -> Result<(), RecordingError> {
        let SegmentState { log_time_ns, name, state } = state;
        (self.first_ns, self.bytes) = (self.last_ns.max(log_time_ns), 0);
        self.shared.begins();
        self.put(Entry::Begin(Beginning { log_time_ns, name: name.to_owned(), state }))
    }

    /// A message of the source, untouched; `latched` ones open every later segment as well.
    pub fn pass(&mut self, message: &LogMessage, is_frame: bool, latched: bool) -> Result<(), RecordingError> {
        let kind = match (is_frame, latched) {
            (true, _) => Kind::Frame,
            (false, true) => Kind::Latched,
            (false, false) => Kind::Other,
        };
        self.write(message.clone(), kind)
    }

    /// One per frame; the pose topic gets the valid ones.
    pub fn tag(&mut self, log_time_ns: i64, map_frame: &str, tag: &FrameTag) -> Result<(), RecordingError> {
        let position = &tag.pose.pose.position;
        let at = tag.valid.then_some([position.x, position.y]);
        self.own(topics::FRAME_TAG, log_time_ns, tag, Kind::Tag(at))?;
        if tag.valid {
            let header = Header { stamp: tag.header.stamp, frame_id: map_frame.to_owned() };
            let pose = PoseWithCovarianceStamped { header, pose: tag.pose };
            self.own(topics::POSE, log_time_ns, &pose, Kind::Other)?;
        }
        Ok(())
    }

    /// Of no frame: where odometry has the camera while there is none.
    pub fn predicted_tag(&mut self, log_time_ns: i64, tag: &FrameTag) -> Result<(), RecordingError> {
        self.own(topics::PREDICTED_TAG, log_time_ns, tag, Kind::Other)
    }

    pub fn diagnostics(&mut self, log_time_ns: i64, report: &DiagnosticArray) -> Result<(), RecordingError> {
        self.own(topics::DIAGNOSTICS, log_time_ns, report, Kind::Other)
    }

    /// Frames that the camera made and that never came here: a gap of the log.
    pub fn drop_frames(&mut self, cause: &str, count: u64) -> Result<(), RecordingError> {
        self.shared.drop_frames(cause, count, self.last_ns, self.storage.now());
        if let Where::Here(_) = self.recorder
            && let Some(gap) = self.shared.take_gap()
        {
            self.put(Entry::Gap(gap))?;
        }
        Ok(())
    }

    /// A frame that is tagged and not written, as asked.
    pub fn thin_frame(&mut self) -> Result<(), RecordingError> {
        self.put(Entry::Thinned)
    }

    /// A frame that can have no tag.
    pub fn leave_untagged(&mut self, cause: &str) -> Result<(), RecordingError> {
        self.put(Entry::Untagged(cause.to_owned()))
    }

    /// A small file, replaced as a whole.
    pub fn replace(&mut self, path: PathBuf, content: Vec<u8>) -> Result<(), RecordingError> {
        self.put(Entry::State(path, content))
    }

    /// Finishes the last segment and writes `metadata.yaml`. What the disk did not take is counted, whether that succeeds or not.
    pub fn finish(self) -> Ended {
        let Self { recorder, shared, storage, .. } = self;
        let folder = match recorder {
            Where::Here(mut recorder) => recorder.finish().or_else(|_| recorder.finish()),
            Where::Behind(writer) => writer.finish(storage.now()),
        };
        let (counts, status) = shared.account();
        Ended { folder, counts, status }
    }

    fn own<M: Message>(
        &mut self,
        topic: &'static str,
        log_time_ns: i64,
        message: &M,
        kind: Kind,
    ) -> Result<(), RecordingError> {
        let channel = Arc::clone(self.own.entry(topic).or_insert_with(|| own_channel::<M>(topic)));
        let data = message.encode();
        self.write(LogMessage { channel, sequence: 0, log_time_ns, publish_time_ns: log_time_ns, data }, kind)
    }

    fn write(&mut self, message: LogMessage, kind: Kind) -> Result<(), RecordingError> {
        self.last_ns = self.last_ns.max(message.log_time_ns);
        self.bytes += message.data.len() as u64 + RECORD_BYTES;
        self.put(Entry::Message(message, kind))
    }

    fn put(&mut self, entry: Entry) -> Result<(), RecordingError> {
        let taken = self.storage.now();
        match &mut self.recorder {
            Where::Here(recorder) => {
                self.shared.take_at_once(&entry);
                if let Entry::State(..) = entry {
                    return recorder.take(QueuedEntry { entry, taken });
                }
                // Once more, into a new segment: one error must not end a session.
                recorder.take(QueuedEntry { entry, taken }).or_else(|_| recorder.go_on())?;
                recorder.sync_if_due().or_else(|_| recorder.go_on())
            }
            Where::Behind(_) => {
                self.shared.offer(entry, taken);
                Ok(())
            }
        }
    }
}

/// What a session ended with.
#[derive(Debug)]
pub struct Ended {
    /// Where it is; `Err` if the disk did not let it become whole.
    pub folder: Result<PathBuf, RecordingError>,
    pub counts: Counts,
    pub status: RecorderStatus,
}

/// The filter's state where a segment begins.
pub struct SegmentState {
    pub log_time_ns: i64,
    pub name: &'static str,
    pub state: Vec<u8>,
}

pub(super) fn mebibytes(count: u64) -> usize {
    usize::try_from(count << 20).unwrap_or(usize::MAX)
}
