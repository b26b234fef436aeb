//! What a replay says when it is done.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use realitysim_recording::Loss;
use realitysim_ros2::mcap_read::Damage;

/// What `replay` prints.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ReplayReport {
    pub session: PathBuf,
    pub frames: u64,
    pub tagged: u64,
    pub valid: u64,
    /// Poses for which there was no frame, from odometry.
    pub predicted: u64,
    /// Tagged and not written, as `recording.thinning` asks.
    pub thinned: u64,
    pub particles: usize,
    pub iterations: usize,
    /// Particles and iterations are the most, not what each frame had.
    pub adaptive: bool,
    /// Frames with fewer particles or rounds than wanted: time was up.
    pub capped: u64,
    /// Frames that took longer than the budget all the same.
    pub over_budget: u64,
    pub threads: usize,
    /// From the decoded image to the tag.
    pub filter_ms: Quantiles,
    pub wall_s: f64,
    /// Why tags are invalid, and how many.
    pub invalid: BTreeMap<String, u64>,
    /// Of each reason the first frame, counted from 0.
    pub first_invalid: BTreeMap<String, u64>,
    /// Frames that could have no tag, by cause.
    pub untagged: BTreeMap<String, u64>,
    /// Messages, other than frames, whose bytes are not what their type says.
    pub bad_messages: u64,
    /// Measurements that came too late to be sorted in.
    pub late_measurements: u64,
    /// Measurements that no robot can have made, by their numbers: recorded, not used.
    pub impossible_measurements: u64,
    /// First image that did not decode, if any.
    pub first_bad_image: Option<String>,
    /// What makes tags worse than they need be, and what else a user will want to know.
    pub warnings: Vec<String>,
    /// Parts of a capture that are not there.
    pub lost: Vec<Loss>,
    /// Files of which parts were lost.
    pub damage: Vec<FileDamage>,
}

#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Quantiles {
    pub p50: f64,
    pub p99: f64,
    pub max: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct FileDamage {
    pub file: PathBuf,
    pub torn: bool,
    pub bad_chunks: u64,
    pub bad_records: u64,
    pub bytes_skipped: u64,
    pub first_error: Option<String>,
}

impl ReplayReport {
    /// What of the source's files could not be read.
    pub fn unread(&self) -> Vec<Loss> {
        let damaged = self.damage.iter().map(|damage| Loss::new(&damage.file, damage.to_string()));
        self.lost.iter().cloned().chain(damaged).collect()
    }

    /// There were frames, and not one of them was placed.
    pub fn is_in_vain(&self) -> bool {
        self.tagged > 0 && self.valid == 0
    }

    /// Something of the source could not be replayed.
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
