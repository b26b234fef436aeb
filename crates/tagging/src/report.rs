//! The report of a finished replay.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use realitysim_log_input::topic_resolution::TopicChoice;
use realitysim_recording::Loss;
use realitysim_ros2::mcap_read::Damage;

/// The result of a replay, which `realitysim replay --json` prints.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ReplayReport {
    /// Folder of the session.
    pub session: PathBuf,
    /// The topics that were read, and why each was chosen.
    pub read: Vec<TopicChoice>,
    /// Number of frames written.
    pub frames: u64,
    /// Number of frames tagged.
    pub tagged: u64,
    /// Number of valid tags.
    pub valid: u64,
    /// Number of poses that were predicted from odometry while no frame came.
    pub predicted: u64,
    /// Number of frames that were tagged but not written, as `recording.thinning` asks.
    pub thinned: u64,
    /// Number of particles of each iteration.
    pub particles: usize,
    /// Number of iterations of the filter for each frame.
    pub iterations: usize,
    /// Whether `particles` and `iterations` are upper bounds and each frame may have had fewer.
    pub adaptive: bool,
    /// Number of frames with fewer particles or iterations than wanted because time was up.
    pub capped: u64,
    /// Number of frames that took longer than the budget.
    pub over_budget: u64,
    /// Number of threads that looked at images.
    pub threads: usize,
    /// Time from the decoded image to the tag, milliseconds.
    pub filter_ms: Quantiles,
    /// Duration of the replay, seconds.
    pub wall_s: f64,
    /// Number of invalid tags by reason.
    pub invalid: BTreeMap<String, u64>,
    /// The first frame with each reason, counted from 0.
    pub first_invalid: BTreeMap<String, u64>,
    /// Number of frames that could have no tag, by cause.
    pub untagged: BTreeMap<String, u64>,
    /// Number of messages, other than frames, that do not decode as their type.
    pub bad_messages: u64,
    /// Number of measurements that came too late to be sorted in.
    pub late_measurements: u64,
    /// Number of measurements with physically impossible numbers. They are recorded, but not used.
    pub impossible_measurements: u64,
    /// Description of the first image that could not be used, if any.
    pub first_bad_image: Option<String>,
    /// What makes tags worse than they could be, and what else a user will want to know.
    pub warnings: Vec<String>,
    /// Parts of a capture that are missing.
    pub lost: Vec<Loss>,
    /// Files of which parts were lost.
    pub damage: Vec<FileDamage>,
}

/// Quantiles of durations, milliseconds.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Maximum.
    pub max: f64,
}

/// What could not be read of one MCAP file.
#[derive(Clone, Debug, Serialize)]
pub struct FileDamage {
    /// The file.
    pub file: PathBuf,
    /// Whether the end of the file is missing.
    pub torn: bool,
    /// Number of chunks that could not be read.
    pub bad_chunks: u64,
    /// Number of records that could not be read.
    pub bad_records: u64,
    /// Number of bytes that belong to no readable record.
    pub bytes_skipped: u64,
    /// The first error, if any.
    pub first_error: Option<String>,
}

impl ReplayReport {
    /// All losses of the source: missing parts and damaged files.
    pub fn unread(&self) -> Vec<Loss> {
        let damaged = self.damage.iter().map(|damage| Loss::new(&damage.file, damage.to_string()));
        self.lost.iter().cloned().chain(damaged).collect()
    }

    /// Whether there were frames and none of them has a valid tag.
    pub fn is_in_vain(&self) -> bool {
        self.tagged > 0 && self.valid == 0
    }

    /// Whether a part of the source could not be replayed.
    pub fn data_was_lost(&self) -> bool {
        !(self.damage.is_empty() && self.lost.is_empty())
            || self.tagged < self.frames + self.thinned
            || self.bad_messages > 0
            || self.late_measurements > 0
            || self.first_bad_image.is_some()
    }
}

impl core::fmt::Display for FileDamage {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let what = self.first_error.as_deref().unwrap_or("its end is missing");
        write!(f, "damaged ({what}): {} bad chunks, {} bytes not used", self.bad_chunks, self.bytes_skipped)
    }
}

pub(super) fn file_damage(file: &Path, damage: &Damage) -> FileDamage {
    FileDamage {
        file: file.to_owned(),
        torn: damage.torn,
        bad_chunks: damage.bad_chunks,
        bad_records: damage.bad_records,
        bytes_skipped: damage.bytes_skipped,
        first_error: damage.first_error.clone(),
    }
}
