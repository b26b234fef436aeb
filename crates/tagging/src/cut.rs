//! Cuts a piece out of a long recording into a log of its own that replays to the same tags.
//!
//! Calibration, transforms and the filter's state come along. The recording is replayed up to the end of the piece into
//! segments of one second, each of which begins with the filter's state. The piece is joined from the segments that it
//! touches.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use serde::Serialize;
use thiserror::Error;

use super::error::ReplayError;
use super::replay::{Progress, ReplayOptions, replay};
use realitysim_config::Settings;
use realitysim_log_input::encode;
use realitysim_log_input::log::{self as logs, LogError, LogSource, StoredCheckpoint};
use realitysim_log_input::scene_source::is_drawn_for_episode;
use realitysim_ros2::mcap_read::{LogMessage, Selection};
use realitysim_ros2::mcap_write::{ChannelId, LogWriter, RawChannel, WriteError};
use realitysim_ros2::topics;

/// What to cut, and how.
#[derive(Clone, Debug)]
pub struct CutOptions {
    /// A log, a folder of them, or a capture.
    pub source: PathBuf,
    /// The log to write.
    pub output: PathBuf,
    /// Folder for intermediate files.
    pub temporary: PathBuf,
    /// Settings of the replay up to the piece.
    pub settings: Settings,
    /// Start of the piece, seconds after the source's first message.
    pub from_s: f64,
    /// End of the piece, seconds after the source's first message.
    pub to_s: f64,
    /// JPEG quality with which images are encoded again where that makes them smaller. The tags of the piece then differ
    /// from those of the source.
    pub jpeg_quality: Option<u8>,
    /// Number of threads of the replay.
    pub threads: usize,
}

/// What was cut.
#[derive(Clone, Debug, Serialize)]
pub struct CutReport {
    /// The log that was written.
    pub log: PathBuf,
    /// Where the piece begins, seconds after the source's first message: up to a second earlier than asked for.
    pub from_s: f64,
    /// Where the piece ends, seconds after the source's first message.
    pub to_s: f64,
    /// Number of frames in the piece.
    pub frames: u64,
    /// Number of messages in the piece, frames included.
    pub messages: u64,
    /// Size of the log, bytes.
    pub bytes: u64,
}

/// Why nothing was cut.
#[derive(Debug, Error)]
pub enum CutError {
    /// The replay up to the piece failed.
    #[error(transparent)]
    Replay(#[from] ReplayError),
    /// The source or an intermediate log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A log cannot be written.
    #[error("{path}: {source}")]
    Write {
        /// The log.
        path: PathBuf,
        /// What went wrong.
        source: WriteError,
    },
    /// A file cannot be created, measured or removed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: std::io::Error,
    },
    /// There is no frame in the span of time.
    #[error("{path}: no frame between {from_s} and {to_s} s after its start: it lasts {lasts_s:.1} s")]
    Nothing {
        /// The source.
        path: PathBuf,
        /// Start of the span, seconds after the source's first message.
        from_s: f64,
        /// End of the span, seconds after the source's first message.
        to_s: f64,
        /// Duration of the source, seconds.
        lasts_s: f64,
    },
}

/// How long measurements are copied beyond the end of the piece, because the last frame's tag waits for them.
const TAIL_NS: i64 = 500_000_000;
/// Duration of an intermediate segment.
const SEGMENT_S: u64 = 1;

/// Cuts a piece out of a recording. `progress` hears of the frames of the replay.
pub fn cut(options: &CutOptions, progress: Progress) -> Result<CutReport, CutError> {
    let files = logs::files_of(&options.source)?;
    let first_log_times = first_log_times(&files)?;
    let first_ns = earliest(&first_log_times);
    let time = |seconds: f64| first_ns.saturating_add((seconds * 1e9) as i64);
    let (from_ns, to_ns) = (time(options.from_s), time(options.to_s));
    let drawn = drawn_for_episode(&files)?;
    // The replay starts at the last checkpoint before the piece.
    let known = (0..files.len()).rev().find(|which| {
        first_log_times[*which].is_some_and(|start| start <= from_ns)
            && matches!(checkpoint_bytes(&files[*which]), Ok(Some(_)))
    });
    let files = files[known.unwrap_or(0)..].to_vec();
    let truth_topic = options.settings.topics.ground_truth.as_str();
    let needed = options.temporary.join("needed.mcap");
    let last_ns = copy_until(&files, to_ns, truth_topic, &needed)?;
    let nothing = || CutError::Nothing {
        path: options.source.clone(),
        from_s: options.from_s,
        to_s: options.to_s,
        lasts_s: last_ns.saturating_sub(first_ns) as f64 * 1e-9,
    };
    if last_ns < from_ns {
        return Err(nothing());
    }
    let mut settings = options.settings.clone();
    settings.recording.segment_s = SEGMENT_S;
    // The piece keeps every frame.
    settings.recording.thinning = Default::default();
    let replayed = ReplayOptions {
        source: needed.clone(),
        captures: options.temporary.join("captures"),
        settings,
        initial: None,
        threads: options.threads,
        realtime: false,
        warm_start: false,
    };
    let session = replay(&replayed, progress)?.session;
    let segments = logs::files_of(&session)?;
    let first_log_times = self::first_log_times(&segments)?;
    let first_segment =
        (0..segments.len()).rev().find(|which| first_log_times[*which].is_some_and(|start| start <= from_ns));
    let first_segment = first_segment.unwrap_or(0);
    let piece_start_ns = first_log_times.get(first_segment).copied().flatten().unwrap_or(from_ns);
    let truth = truth_from(&needed, truth_topic, piece_start_ns)?;
    // The message stands at the start of the scene's log; it moves to the start of the piece.
    let drawn = drawn.map(|drawn| LogMessage { log_time_ns: piece_start_ns, publish_time_ns: piece_start_ns, ..drawn });
    let written = join_segments(&segments[first_segment..], truth, drawn, options)?;
    if written.frames == 0 {
        fs::remove_file(&options.output).map_err(|source| io(&options.output, source))?;
        return Err(nothing());
    }
    let bytes = fs::metadata(&options.output).map_err(|source| io(&options.output, source))?.len();
    Ok(CutReport {
        log: options.output.clone(),
        from_s: (piece_start_ns - first_ns) as f64 * 1e-9,
        to_s: (to_ns.min(last_ns) - first_ns) as f64 * 1e-9,
        frames: written.frames,
        messages: written.messages,
        bytes,
    })
}

