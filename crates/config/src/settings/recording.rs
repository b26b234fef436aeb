//! `[recording]`: the size of segments, memory, and room on the disk.

use serde::{Deserialize, Serialize};

use super::check_range;
use super::thinning::ThinningSettings;

/// How sessions are written. `_mb` are MiB.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingSettings {
    /// Duration after which a segment ends, seconds.
    pub segment_s: u64,
    /// Size at which a segment ends if it comes first, MiB.
    pub segment_mb: u64,
    /// Interval at which written data is forced onto the disk, milliseconds.
    pub sync_interval_ms: u64,
    /// Memory for frames that wait for the disk, MiB; 0: twice what arrives in the worst stall that `doctor` measured.
    pub queue_mb: u64,
    /// Further memory that only odometry, attitude and tags may use, MiB.
    pub reserve_mb: u64,
    /// Free space on the disk below which frames are no longer recorded, MiB.
    pub floor_mb: u64,
    /// Free space below which frames are no longer recorded, percent of the disk.
    pub floor_percent: f64,
    /// Largest size of a session, MiB; 0: no limit.
    pub session_mb: u64,
    /// Largest size of all sessions together, MiB; 0: no limit.
    pub total_mb: u64,
    /// Which frames are written.
    pub thinning: ThinningSettings,
}

impl RecordingSettings {
    pub(super) fn check(&self) -> Result<(), String> {
        check_range("recording.segment_s", self.segment_s as f64, 1.0, 86_400.0)?;
        check_range("recording.segment_mb", self.segment_mb as f64, 1.0, 65_536.0)?;
        check_range("recording.queue_mb", self.queue_mb as f64, 0.0, 16_384.0)?;
        check_range("recording.reserve_mb", self.reserve_mb as f64, 1.0, 4096.0)?;
        check_range("recording.floor_mb", self.floor_mb as f64, 0.0, 1e9)?;
        check_range("recording.floor_percent", self.floor_percent, 0.0, 100.0)?;
        check_range("recording.session_mb", self.session_mb as f64, 0.0, 1e9)?;
        check_range("recording.total_mb", self.total_mb as f64, 0.0, 1e9)?;
        check_range("recording.sync_interval_ms", self.sync_interval_ms as f64, 10.0, 60_000.0)?;
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
