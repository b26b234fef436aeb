//! Captures on disk: a session's folder, its segments, its manifest. Layout and order of writes: docs/formats.md; what is
//! promised of them, and how it is tested: docs/recording.md.

mod acknowledgement;
pub mod catalogue;
mod coverage;
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
mod recorder;
mod refined;
mod release;
mod repair;
mod retention;
mod segment;
mod session;
#[cfg(test)]
mod simulation;
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
    ACK_ENDING, ACK_FOLDER, Acknowledged, Acknowledgement, RECEIVER_FILE, SYNC_FOLDER, is_receiver, receiver_of,
    receivers_of, silence,
};
pub use catalogue::{Received, Session, SetAside};
pub use coverage::{COVERAGE_FILE, read_coverage, write_coverage};
pub use disk_latency::{DISK_FILE, DiskMeasured};
pub use distinct_folders::{NotApart, is_probe, prove_apart};
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
pub use release::{Releasable, releasable};
pub use repair::{Repaired, repair, sessions_of};
pub use retention::Evicted;
pub use segment::{ACTIVE, is_segment_name};
pub use session::{Ended, SegmentState, SessionWriter, Writing};
pub use status::{Fault, RecorderStatus, Stopped};
pub use sync_schedule::loss_bound_ms;
pub use tags::{Readout, ReadoutError, losses, read_tags, read_topic};
pub use thinning::Thinning;
pub use verify::{Verified, verify};
pub use writer::MAX_FINISH;

/// For whoever has named the folder of all captures where one of them was meant: which there are, behind a semicolon.
pub fn captures_within(folder: &Path) -> String {
    const MOST_NAMED: usize = 5;
    let sessions = sessions_of(&storage::Disk, folder);
    let names: Vec<String> = sessions.iter().take(MOST_NAMED).map(|path| path.display().to_string()).collect();
    match (names.as_slice(), sessions.len() - names.len()) {
        ([], _) => String::new(),
        ([name], _) => format!("; name the capture in it, {name}"),
        (names, 0) => format!("; name one of the captures in it: {}", names.join(", ")),
        (names, more) => format!("; name one of the captures in it: {} and {more} more", names.join(", ")),
    }
}

/// The state that a run of the filter leaves behind for the next one, in the folder of all captures.
pub const STATE_FILE: &str = "last_state.bin";

/// The old content or the new, never a part.
pub fn write_atomically(path: &Path, content: &[u8]) -> Result<(), RecordingError> {
    storage::write_atomically(&storage::Disk, path, content)
}

/// Makes created, renamed and removed names survive a power cut.
pub fn sync_folder(folder: &Path) -> Result<(), RecordingError> {
    use storage::Storage;
    storage::Disk.sync_folder(folder).map_err(|source| RecordingError::io(folder, source))
}
