//! Recordings on disk that survive power cuts, and their transfer to another machine.
//!
//! A capture is the folder of one session: segments (MCAP files), a manifest with their hashes, and `session.json`.
//! [`SessionWriter`] writes it. On a robot it does so in a thread of its own: entries go through a bounded queue to
//! the recorder, which keeps each of them until the disk has confirmed it. [`repair()`] makes a session whole that a
//! power cut has left, [`verify()`] compares it with its manifest, and [`read_tags`] reads it back. [`sync`] copies
//! sessions to another machine, which acknowledges them. Only what was acknowledged is deleted to make room
//! ([`releasable`]). [`storage`] separates all this from the disk, so that the tests can simulate one that fails.
//!
//! Layout and order of writes: docs/reference/formats.md. What is promised, and how that is tested: docs/explanation/recording.md.
//!
//! ```rust
//! # use std::sync::Arc;
//! # use realitysim_ros2::messages::FrameTag;
//! use realitysim_config::{Settings, load_field, load_lens};
//! use realitysim_recording::storage::Disk;
//! use realitysim_recording::{FORMAT_VERSION, SegmentState, SessionInfo, SessionWriter, Writing, read_tags};
//!
//! let captures = tempfile::tempdir()?;
//! let (field, lens) = (load_field("kid-2020")?, load_lens("fisheye-640")?.lens.parameters().clone());
//! let [software, robot, started] = ["example", "robot-1", "2026-01-01T00:00:00Z"].map(str::to_owned);
//! let (settings, body_masks) = (Settings::default(), Vec::new());
//! let format = FORMAT_VERSION;
//! let info =
//!     SessionInfo { format, id: None, software, robot, started, source: None, settings, field, lens, body_masks, live: None };
//! let state = SegmentState { log_time_ns: 0, name: "filter_state", state: vec![0; 8] };
//! let mut session = SessionWriter::create(Arc::new(Disk), captures.path(), "first", &info, state, Writing::Here)?;
//! session.tag(1_000_000, "map", &FrameTag::default())?;
//! let folder = session.finish().folder?;
//! assert_eq!(read_tags(&folder)?.found.len(), 1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod acknowledgement;
mod coverage;
mod deletion_rules;
mod disk_latency;
mod distinct_folders;
mod entry;
mod error;
mod folder;
mod folder_lock;
mod gap;
mod hashing;
mod identity;
mod manifest;
mod record_queue;
mod recorded_settings;
mod recorder;
mod refined;
mod repair;
mod retention;
mod segment;
mod session_writer;
pub mod sessions;
#[cfg(test)]
mod simulation;
mod source_hash;
mod status;
pub mod storage;
pub mod sync;
mod sync_schedule;
mod tags;
mod thinning;
mod verify;
mod writer;

use std::path::Path;

pub use acknowledgement::{
    ACK_ENDING, ACK_FOLDER, Acknowledged, Acknowledgement, RECEIVER_FILE, SYNC_FOLDER, acknowledge, is_receiver,
    receiver_of, receivers_of, silence,
};
pub use coverage::{COVERAGE_FILE, read_coverage, write_coverage};
pub use deletion_rules::{Releasable, releasable};
pub use disk_latency::{DISK_FILE, DiskMeasured};
pub use distinct_folders::{NotDistinct, is_probe, prove_distinct};
pub use error::{REMOVED, RecordingError, cannot_be_made};
pub use folder::{Loss, missing_parts, read_info, session_holding};
pub use folder_lock::FolderLock;
pub use identity::{Head, SessionId, robot_id};
pub use manifest::{
    Counts, EVICTED_FILE, FORMAT_VERSION, LiveInfo, MANIFEST_FILE, METADATA_FILE, ManifestLine, PIN_FILE, PoseBox,
    RECEIVED_FILE, REFINED_FOLDER, SESSION_FILE, SessionInfo, saturating_sum,
};
pub use recorder::folder_name;
pub use refined::{REFINED_INFO, REFINED_TAGS, RefinedConstant, RefinedInfo, refined_info};
pub use repair::{Repaired, repair, sessions_of};
pub use retention::Evicted;
pub use segment::{ACTIVE, is_segment_name};
pub use session_writer::{Ended, SegmentState, SessionWriter, Writing, camera_transforms};
pub use sessions::{Received, Session, SetAside};
pub use source_hash::{recorded_hash, source_hash};
pub use status::{Fault, RecorderStatus, Stopped};
pub use sync_schedule::loss_bound_ms;
pub use tags::{Readout, ReadoutError, losses, read_tags, read_topic};
pub use thinning::Thinning;
pub use verify::{Verified, verify};
pub use writer::MAX_FINISH;

/// Names the captures in a folder of captures, as the end of an error message for a caller who gave the folder in
/// place of one of them. It is empty if there are none.
pub fn captures_within(folder: &Path) -> String {
    const MAX_NAMED: usize = 5;
    let sessions = sessions_of(&storage::Disk, folder);
    let names: Vec<String> = sessions.iter().take(MAX_NAMED).map(|path| path.display().to_string()).collect();
    match (names.as_slice(), sessions.len() - names.len()) {
        ([], _) => String::new(),
        ([name], _) => format!("; name the capture in it, {name}"),
        (names, 0) => format!("; name one of the captures in it: {}", names.join(", ")),
        (names, more) => format!("; name one of the captures in it: {} and {more} more", names.join(", ")),
    }
}

/// File in the folder of all captures with the state that a run of the filter leaves for the next one.
pub const STATE_FILE: &str = "last_state.bin";

/// Replaces a file as a whole: a power cut leaves the old content or the new.
pub fn write_atomically(path: &Path, content: &[u8]) -> Result<(), RecordingError> {
    storage::write_atomically(&storage::Disk, path, content)
}

/// Makes created, renamed and removed names in a folder survive a power cut.
pub fn sync_folder(folder: &Path) -> Result<(), RecordingError> {
    use storage::Storage;
    storage::Disk.sync_folder(folder).map_err(|source| RecordingError::io(folder, source))
}