/// Log time of the first message of a log, a folder of them, or a capture, nanoseconds: seconds of a piece count from it.
///
/// # Errors
///
/// Fails if a file cannot be read.
pub fn start_ns(source: &Path) -> Result<i64, CutError> {
    Ok(earliest(&first_log_times(&logs::files_of(source)?)?))
}

fn earliest(first_log_times: &[Option<i64>]) -> i64 {
    first_log_times.iter().copied().flatten().min().unwrap_or(0)
}

/// Log time of the first message of each file; `None` for a file without messages.
fn first_log_times(files: &[PathBuf]) -> Result<Vec<Option<i64>>, LogError> {
    let first = |file: &PathBuf| LogSource::new(vec![file.clone()], Selection::All).next().transpose();
    files.iter().map(|file| Ok(first(file)?.map(|message| message.log_time_ns))).collect()
}

fn checkpoint_bytes(file: &Path) -> Result<Option<Vec<u8>>, LogError> {
    let surveys = logs::surveys(&[file.to_owned()])?;
    let Some(survey) = surveys.first() else { return Ok(None) };
    Ok(match logs::checkpoint(file, survey)? {
        StoredCheckpoint::Bytes(bytes) => Some(bytes),
        StoredCheckpoint::None | StoredCheckpoint::Damaged => None,
    })
}

fn is_frame(message: &LogMessage) -> bool {
    ["sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"].contains(&message.channel.type_name.as_str())
}

/// Copies all messages up to `to_ns`, and measurements for [`TAIL_NS`] beyond. Returns the log time of the last message.
fn copy_until(files: &[PathBuf], to_ns: i64, truth: &str, output: &Path) -> Result<i64, CutError> {
    let mut copy = LogCopy::create(output)?;
    if let Some(state) = files.first().map(|file| checkpoint_bytes(file)).transpose()?.flatten() {
        copy.attach(&state)?;
    }
    let mut last_ns = i64::MIN;
    // Tags are copied too: they tell a replay where the time budget stopped a frame.
    for message in LogSource::with_outputs(files.to_vec(), Selection::All) {
        let message = message?;
        // Files follow each other in time, and hardly overlap.
        if message.log_time_ns > to_ns.saturating_add(2 * TAIL_NS) {
            break;
        }
        let is_of_frame = is_frame(&message) || [topics::FRAME_TAG, truth].contains(&message.channel.topic.as_str());
        let until_ns = if is_of_frame { to_ns } else { to_ns.saturating_add(TAIL_NS) };
        if message.log_time_ns <= until_ns {
            last_ns = last_ns.max(message.log_time_ns);
            copy.take(&message)?;
        }
    }
    copy.finish()?;
    Ok(last_ns)
}

/// The messages of the ground truth from `from_ns` on, which a replay leaves out of its capture.
fn truth_from(log: &Path, topic: &str, from_ns: i64) -> Result<Vec<LogMessage>, LogError> {
    let source = LogSource::new(vec![log.to_owned()], Selection::topics([topic]));
    let mut truth = source.collect::<Result<Vec<_>, _>>()?;
    truth.retain(|message| message.log_time_ns >= from_ns);
    Ok(truth)
}

/// The message with the numbers drawn for the episode, which a scene's log has once at its start.
fn drawn_for_episode(files: &[PathBuf]) -> Result<Option<LogMessage>, LogError> {
    let mut told = LogSource::new(files.to_vec(), Selection::topics([topics::SCENE_DRAWN]));
    told.find(|message| message.as_ref().map_or(true, is_drawn_for_episode)).transpose()
}

