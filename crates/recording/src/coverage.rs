//! `coverage.json`: which cells of the pose grid a session has images of.

use std::path::Path;

use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::error::RecordingError;
use super::storage::read_plain;
use super::write_atomically;
use realitysim_geometry::PoseGrid;

/// File in a session's folder with the number of images in each cell of the pose grid.
pub const COVERAGE_FILE: &str = "coverage.json";

/// Content of `coverage.json`.
#[derive(Serialize, Deserialize)]
struct Stored {
    cell_m: f64,
    headings: usize,
    half_extent_m: [f64; 2],
    /// Number of valid tags when the file was written. Another number means that the file covers only a part of the
    /// session.
    valid: u64,
    /// Images of each cell, by row, column, heading.
    images: Vec<u32>,
}

/// Largest `coverage.json`, bytes: a grid of the finest cells of the largest field.
const MAX_COVERAGE_BYTES: u64 = 256 << 20;
/// Largest number of headings that a stored grid may tell apart.
const MAX_HEADINGS: usize = 360;

/// Writes `coverage.json` into a session's folder; `valid` is the number of valid tags that the grid was made of.
pub fn write_coverage(session: &Path, grid: &PoseGrid, valid: u64) -> Result<(), RecordingError> {
    let half_extent_m = grid.half_extent().to_array();
    let (cell_m, headings, images) = (grid.cell_m, grid.sectors, grid.counts().to_vec());
    let stored = Stored { cell_m, headings, half_extent_m, valid, images };
    write_atomically(&session.join(COVERAGE_FILE), &serde_json::to_vec(&stored)?)
}

/// Reads `coverage.json`; `None` if there is none, if it makes no sense, or if it was made of another number of valid
/// tags.
pub fn read_coverage(session: &Path, valid: u64) -> Option<PoseGrid> {
    let bytes = read_plain(&session.join(COVERAGE_FILE), MAX_COVERAGE_BYTES).ok()?;
    let stored: Stored = serde_json::from_slice(&bytes).ok()?;
    let half = DVec2::from_array(stored.half_extent_m);
    let possible = (0.02..=5.0).contains(&stored.cell_m)
        && (1..=MAX_HEADINGS).contains(&stored.headings)
        && (0.0..=200.0).contains(&half.x)
        && (0.0..=200.0).contains(&half.y);
    if !possible || stored.valid != valid {
        return None;
    }
    PoseGrid::with_counts(half, stored.cell_m, stored.headings, stored.images)
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_geometry::Pose2;

    #[test]
    fn it_comes_back_as_it_was_and_not_if_it_is_of_another_state() {
        let folder = tempfile::tempdir().unwrap();
        let mut grid = PoseGrid::new(DVec2::new(3.0, 2.0), 0.5, 8);
        grid.add(&Pose2::new(1.0, 0.5, 2.0).to_isometry());
        write_coverage(folder.path(), &grid, 1).unwrap();
        assert_eq!(read_coverage(folder.path(), 1), Some(grid));
        assert_eq!(read_coverage(folder.path(), 2), None);
        for text in ["", "{}", r#"{"cell_m":1e-9,"headings":8,"half_extent_m":[3,2],"valid":1,"images":[]}"#] {
            std::fs::write(folder.path().join(COVERAGE_FILE), text).unwrap();
            assert_eq!(read_coverage(folder.path(), 1), None, "{text}");
        }
    }
}
