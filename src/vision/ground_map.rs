//! Which pixel shows each cell of the ground table.

use glam::{DVec2, DVec3};

use super::border::CarpetBorder;
use super::ground::SIDE;
use super::mask::BodyMask;
use crate::geometry::{Isometry, Lens};

/// The lens is asked at every fourth cell and interpolated between.
const NODE_STEP: usize = 4;
const NODES: usize = SIDE / NODE_STEP + 1;

/// Which pixel shows each cell: full-size image coordinates, NaN where the camera does not see.
#[derive(Clone, Debug)]
pub struct GroundMap {
    pub(super) pixels: Vec<[f32; 2]>,
    pub(super) range_m: f64,
    pub(super) foot: DVec2,
    pub(super) height_m: f64,
}

impl GroundMap {
    pub fn new(lens: &Lens, footprint_from_optical: &Isometry, range_m: f64) -> Self {
        let optical_from_footprint = footprint_from_optical.inverse();
        let cell = 2.0 * range_m / SIDE as f64;
        let pixel_of = |x: f64, y: f64| -> Option<[f32; 2]> {
            let ray = optical_from_footprint.transform_point(DVec3::new(x, y, 0.0));
            let pixel = lens.project(ray)?;
            lens.contains(pixel).then_some([pixel.x as f32, pixel.y as f32])
        };
        let place = |index: usize| (index as f64 + 0.5) * cell - range_m;
        let looks_down = footprint_from_optical.translation.z > 0.0;
        let nodes: Vec<Option<[f32; 2]>> = (0..NODES * NODES)
            .map(|node| {
                let (row, column) = (node / NODES, node % NODES);
                if looks_down { pixel_of(place(column * NODE_STEP), place(row * NODE_STEP)) } else { None }
            })
            .collect();
        let mut pixels = vec![[f32::NAN; 2]; SIDE * SIDE];
        for block_row in 0..NODES - 1 {
            for block_column in 0..NODES - 1 {
                let node = block_row * NODES + block_column;
                let corners = [nodes[node], nodes[node + 1], nodes[node + NODES], nodes[node + NODES + 1]];
                let first = block_row * NODE_STEP * SIDE + block_column * NODE_STEP;
                match corners {
                    [None, None, None, None] => {}
                    [Some(a), Some(b), Some(c), Some(d)] => {
                        for dv in 0..NODE_STEP {
                            let fv = dv as f32 / NODE_STEP as f32;
                            for du in 0..NODE_STEP {
                                let fu = du as f32 / NODE_STEP as f32;
                                pixels[first + dv * SIDE + du] = [0, 1].map(|i| {
                                    let upper = a[i] + (b[i] - a[i]) * fu;
                                    let lower = c[i] + (d[i] - c[i]) * fu;
                                    upper + (lower - upper) * fv
                                });
                            }
                        }
                    }
                    // The image's edge runs through this block.
                    _ => {
                        for dv in 0..NODE_STEP {
                            for du in 0..NODE_STEP {
                                let (x, y) = (block_column * NODE_STEP + du, block_row * NODE_STEP + dv);
                                if let Some(pixel) = pixel_of(place(x), place(y)) {
                                    pixels[first + dv * SIDE + du] = pixel;
                                }
                            }
                        }
                    }
                }
            }
        }
        let foot = footprint_from_optical.translation.truncate();
        Self { pixels, range_m, foot, height_m: footprint_from_optical.translation.z }
    }

    pub(super) fn cell_m(&self) -> f64 {
        2.0 * self.range_m / SIDE as f64
    }

    /// Metres from the robot of a row's or column's centre.
    pub(super) fn place(&self, index: usize) -> f64 {
        (index as f64 + 0.5) * self.cell_m() - self.range_m
    }

    /// Sets what lies beyond the carpet or behind the robot's body to unseen.
    pub fn hide(&mut self, border: Option<&CarpetBorder>, body: Option<&BodyMask>) {
        const UNSEEN: [f32; 2] = [f32::NAN; 2];
        let places: Vec<f64> = (0..SIDE).map(|index| self.place(index)).collect();
        for (row, pixels) in self.pixels.chunks_exact_mut(SIDE).enumerate() {
            if let Some(border) = border {
                let (low, high) = border.row(places[row]).unwrap_or((f64::INFINITY, f64::NEG_INFINITY));
                for (pixel, x) in pixels.iter_mut().zip(&places) {
                    if !(low..=high).contains(x) {
                        *pixel = UNSEEN;
                    }
                }
            }
            if let Some(body) = body {
                for pixel in pixels.iter_mut() {
                    if body.hides(DVec2::new(f64::from(pixel[0]), f64::from(pixel[1]))) {
                        *pixel = UNSEEN;
                    }
                }
            }
        }
    }
}