/// Writes the piece: the first segment's checkpoint, `drawn`, then the messages of all segments with the ground truth
/// sorted in.
fn join_segments(
    segments: &[PathBuf],
    truth: Vec<LogMessage>,
    drawn: Option<LogMessage>,
    options: &CutOptions,
) -> Result<LogCopy, CutError> {
    let mut copy = LogCopy::create(&options.output)?;
    if let Some(state) = segments.first().map(|file| checkpoint_bytes(file)).transpose()?.flatten() {
        copy.attach(&state)?;
    }
    if let Some(drawn) = &drawn {
        copy.take(drawn)?;
    }
    let mut truth = truth.into_iter().peekable();
    // Each segment repeats the constant messages at its start; the piece has them once.
    for (which, segment) in segments.iter().enumerate() {
        let start = first_log_times(std::slice::from_ref(segment))?.first().copied().flatten();
        for message in LogSource::with_outputs(vec![segment.clone()], Selection::All) {
            let message = message?;
            let repeated = which > 0 && Some(message.log_time_ns) == start && copy.has(&message);
            if repeated || is_drawn_for_episode(&message) {
                continue;
            }
            while let Some(true_pose) = truth.next_if(|pose| pose.log_time_ns <= message.log_time_ns) {
                copy.take(&true_pose)?;
            }
            let quality = options.jpeg_quality.filter(|_| is_frame(&message));
            let smaller = quality.and_then(|quality| encode::as_jpeg(&message, quality));
            copy.take(smaller.as_ref().unwrap_or(&message))?;
        }
    }
    for true_pose in truth {
        copy.take(&true_pose)?;
    }
    copy.finish()
}

/// A log that messages are copied into.
struct LogCopy {
    path: PathBuf,
    writer: Option<LogWriter<BufWriter<File>>>,
    /// Channels by topic and type.
    channels: Vec<((String, String), ChannelId)>,
    /// Topic and content of each different transform and calibration message so far.
    constants: Vec<(String, Vec<u8>)>,
    frames: u64,
    messages: u64,
}

impl LogCopy {
    fn create(path: &Path) -> Result<Self, CutError> {
        let file = File::create(path).map_err(|source| io(path, source))?;
        let writer = LogWriter::new(BufWriter::with_capacity(1 << 20, file))
            .map_err(|source| CutError::Write { path: path.to_owned(), source })?;
        Ok(Self {
            path: path.to_owned(),
            writer: Some(writer),
            channels: Vec::new(),
            constants: Vec::new(),
            frames: 0,
            messages: 0,
        })
    }

    fn attach(&mut self, state: &[u8]) -> Result<(), CutError> {
        let Some(writer) = &mut self.writer else { return Ok(()) };
        writer
            .attach(topics::CHECKPOINT_ATTACHMENT, "application/octet-stream", 0, state)
            .map_err(|source| CutError::Write { path: self.path.clone(), source })
    }

    fn has(&self, message: &LogMessage) -> bool {
        self.constants.iter().any(|(topic, data)| *topic == message.channel.topic && *data == message.data)
    }

    fn take(&mut self, message: &LogMessage) -> Result<(), CutError> {
        let failed = |source| CutError::Write { path: self.path.clone(), source };
        let Some(writer) = &mut self.writer else { return Ok(()) };
        let channel = &message.channel;
        let key = (channel.topic.clone(), channel.type_name.clone());
        let id = match self.channels.iter().find(|(known, _)| *known == key) {
            Some((_, id)) => *id,
            None => {
                let id = writer.add_raw_channel(&RawChannel::from(channel.as_ref())).map_err(failed)?;
                self.channels.push((key, id));
                id
            }
        };
        let LogMessage { sequence, log_time_ns, publish_time_ns, data, .. } = message;
        writer.write(id, *sequence, *log_time_ns, *publish_time_ns, data).map_err(failed)?;
        let is_constant = ["tf2_msgs/msg/TFMessage", "sensor_msgs/msg/CameraInfo"];
        if is_constant.contains(&channel.type_name.as_str())
            && !self.has(message)
            && self.constants.len() < MAX_CONSTANTS
        {
            self.constants.push((channel.topic.clone(), data.clone()));
        }
        self.messages += 1;
        self.frames += u64::from(is_frame(message));
        Ok(())
    }

    fn finish(mut self) -> Result<Self, CutError> {
        if let Some(writer) = self.writer.take() {
            writer.finish().map_err(|source| CutError::Write { path: self.path.clone(), source })?;
        }
        Ok(self)
    }
}

/// Most constant messages that are remembered, which is as many as a segment repeats.
const MAX_CONSTANTS: usize = 256;

fn io(path: &Path, source: std::io::Error) -> CutError {
    CutError::Io { path: path.to_owned(), source }
}
