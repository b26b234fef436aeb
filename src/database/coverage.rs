//! Which poses a database has images of: cells of x, y and yaw, filled or missing.

use core::f64::consts::TAU;

use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};
use serde::Serialize;

use super::index::Index;
use crate::geometry::{Field, Pose2};

/// Filled cells of a grid over the carpet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Coverage {
    pub cell_m: f64,
    pub sectors: usize,
    pub columns: usize,
    pub rows: usize,
    pub cells: usize,
    pub filled: usize,
    /// Images that lie off the carpet.
    pub outside: usize,
    /// How many images each cell has: by row, column, sector.
    #[serde(skip)]
    pub counts: Vec<u32>,
    #[serde(skip)]
    half: DVec2,
}

const CELL_PX: usize = 26;
const MISSING: [u8; 3] = [222, 226, 222];
const CARPET: [u8; 3] = [246, 248, 246];
const LINE: [u8; 3] = [120, 150, 120];
/// One image, and many.
const ONE: [f64; 3] = [150.0, 205.0, 150.0];
const MANY: [f64; 3] = [10.0, 95.0, 45.0];

pub fn coverage(index: &Index, field: &Field, cell_m: f64, sectors: usize) -> Coverage {
    let half = field.carpet_half_extent();
    let count = |half: f64| (libm::ceil(2.0 * half / cell_m) as usize).max(1);
    let (columns, rows) = (count(half.x), count(half.y));
    let mut coverage = Coverage {
        cell_m,
        sectors,
        columns,
        rows,
        cells: columns * rows * sectors,
        filled: 0,
        outside: 0,
        counts: vec![0; columns * rows * sectors],
        half,
    };
    for record in index.records() {
        let pose = record.pose();
        let Pose2 { x, y, .. } = Pose2::from_isometry(&pose);
        let forward = pose.transform_vector(DVec3::X);
        match coverage.cell(x, y, libm::atan2(forward.y, forward.x)) {
            Some(cell) => coverage.counts[cell] += 1,
            None => coverage.outside += 1,
        }
    }
    coverage.filled = coverage.counts.iter().filter(|count| **count > 0).count();
    coverage
}

impl Coverage {
    fn cell(&self, x: f64, y: f64, yaw: f64) -> Option<usize> {
        let at = (DVec2::new(x, y) + self.half) / self.cell_m;
        let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < self.columns as f64 && at.y < self.rows as f64;
        inside.then(|| ((at.y as usize) * self.columns + at.x as usize) * self.sectors + self.sector(yaw))
    }

    fn sector(&self, yaw: f64) -> usize {
        let turn = (yaw / TAU).rem_euclid(1.0);
        ((turn * self.sectors as f64) as usize).min(self.sectors - 1)
    }

    /// The field from above, y up; each cell a disc whose sectors are the headings, dark where there are images.
    pub fn picture(&self, field: &Field) -> RgbImage {
        let (width, height) = (self.columns * CELL_PX, self.rows * CELL_PX);
        let most = self.counts.iter().copied().max().unwrap_or(0).max(2);
        let pixel = |u: u32, v: u32| {
            let (u, v) = (u as usize, height - 1 - v as usize);
            let place = DVec2::new(u as f64 + 0.5, v as f64 + 0.5) / CELL_PX as f64 * self.cell_m - self.half;
            let half_pixel = 0.7 * self.cell_m / CELL_PX as f64;
            let off =
                DVec2::new((u % CELL_PX) as f64 + 0.5, (v % CELL_PX) as f64 + 0.5) - DVec2::splat(CELL_PX as f64 / 2.0);
            if field.distance_to_centre_line(place) <= (field.line_width() / 4.0).max(half_pixel) {
                return Rgb(LINE);
            }
            if off.length() > CELL_PX as f64 / 2.0 - 1.5 {
                return Rgb(CARPET);
            }
            let cell = ((v / CELL_PX) * self.columns + u / CELL_PX) * self.sectors;
            match self.counts[cell + self.sector(libm::atan2(off.y, off.x))] {
                0 => Rgb(MISSING),
                count => {
                    let share = libm::log(f64::from(count)) / libm::log(f64::from(most));
                    Rgb(core::array::from_fn(|c| (ONE[c] + (MANY[c] - ONE[c]) * share.min(1.0)) as u8))
                }
            }
        };
        RgbImage::from_fn(width as u32, height as u32, pixel)
    }
}
