//! State of the recorder, as `realitysim recorder status` shows it.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// State of a recorder at one moment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct RecorderStatus {
    /// Folder of the session. It is not serialized: `status` shows it in a place of its own.
    #[serde(skip)]
    pub session: Option<PathBuf>,
    /// Frames in memory: taken, and neither written nor dropped yet.
    pub frames_waiting: u64,
    /// Frames that arrived and could not be written: dropped by the recorder, not by the camera.
    pub frames_refused: u64,
    /// Frames that the disk has confirmed.
    pub frames_synced: u64,
    /// Memory held by entries that wait, or that are written and not yet synced, bytes.
    pub queue_bytes: usize,
    /// Upper limit of `queue_bytes`, bytes.
    pub queue_limit_bytes: usize,
    /// Whether captured = written + thinned + dropped + waiting.
    pub conserved: bool,
    /// Longest time from when a sync was due until the disk had everything, whatever delayed it, ms.
    pub worst_stall_ms: f64,
    /// Greatest age of an entry when the disk confirmed it, ms: the most that a power cut would have cost so far.
    pub worst_unsynced_ms: f64,
    /// Upper bound of what a power cut costs, ms, from the sync interval and the worst stall. It does not hold while
    /// there is a `fault`.
    pub loss_bound_ms: f64,
    /// The fault that keeps the recorder from writing, if there is one.
    pub fault: Option<Fault>,
    /// Number of faults so far, by cause.
    pub faults: BTreeMap<String, u64>,
    /// Segments that were given up; what was not on the disk was written again into the next one.
    pub segments_given_up: u64,
    /// Free bytes on the disk; `None` if the disk does not say.
    pub free_bytes: Option<u64>,
    /// Why frames, or all messages, are not recorded; `None` while everything is.
    pub stopped: Option<Stopped>,
    /// Segments that were removed to make room.
    pub evicted_segments: u64,
    /// Bytes of the segments that were removed to make room.
    pub evicted_bytes: u64,
}

/// Why nothing can be written at the moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// Name of the cause, as in [`RecordingError::cause`](crate::RecordingError::cause).
    pub cause: String,
    /// Text of the error.
    pub said: String,
}

/// Why the recorder leaves out frames, or everything.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stopped {
    /// Name of the cause, as `disk_full` or `total_quota`.
    pub cause: String,
    /// Whether only frames are left out: tags and measurements are still recorded.
    pub frames_only: bool,
}
