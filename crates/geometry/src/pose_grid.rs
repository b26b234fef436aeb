//! A grid of x, y and heading over the carpet that counts the images taken from each cell.

use core::f64::consts::TAU;

use glam::{DVec2, DVec3};
use serde::Serialize;

use super::Isometry;

/// Number of images for each position and heading of a camera, over the carpet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseGrid {
    /// Side of a cell, metres.
    pub cell_m: f64,
    /// Number of headings that are told apart; sector 0 begins at x, the next lie towards y.
    pub sectors: usize,
    /// Number of cells along x.
    pub columns: usize,
    /// Number of cells along y.
    pub rows: usize,
    /// Number of cells: columns x rows x sectors.
    pub cells: usize,
    /// Number of cells with at least one image.
    pub filled: usize,
    /// Number of images whose camera was off the carpet.
    pub outside: usize,
    /// Number of images of each cell, ordered by row, column, sector.
    #[serde(skip)]
    counts: Vec<u32>,
    /// Half the extent of the carpet along x and y, metres.
    #[serde(skip)]
    half: DVec2,
}

impl PoseGrid {
    /// Makes an empty grid over a carpet of half extent `half` (metres), with cells of side `cell_m` > 0 and `sectors` > 0 headings.
    pub fn new(half: DVec2, cell_m: f64, sectors: usize) -> Self {
        let count = |half: f64| (libm::ceil(2.0 * half / cell_m) as usize).max(1);
        let (columns, rows) = (count(half.x), count(half.y));
        let cells = columns * rows * sectors;
        Self { cell_m, sectors, columns, rows, cells, filled: 0, outside: 0, counts: vec![0; cells], half }
    }

    /// Makes a grid from counts as [`Self::counts`] gives them; `None` if their number does not fit the grid.
    pub fn with_counts(half: DVec2, cell_m: f64, sectors: usize, counts: Vec<u32>) -> Option<Self> {
        let grid = Self::new(half, cell_m, sectors);
        let filled = counts.iter().filter(|count| **count > 0).count();
        (counts.len() == grid.cells).then_some(Self { filled, counts, ..grid })
    }

    /// Counts one more image, taken from this pose of `camera_link` in `map`.
    pub fn add(&mut self, pose: &Isometry) {
        match self.cell_of(pose) {
            Some(cell) => {
                self.filled += usize::from(self.counts[cell] == 0);
                self.counts[cell] = self.counts[cell].saturating_add(1);
            }
            None => self.outside += 1,
        }
    }

    /// Number of images in the cell of a pose of `camera_link` in `map`; `None` off the carpet.
    pub fn images_at(&self, pose: &Isometry) -> Option<u32> {
        self.cell_of(pose).map(|cell| self.counts[cell])
    }

    /// Number of images of each cell, ordered by row, column, sector.
    pub fn counts(&self) -> &[u32] {
        &self.counts
    }

    /// Number of images at a column and row, in the sector of a heading in radians.
    pub fn count(&self, column: usize, row: usize, heading: f64) -> u32 {
        self.counts[(row * self.columns + column) * self.sectors + self.sector(heading)]
    }

    /// Half the extent of the carpet along x and y, metres.
    pub fn half_extent(&self) -> DVec2 {
        self.half
    }

    /// Draws the field from above as text, y up, one character for each column and row.
    ///
    /// `.` stands for no image, `#` for images in all headings, else the number of headings that have an image, `+` for ten and more.
    pub fn text(&self) -> Vec<String> {
        let letter = |row: usize, column: usize| {
            let cell = (row * self.columns + column) * self.sectors;
            let seen = self.counts[cell..cell + self.sectors].iter().filter(|count| **count > 0).count();
            match seen {
                0 => '.',
                seen if seen == self.sectors => '#',
                seen => char::from_digit(seen as u32, 10).unwrap_or('+'),
            }
        };
        (0..self.rows).rev().map(|row| (0..self.columns).map(|column| letter(row, column)).collect()).collect()
    }

    /// Draws one sector of headings as text, y up, one character for each column and row.
    ///
    /// The character is the number of images, `.` for none, `+` for ten and more.
    pub fn text_of_sector(&self, sector: usize) -> Vec<String> {
        let letter =
            |row: usize, column: usize| match self.counts[(row * self.columns + column) * self.sectors + sector] {
                0 => '.',
                images => char::from_digit(images, 10).unwrap_or('+'),
            };
        (0..self.rows).rev().map(|row| (0..self.columns).map(|column| letter(row, column)).collect()).collect()
    }

    /// Number of columns and rows that have at least one image in this sector.
    pub fn filled_in_sector(&self, sector: usize) -> usize {
        self.counts.iter().skip(sector).step_by(self.sectors).filter(|count| **count > 0).count()
    }

    /// Index into `counts` of the cell of a pose; `None` off the carpet.
    fn cell_of(&self, pose: &Isometry) -> Option<usize> {
        let at = (pose.translation.truncate() + self.half) / self.cell_m;
        let forward = pose.transform_vector(DVec3::X);
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < self.columns as f64 && at.y < self.rows as f64;
        inside.then(|| {
            let heading = libm::atan2(forward.y, forward.x);
            ((at.y as usize) * self.columns + at.x as usize) * self.sectors + self.sector(heading)
        })
    }

    /// Index of the sector of a heading in radians.
    fn sector(&self, heading: f64) -> usize {
        let turn = (heading / TAU).rem_euclid(1.0);
        ((turn * self.sectors as f64) as usize).min(self.sectors - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Pose2;

    #[test]
    fn the_map_shows_headings_seen_with_y_up() {
        let mut grid = PoseGrid::new(DVec2::new(1.5, 1.0), 1.0, 4);
        let mut add = |x: f64, y: f64, yaw: f64| grid.add(&Pose2::new(x, y, yaw).to_isometry());
        for yaw in [0.1, 1.7, 3.2, -0.1] {
            add(-1.0, -0.5, yaw);
        }
        add(1.2, 0.5, 0.1);
        add(1.2, 0.5, 0.2);
        add(9.0, 0.0, 0.0);
        assert_eq!(grid.text(), ["..1", "#.."]);
        assert_eq!((grid.filled, grid.outside, grid.cells), (5, 1, 24));
        assert_eq!([0, 1].map(|sector| grid.text_of_sector(sector)), [["..2", "1.."], ["...", "1.."]]);
        assert_eq!([0, 1, 2, 3].map(|sector| grid.filled_in_sector(sector)), [2, 1, 1, 1]);
        assert_eq!(grid.images_at(&Pose2::new(1.0, 0.9, 0.3).to_isometry()), Some(2));
        let again = PoseGrid::with_counts(DVec2::new(1.5, 1.0), 1.0, 4, grid.counts().to_vec()).unwrap();
        assert_eq!((again.filled, again.text()), (grid.filled, grid.text()));
        assert!(PoseGrid::with_counts(DVec2::new(1.5, 1.0), 1.0, 4, vec![0; 5]).is_none());
    }

    #[test]
    fn no_pose_is_beyond_the_last_cell() {
        let mut grid = PoseGrid::new(DVec2::new(0.7, 0.7), 0.5, 3);
        for x in [-0.7, 0.0, 0.69, 0.7, 0.75, f64::NAN, f64::INFINITY] {
            for yaw in [-core::f64::consts::PI, core::f64::consts::PI, -1e-18, core::f64::consts::TAU] {
                grid.add(&Pose2::new(x, 0.1, yaw).to_isometry());
            }
        }
        assert_eq!(grid.counts().iter().sum::<u32>() as usize + grid.outside, 28);
    }
}
