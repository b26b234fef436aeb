//! A session: one folder, from the first message to the last.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use thiserror::Error;

use super::manifest::{Counts, MANIFEST_FILE, ManifestLine, SESSION_FILE, SessionInfo, TopicEntry, metadata_yaml};
use super::segment::{Segment, sync_folder};
use super::topic;
use crate::config::RecordingSettings;
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::mcap_write::{Durability, WriteError, qos_profile};
use crate::ros2::messages::{CameraInfo, DiagnosticArray, FrameTag, Header, Message, PoseWithCovarianceStamped};

#[derive(Debug, Error)]
pub enum RecordingError {
    #[error("{path}: {source}")]
    Io { path: PathBuf, source: io::Error },
    #[error(transparent)]
    Log(#[from] WriteError),
    #[error("session.json: {0}")]
    Json(#[from] serde_json::Error),
    #[error("{path}: not what a session says about itself: {source}")]
    Info { path: PathBuf, source: serde_json::Error },
}

pub struct SessionWriter {
    folder: PathBuf,
    settings: RecordingSettings,
    segment: Segment,
    next_index: u32,
    manifest: File,
    lines: Vec<ManifestLine>,
    /// Frames of the segments in `lines`.
    finished: Counts,
    /// Messages so far.
    topics: BTreeMap<TopicEntry, u64>,
    /// Calibration and constants, written again at the start of each segment.
    latched: Vec<LogMessage>,
}

/// More latched messages than this are not repeated in each segment.
const MAX_LATCHED: usize = 256;
/// Names tried before giving up: `name`, `name-2`, ...
const MAX_SUFFIX: u32 = 10_000;

impl SessionWriter {
    /// Makes `captures/<name>/` (with a suffix if that is taken) and its first segment.
    pub fn create(
        captures: &Path,
        name: &str,
        info: &SessionInfo,
        settings: RecordingSettings,
    ) -> Result<Self, RecordingError> {
        let failed = |source| RecordingError::Io { path: captures.to_owned(), source };
        fs::create_dir_all(captures).map_err(failed)?;
        let folder = new_folder(captures, name)?;
        write_atomically(&folder.join(SESSION_FILE), &serde_json::to_vec_pretty(info)?)?;
        let path = folder.join(MANIFEST_FILE);
        let manifest = OpenOptions::new()
            .append(true)
            .create_new(true)
            .open(&path)
            .map_err(|source| RecordingError::Io { path, source })?;
        sync_folder(captures)?;
        let segment = Segment::create(&folder, 0)?;
        Ok(Self {
            folder,
            settings,
            segment,
            next_index: 1,
            manifest,
            lines: Vec::new(),
            finished: Counts::default(),
            topics: BTreeMap::new(),
            latched: Vec::new(),
        })
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Frames of the segment being written and of those finished.
    pub fn counts(&self) -> Counts {
        let mut total = self.finished.clone();
        total.add(&self.segment.counts);
        total
    }

    /// Whether the segment has lasted or grown long enough.
    pub fn is_segment_full(&self, log_time_ns: i64) -> bool {
        let age_ns = self.segment.first_ns().map_or(0, |first| log_time_ns.saturating_sub(first));
        let seconds = i64::try_from(self.settings.segment_s).unwrap_or(i64::MAX);
        age_ns >= seconds.saturating_mul(1_000_000_000) || self.segment.bytes() >= self.settings.segment_mb << 20
    }

    /// Finishes the open segment and begins the next with the constants and the filter's state.
    pub fn next_segment(&mut self, log_time_ns: i64, name: &str, checkpoint: &[u8]) -> Result<(), RecordingError> {
        let segment = Segment::create(&self.folder, self.next_index)?;
        self.next_index += 1;
        let line = std::mem::replace(&mut self.segment, segment).finish()?;
        self.note(line)?;
        self.segment.attach(name, log_time_ns, checkpoint)?;
        for mut message in self.latched.clone() {
            message.log_time_ns = log_time_ns;
            self.count_passed(&message);
            self.segment.pass(&message)?;
        }
        Ok(())
    }

    /// The filter's state at the start of the first segment.
    pub fn attach(&mut self, log_time_ns: i64, name: &str, data: &[u8]) -> Result<(), RecordingError> {
        self.segment.attach(name, log_time_ns, data)
    }

    /// A message of the source, untouched; `latched` ones open every later segment as well.
    pub fn pass(&mut self, message: &LogMessage, is_frame: bool, latched: bool) -> Result<(), RecordingError> {
        if latched {
            self.keep(message);
        }
        self.count_passed(message);
        self.segment.counts.captured += u64::from(is_frame);
        self.segment.pass(message)?;
        self.segment.counts.written += u64::from(is_frame);
        self.segment.sync_if_due(Duration::from_millis(self.settings.sync_interval_ms))
    }

    /// One per frame; the pose topic gets the valid ones.
    pub fn tag(&mut self, log_time_ns: i64, map_frame: &str, tag: &FrameTag) -> Result<(), RecordingError> {
        self.write(topic::FRAME_TAG, log_time_ns, tag)?;
        self.segment.counts.tagged += 1;
        if tag.valid {
            self.segment.counts.valid += 1;
            let position = &tag.pose.pose.position;
            self.segment.valid_pose(position.x, position.y);
            let header = Header { stamp: tag.header.stamp, frame_id: map_frame.to_owned() };
            let pose = PoseWithCovarianceStamped { header, pose: tag.pose };
            self.write(topic::POSE, log_time_ns, &pose)?;
        }
        Ok(())
    }

    pub fn diagnostics(&mut self, log_time_ns: i64, report: &DiagnosticArray) -> Result<(), RecordingError> {
        self.write(topic::DIAGNOSTICS, log_time_ns, report)
    }

    /// Frames that the camera made and that are not written.
    pub fn drop_frames(&mut self, cause: &str, count: u64) {
        self.segment.counts.captured += count;
        *self.segment.counts.dropped.entry(cause.to_owned()).or_default() += count;
    }

    /// A frame that is tagged and not written, as asked.
    pub fn thin_frame(&mut self) {
        self.segment.counts.captured += 1;
        self.segment.counts.thinned += 1;
    }

    /// A frame that was written and can have no tag.
    pub fn leave_untagged(&mut self, cause: &str) {
        *self.segment.counts.untagged.entry(cause.to_owned()).or_default() += 1;
    }

    /// Finishes the last segment and writes `metadata.yaml`.
    pub fn finish(mut self) -> Result<(PathBuf, Counts), RecordingError> {
        let counts = self.counts();
        let line = self.segment.finish()?;
        append_line(&mut self.manifest, &self.folder, &line)?;
        self.lines.push(line);
        let yaml = metadata_yaml(&self.lines, &self.topics);
        write_atomically(&self.folder.join("metadata.yaml"), yaml.as_bytes())?;
        Ok((self.folder, counts))
    }

    fn note(&mut self, line: ManifestLine) -> Result<(), RecordingError> {
        append_line(&mut self.manifest, &self.folder, &line)?;
        self.finished.add(&line.frames);
        self.lines.push(line);
        Ok(())
    }

    fn write<M: Message>(&mut self, topic: &'static str, log_time_ns: i64, message: &M) -> Result<(), RecordingError> {
        self.count(topic, M::TYPE, &qos_profile(Durability::Volatile));
        self.segment.write(topic, log_time_ns, message)
    }

    /// Many drivers send calibration with every frame, and constants again and again: once is enough.
    fn keep(&mut self, message: &LogMessage) {
        let newest_only = message.channel.type_name == CameraInfo::TYPE;
        let is_known = |known: &LogMessage| {
            known.channel.topic == message.channel.topic && (newest_only || known.data == message.data)
        };
        match self.latched.iter().position(is_known) {
            Some(place) => self.latched[place] = message.clone(),
            None if self.latched.len() < MAX_LATCHED => self.latched.push(message.clone()),
            None => {}
        }
    }

    fn count_passed(&mut self, message: &LogMessage) {
        let channel = &message.channel;
        self.count(&channel.topic, &channel.type_name, channel.qos_profiles());
    }

    fn count(&mut self, name: &str, type_name: &str, qos_profiles: &str) {
        let [name, type_name, qos_profiles] = [name, type_name, qos_profiles].map(str::to_owned);
        *self.topics.entry(TopicEntry { name, type_name, qos_profiles }).or_default() += 1;
    }
}

fn append_line(manifest: &mut File, folder: &Path, line: &ManifestLine) -> Result<(), RecordingError> {
    let mut text = serde_json::to_string(line)?;
    text.push('\n');
    let failed = |source| RecordingError::Io { path: folder.join(MANIFEST_FILE), source };
    manifest.write_all(text.as_bytes()).map_err(failed)?;
    manifest.sync_data().map_err(failed)
}

fn new_folder(captures: &Path, name: &str) -> Result<PathBuf, RecordingError> {
    for suffix in 1..=MAX_SUFFIX {
        let folder = captures.join(if suffix == 1 { name.to_owned() } else { format!("{name}-{suffix}") });
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(source) => return Err(RecordingError::Io { path: folder, source }),
        }
    }
    let source = io::Error::from(io::ErrorKind::AlreadyExists);
    Err(RecordingError::Io { path: captures.join(name), source })
}

/// The old content or the new, never a part: written beside, forced to disk, renamed.
pub fn write_atomically(path: &Path, content: &[u8]) -> Result<(), RecordingError> {
    let failed = |source| RecordingError::Io { path: path.to_owned(), source };
    let beside = path.with_extension("new");
    let mut file = File::create(&beside).map_err(failed)?;
    file.write_all(content).and_then(|()| file.sync_all()).map_err(failed)?;
    fs::rename(&beside, path).map_err(failed)?;
    path.parent().map_or(Ok(()), sync_folder)
}
