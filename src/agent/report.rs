//! What a replay says when it is done.

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::ros2::mcap_read::Damage;

/// What `replay` prints.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ReplayReport {
    pub session: PathBuf,
    pub frames: u64,
    pub tagged: u64,
    pub valid: u64,
    pub particles: usize,
    pub iterations: usize,
    pub threads: usize,
    /// From the decoded image to the tag.
    pub filter_ms: Quantiles,
    pub wall_s: f64,
    /// Why tags are invalid, and how many.
    pub invalid: std::collections::BTreeMap<String, u64>,
    /// Messages whose bytes are not what their type says.
    pub bad_messages: u64,
    /// First image that did not decode, if any.
    pub first_bad_image: Option<String>,
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
    /// Something of the source could not be replayed.
    pub fn data_was_lost(&self) -> bool {
        !self.damage.is_empty() || self.bad_messages > 0 || self.first_bad_image.is_some()
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

pub(super) fn quantiles(values: &mut [f32]) -> Quantiles {
    values.sort_by(f32::total_cmp);
    let at = |share: f64| {
        let index = ((values.len().saturating_sub(1)) as f64 * share).round() as usize;
        values.get(index).map_or(0.0, |value| f64::from(*value))
    };
    Quantiles { p50: at(0.5), p99: at(0.99), max: at(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_few_values() {
        assert_eq!(quantiles(&mut []).max, 0.0);
        let q = quantiles(&mut [3.0, 1.0, 2.0]);
        assert_eq!((q.p50, q.max), (2.0, 3.0));
    }
}
