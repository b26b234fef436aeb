//! The recording of one session: messages and tags go in, one folder comes out.
//!
//! There are two ways to write. In a replay the caller writes, waits for the disk, and gets every error. On a robot a
//! thread writes, and the caller never waits, whatever the disk does.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use super::entry::{Entry, Kind, SegmentStart};
use super::error::RecordingError;
use super::gap::own_channel;
use super::manifest::{Counts, SessionInfo};
use super::record_queue::{QueueLimits, QueuedEntry, RecordQueue};
use super::recorder::{Plan, Recorder};
use super::status::RecorderStatus;
use super::storage::Storage;
use super::writer::{Limits, Writer};
use realitysim_config::RecordingSettings;
use realitysim_geometry::Isometry;
use realitysim_ros2::mcap_read::{Channel, LogMessage};
use realitysim_ros2::messages::{
    DiagnosticArray, FrameTag, Header, Message, Point, Pose, PoseWithCovarianceStamped, TFMessage, Transform,
    TransformStamped, Vector3,
};
use realitysim_ros2::topics;

/// Writes one session: its folder, its segments and its manifest.
///
/// Messages of the source are passed with [`pass`](Self::pass), tags with [`tag`](Self::tag). The caller asks
/// [`is_segment_full`](Self::is_segment_full) and begins segments with [`next_segment`](Self::next_segment).
/// [`finish`](Self::finish) makes the session whole.
pub struct SessionWriter {
    storage: Arc<dyn Storage>,
    settings: RecordingSettings,
    shared: Arc<RecordQueue>,
    recorder: RecorderSlot,
    /// Channels of the topics that a recording adds, by topic.
    own: BTreeMap<&'static str, Arc<Channel>>,
    /// Latest log time when the open segment began, ns.
    first_ns: i64,
    /// Bytes of the messages given to the open segment.
    bytes: u64,
    /// Latest log time of the session, ns.
    last_ns: i64,
}

/// The recorder, in the caller's thread or in one of its own.
enum RecorderSlot {
    Inline(Box<Recorder>),
    Threaded(Writer),
}

/// Which thread writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Writing {
    /// The caller's thread; the caller gets every error.
    Here,
    /// A thread of its own. No call fails; what is lost is counted.
    Behind {
        /// Rate at which frames will arrive, bytes a second; it sets the size of the queue.
        bytes_per_s: u64,
    },
}

/// Bytes of a message's record in the file besides its data.
const RECORD_BYTES: u64 = 31;

