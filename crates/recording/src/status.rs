//! How the recorder is.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

/// For `realitysim status`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RecorderStatus {
    /// Named by whoever shows this, beside it.
    #[serde(skip)]
    pub session: Option<PathBuf>,
    /// In memory: taken, and neither written nor dropped yet.
    pub frames_waiting: u64,
    /// They came here and could not be written: dropped by the recorder, not by the camera.
    pub frames_refused: u64,
    /// The disk has said that it has them.
    pub frames_synced: u64,
    /// Held by what waits and by what is written and not yet synced.
    pub queue_bytes: usize,
    pub queue_limit_bytes: usize,
    /// captured = written + thinned + dropped + waiting.
    pub conserved: bool,
    /// The longest from when a sync was due until the disk had everything, whatever held it up.
    pub worst_stall_ms: f64,
    /// The oldest that anything was when the disk said that it had it: the most that a power cut would have cost so far.
    pub worst_unsynced_ms: f64,
    /// The bound that the sync interval and the worst stall give, but while there is a `fault`.
    pub loss_bound_ms: f64,
    pub fault: Option<Fault>,
    /// What went wrong so far, by cause.
    pub faults: BTreeMap<String, u64>,
    /// Segments that were given up; what was not on the disk was written again into the next one.
    pub segments_given_up: u64,
    pub free_bytes: Option<u64>,
    /// Why frames are not recorded, or nothing is.
    pub stopped: Option<Stopped>,
    pub evicted_segments: u64,
    pub evicted_bytes: u64,
}

/// Why nothing can be written at the moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Fault {
    pub cause: &'static str,
    pub said: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Stopped {
    pub cause: &'static str,
    /// Only frames: tags and measurements are still recorded.
    pub frames_only: bool,
}
