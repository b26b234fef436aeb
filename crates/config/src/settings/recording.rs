//! `[recording]`: segments, memory, room on the disk.

use serde::{Deserialize, Serialize};

use super::thinning::ThinningSettings;
use super::within;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingSettings {
    /// A segment ends after this time ...
    pub segment_s: u64,
    /// ... or this size, whichever comes first.
    pub segment_mb: u64,
    /// How often what was written is forced onto the disk.
    pub sync_interval_ms: u64,
    /// Memory for frames that wait for the disk; 0: twice what comes in `doctor`'s worst stall.
    pub queue_mb: u64,
    /// Beside it, for odometry, attitude and tags alone.
    pub reserve_mb: u64,
    /// Frames are no longer recorded with less than this free on the disk ...
    pub floor_mb: u64,
    /// ... or less than this share of it.
    pub floor_percent: f64,
    /// The most that a session may take; 0: no limit.
    pub session_mb: u64,
    /// The most that all sessions may take; 0: no limit.
    pub total_mb: u64,
    pub thinning: ThinningSettings,
}

impl RecordingSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        within("recording.segment_s", self.segment_s as f64, 1.0, 86_400.0)?;
        within("recording.segment_mb", self.segment_mb as f64, 1.0, 65_536.0)?;
        within("recording.queue_mb", self.queue_mb as f64, 0.0, 16_384.0)?;
        within("recording.reserve_mb", self.reserve_mb as f64, 1.0, 4096.0)?;
        within("recording.floor_mb", self.floor_mb as f64, 0.0, 1e9)?;
        within("recording.floor_percent", self.floor_percent, 0.0, 100.0)?;
        within("recording.session_mb", self.session_mb as f64, 0.0, 1e9)?;
        within("recording.total_mb", self.total_mb as f64, 0.0, 1e9)?;
        within("recording.sync_interval_ms", self.sync_interval_ms as f64, 10.0, 60_000.0)?;
        self.thinning.check()
    }
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self {
            segment_s: 60,
            segment_mb: 256,
            sync_interval_ms: 500,
            queue_mb: 0,
            reserve_mb: 64,
            floor_mb: 512,
            floor_percent: 5.0,
            session_mb: 0,
            total_mb: 0,
            thinning: ThinningSettings::default(),
        }
    }
}