impl SessionWriter {
    /// Creates `captures/<name>/` (with a suffix if that name is taken) and its first segment, which begins with
    /// `state`.
    ///
    /// With [`Writing::Behind`] the folder appears later, once the recorder's thread has made it.
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
            Writing::Here => RecorderSlot::Inline(Box::new(recorder)),
            Writing::Behind { .. } => {
                let limits = Limits::new(captures, &settings);
                RecorderSlot::Threaded(Writer::start(recorder, Arc::clone(&shared), Arc::clone(&storage), limits))
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

    /// Folder of the session; `None` until it has been made.
    pub fn folder(&self) -> Option<PathBuf> {
        self.shared.folder()
    }

    /// Frames and lost messages of all segments so far.
    pub fn counts(&self) -> Counts {
        self.shared.counts()
    }

    /// State of the recorder: memory held, faults, free space.
    pub fn status(&self) -> RecorderStatus {
        self.shared.status()
    }

    /// Number of rounds that the recorder's thread has made; `None` if the caller writes. A watchdog sees by it that
    /// the thread goes on.
    pub fn rounds(&self) -> Option<u64> {
        matches!(self.recorder, RecorderSlot::Threaded(_)).then(|| self.shared.rounds())
    }

    /// Counts and status of the same moment.
    pub fn account(&self) -> (Counts, RecorderStatus) {
        self.shared.account()
    }

    /// Whether the open segment has lasted or grown long enough.
    ///
    /// Its duration runs from the latest log time before it to the latest one in it, so that log times out of order
    /// begin no segments.
    pub fn is_segment_full(&self, log_time_ns: i64) -> bool {
        let age_ns = self.last_ns.max(log_time_ns).saturating_sub(self.first_ns);
        let seconds = i64::try_from(self.settings.segment_s).unwrap_or(i64::MAX);
        age_ns >= seconds.saturating_mul(1_000_000_000)
            || self.bytes >= self.settings.segment_mb << 20
            || self.shared.is_segment_requested()
    }

    /// Finishes the open segment and begins the next, which opens with the filter's state and the latched messages.
    pub fn next_segment(&mut self, state: SegmentState) -> Result<(), RecordingError> {
        let SegmentState { log_time_ns, name, state } = state;
        (self.first_ns, self.bytes) = (self.last_ns.max(log_time_ns), 0);
        self.shared.note_segment_begun();
        self.put(Entry::Begin(SegmentStart { log_time_ns, name: name.to_owned(), state }))
    }

    /// Records a message of the source with its bytes unchanged. Latched messages (calibration, constant transforms)
    /// also open every later segment.
    pub fn pass(&mut self, message: &LogMessage, is_frame: bool, latched: bool) -> Result<(), RecordingError> {
        let kind = match (is_frame, latched) {
            (true, _) => Kind::Frame,
            (false, true) => Kind::Latched,
            (false, false) => Kind::Other,
        };
        self.write(message.clone(), kind)
    }

    /// Records the tag of a frame on `/frame_tag`; a valid tag goes to the topics of poses and of transforms as well.
    pub fn tag(&mut self, log_time_ns: i64, map_frame: &str, tag: &FrameTag) -> Result<(), RecordingError> {
        let position = &tag.pose.pose.position;
        let at = tag.valid.then_some([position.x, position.y]);
        self.own(topics::FRAME_TAG, log_time_ns, tag, Kind::Tag(at))?;
        if tag.valid {
            let header = Header { stamp: tag.header.stamp, frame_id: map_frame.to_owned() };
            self.own(topics::CAMERA_TF, log_time_ns, &camera_transforms(&header, tag), Kind::Other)?;
            let pose = PoseWithCovarianceStamped { header, pose: tag.pose };
            self.own(topics::POSE, log_time_ns, &pose, Kind::Other)?;
        }
        Ok(())
    }

    /// Records the pose that odometry gives while no frame comes.
    pub fn predicted_tag(&mut self, log_time_ns: i64, tag: &FrameTag) -> Result<(), RecordingError> {
        self.own(topics::PREDICTED_TAG, log_time_ns, tag, Kind::Other)
    }

    /// Records a report on the topic of diagnostics.
    pub fn diagnostics(&mut self, log_time_ns: i64, report: &DiagnosticArray) -> Result<(), RecordingError> {
        self.own(topics::DIAGNOSTICS, log_time_ns, report, Kind::Other)
    }

    /// Counts frames that the camera made and that never arrived, as a gap of the log.
    pub fn drop_frames(&mut self, cause: &str, count: u64) -> Result<(), RecordingError> {
        self.shared.drop_frames(cause, count, self.last_ns, self.storage.now());
        if let RecorderSlot::Inline(_) = self.recorder
            && let Some(gap) = self.shared.take_gap()
        {
            self.put(Entry::Gap(gap))?;
        }
        Ok(())
    }

    /// Counts a frame that is tagged but not written, because thinning asks for it.
    pub fn thin_frame(&mut self) -> Result<(), RecordingError> {
        self.put(Entry::Thinned)
    }

    /// Counts a frame that can have no tag, by cause.
    pub fn leave_untagged(&mut self, cause: &str) -> Result<(), RecordingError> {
        self.put(Entry::Untagged(cause.to_owned()))
    }

    /// Replaces a small file as a whole, in order with the messages.
    pub fn replace(&mut self, path: PathBuf, content: Vec<u8>) -> Result<(), RecordingError> {
        self.put(Entry::State(path, content))
    }

    /// Finishes the last segment and writes `metadata.yaml`. What the disk did not take is counted, whether that
    /// succeeds or not.
    pub fn finish(self) -> Ended {
        let Self { recorder, shared, storage, .. } = self;
        let folder = match recorder {
            RecorderSlot::Inline(mut recorder) => recorder.finish().or_else(|_| recorder.finish()),
            RecorderSlot::Threaded(writer) => writer.finish(storage.now()),
        };
        let (counts, status) = shared.account();
        Ended { folder, counts, status }
    }

    /// Records a message on one of the topics that a recording adds.
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
            RecorderSlot::Inline(recorder) => {
                self.shared.hold_unqueued(&entry);
                if let Entry::State(..) = entry {
                    return recorder.take(QueuedEntry { entry, taken });
                }
                // A second try goes into a new segment: one error must not end a session.
                recorder.take(QueuedEntry { entry, taken }).or_else(|_| recorder.write_pending())?;
                recorder.sync_if_due().or_else(|_| recorder.write_pending())
            }
            RecorderSlot::Threaded(_) => {
                self.shared.offer(entry, taken);
                Ok(())
            }
        }
    }
}

/// Result of a session that was finished.
#[derive(Debug)]
pub struct Ended {
    /// The session's folder; `Err` if the disk did not let it become whole.
    pub folder: Result<PathBuf, RecordingError>,
    /// Frames and lost messages of the whole session.
    pub counts: Counts,
    /// State of the recorder at the end.
    pub status: RecorderStatus,
}

/// State of the filter at the beginning of a segment, from which the segment can be replayed alone.
pub struct SegmentState {
    /// Log time of the segment's beginning, ns.
    pub log_time_ns: i64,
    /// Name of the attachment that holds the state.
    pub name: &'static str,
    /// The state, as the filter encodes it.
    pub state: Vec<u8>,
}

/// Returns the transforms from the frame of `header` to the camera, and on to its optical axes.
pub fn camera_transforms(header: &Header, tag: &FrameTag) -> TFMessage {
    let step = |parent: &str, child: &str, transform: Transform| TransformStamped {
        header: Header { frame_id: parent.to_owned(), ..header.clone() },
        child_frame_id: child.to_owned(),
        transform,
    };
    let Pose { position: Point { x, y, z }, orientation: rotation } = tag.pose.pose;
    let map_from_camera = Transform { translation: Vector3 { x, y, z }, rotation };
    TFMessage {
        transforms: vec![
            step(&header.frame_id, topics::TAGGED_CAMERA, map_from_camera),
            step(topics::TAGGED_CAMERA, topics::TAGGED_OPTICAL, Isometry::link_from_optical().into()),
        ],
    }
}

/// Converts mebibytes to bytes.
pub(super) fn mebibytes(count: u64) -> usize {
    usize::try_from(count << 20).unwrap_or(usize::MAX)
}
