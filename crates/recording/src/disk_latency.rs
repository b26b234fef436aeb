//! How long the disk stalls at worst, as `doctor` has measured it, and how much memory the queue of frames needs for
//! that.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use super::session_writer::mebibytes;
use super::storage::{Storage, read_small, write_atomically};
use realitysim_config::RecordingSettings;

/// File with a [`DiskMeasured`], in the folder of all captures.
pub const DISK_FILE: &str = "disk.json";

/// Measurement of the disk by `doctor`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DiskMeasured {
    /// Size of the blocks that were written, bytes.
    pub block_bytes: u64,
    /// Typical time to write and sync a block, ms.
    pub typical_ms: f64,
    /// Longest time to write and sync a block, ms.
    pub worst_ms: f64,
}

/// Largest `disk.json`, bytes.
const MAX_DISK_FILE_BYTES: u64 = 4096;
/// Memory of the queue without a measurement, MiB.
const QUEUE_MB: u64 = 64;
/// Least and greatest memory that a measurement asks for, MiB.
const QUEUE_MB_RANGE: [f64; 2] = [32.0, 512.0];

impl DiskMeasured {
    /// Writes the measurement into the folder of all captures.
    pub fn save(&self, storage: &dyn Storage, captures: &Path) -> Result<(), RecordingError> {
        write_atomically(storage, &captures.join(DISK_FILE), &serde_json::to_vec(self)?)
    }

    /// Reads the measurement; `None` if there is none, or none that makes sense.
    pub fn load(storage: &dyn Storage, captures: &Path) -> Option<Self> {
        let bytes = read_small(storage, &captures.join(DISK_FILE), MAX_DISK_FILE_BYTES).ok()??;
        let measured: Self = serde_json::from_slice(&bytes).ok()?;
        (measured.worst_ms.is_finite() && measured.worst_ms >= 0.0).then_some(measured)
    }

    /// Memory for frames, MiB: the setting, or without one twice what arrives during the worst stall, since a second
    /// stall may follow before the first is worked off.
    ///
    /// `bytes_per_s` is the rate at which frames arrive, bytes a second.
    pub fn queue_mb(&self, settings: &RecordingSettings, bytes_per_s: u64) -> u64 {
        match settings.queue_mb {
            0 => (2.0 * self.stalled_mb(bytes_per_s)).ceil().clamp(QUEUE_MB_RANGE[0], QUEUE_MB_RANGE[1]) as u64,
            set => set,
        }
    }

    /// Whether a queue of `queue_mb` MiB holds what arrives during the worst stall.
    pub fn fits(&self, queue_mb: u64, bytes_per_s: u64) -> bool {
        self.stalled_mb(bytes_per_s) <= queue_mb as f64
    }

    /// What arrives during the worst stall, MiB.
    fn stalled_mb(&self, bytes_per_s: u64) -> f64 {
        bytes_per_s as f64 * self.worst_ms / 1e3 / f64::from(1 << 20)
    }
}

/// Memory for frames, bytes, from the settings and the measurement of this disk.
pub(super) fn queue_bytes(
    storage: &dyn Storage,
    captures: &Path,
    settings: &RecordingSettings,
    bytes_per_s: u64,
) -> usize {
    let usual = if settings.queue_mb == 0 { QUEUE_MB } else { settings.queue_mb };
    let measured = DiskMeasured::load(storage, captures);
    mebibytes(measured.map_or(usual, |measured| measured.queue_mb(settings, bytes_per_s)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_queue_holds_twice_the_worst_stall() {
        let measured = |worst_ms| DiskMeasured { block_bytes: 1, typical_ms: 1.0, worst_ms };
        let mut settings = RecordingSettings::default();
        assert_eq!(measured(1000.0).queue_mb(&settings, 40 << 20), 80);
        assert_eq!(measured(1.0).queue_mb(&settings, 3 << 20), 32, "never less");
        assert_eq!(measured(60_000.0).queue_mb(&settings, 40 << 20), 512, "never more");
        assert!(!measured(60_000.0).fits(512, 40 << 20) && measured(1000.0).fits(40, 40 << 20));
        settings.queue_mb = 7;
        assert_eq!(measured(1000.0).queue_mb(&settings, 40 << 20), 7, "as it is set");
    }
}
