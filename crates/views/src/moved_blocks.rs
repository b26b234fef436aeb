//! What stands before the world in a recorded image, found by comparison with other images of the same hall.
//!
//! The world (ground and hall) predicts in which direction another image shows what a pixel shows. A robot or a person is not
//! where the world is, so that images taken elsewhere, or at other times, show something else there: the median over several
//! images is the background, and what differs from it stands before it. The comparison is made in blocks of pixels.

use glam::{DMat3, DVec3};

use super::raster::{NOTHING, Raster, SURE};
use super::sample::read;
use super::world::Surface;
use super::{Camera, World, optical};
use realitysim_geometry::Isometry;

/// A recorded image in blocks, with its pose: what [`moved_blocks`] compares.
#[derive(Clone, Debug)]
pub struct BlockImage<'a> {
    camera: &'a Camera,
    map_from_link: Isometry,
    side: usize,
    /// Mean colours of the blocks.
    blocks: Raster,
}

/// Columns of blocks: one for about each degree of a wide fisheye.
const COLUMNS: usize = 160;
/// Smallest side of a block, pixels of the image.
const MIN_SIDE: usize = 2;
/// Fewer images than this make no background.
const MIN_OTHERS: usize = 3;
/// Differences up to this, in one of 256 levels, are noise and light.
const TOLERANCE: f32 = 16.0;
/// At least this many of the 3 x 3 blocks around one must differ; fewer are noise.
const MIN_NEIGHBOURS: usize = 5;
/// If a larger share differs, the hall is not where it is believed to be, and nothing is marked.
const MOVED_SHARE_LIMIT: f64 = 0.4;

/// Side of the blocks of an image of this width, pixels.
pub(super) fn block_side(width: usize) -> usize {
    (width / COLUMNS).max(MIN_SIDE)
}

/// Number of columns and rows of blocks of an image of this size.
pub fn block_grid(width: usize, height: usize) -> (usize, usize) {
    let side = block_side(width);
    (width / side, height / side)
}

impl<'a> BlockImage<'a> {
    /// Takes the means of the blocks of `image`, taken by `camera` from `map_from_link`, its pose of `camera_link` in `map`.
    pub fn new(camera: &'a Camera, map_from_link: &Isometry, image: &Raster) -> Self {
        let side = block_side(image.width);
        let (width, height) = block_grid(image.width, image.height);
        let mean = |index: usize| {
            let (left, top) = (index % width * side, index / width * side);
            let (mut sum, mut shown) = ([0u32; 3], true);
            for row in image.pixels[top * image.width..].chunks(image.width).take(side) {
                for pixel in &row[left..left + side] {
                    (0..3).for_each(|c| sum[c] += u32::from(pixel[c]));
                    shown &= pixel[3] == SURE;
                }
            }
            let [r, g, b] = sum.map(|sum| (sum / (side * side) as u32) as u8);
            [r, g, b, if shown { SURE } else { NOTHING }]
        };
        let blocks = Raster { width, height, pixels: (0..width * height).map(mean).collect() };
        Self { camera, map_from_link: *map_from_link, side, blocks }
    }

    /// For each block the unit ray in `map` and the inverse distance at which it meets the world, 1/m; `None` where that is unknown.
    fn points(&self, world: &World) -> Vec<Option<(DVec3, f64)>> {
        let own = optical(&self.map_from_link);
        let (turn, background) = (DMat3::from_quat(own.rotation), world.background_from(own.translation));
        let width = self.blocks.width;
        let point = |index: usize| {
            let (u, v) = (index % width * self.side + self.side / 2, index / width * self.side + self.side / 2);
            let ray = turn * self.camera.ray(u, v)?;
            let hit = background.hit(ray);
            // Only the ground is known if the hall is not.
            let is_known = hit.inverse_distance > 0.0 && (hit.surface == Surface::Ground || !world.hall().is_unknown());
            is_known.then_some((ray, hit.inverse_distance))
        };
        (0..self.blocks.pixels.len()).map(point).collect()
    }

    /// Colours, in the blocks of this image, that another shows at these points if nothing stands before them; NaN where it does not.
    fn predicted(&self, points: &[Option<(DVec3, f64)>], other: &Self) -> Vec<[f32; 3]> {
        let pose = optical(&other.map_from_link);
        let back = DMat3::from_quat(pose.rotation).transpose();
        let apart = optical(&self.map_from_link).translation - pose.translation;
        let scale = 1.0 / other.side as f64;
        let colour = |point: &Option<(DVec3, f64)>| {
            let (ray, inverse_distance) = (*point)?;
            let at = other.camera.projector().project(back * (ray + inverse_distance * apart))?;
            let at = (at + 0.5) * scale - 0.5;
            let [r, g, b, known] = read(&other.blocks, at.x as f32, at.y as f32);
            (known == SURE).then(|| [r, g, b].map(f32::from))
        };
        let mut colours: Vec<[f32; 3]> = points.iter().map(|point| colour(point).unwrap_or([f32::NAN; 3])).collect();
        self.balance(&mut colours);
        colours
    }

    /// Makes predicted colours as bright as this image, by one gain for each channel.
    fn balance(&self, colours: &mut [[f32; 3]]) {
        let (mut wanted, mut found) = ([0.0; 3], [0.0; 3]);
        for (own, colour) in self.blocks.pixels.iter().zip(colours.iter()) {
            if own[3] == SURE && !colour[0].is_nan() {
                (0..3).for_each(|c| {
                    wanted[c] += f64::from(own[c]);
                    found[c] += f64::from(colour[c]);
                });
            }
        }
        let gain: [f32; 3] = core::array::from_fn(|c| if found[c] > 0.0 { (wanted[c] / found[c]) as f32 } else { 1.0 });
        colours.iter_mut().for_each(|colour| (0..3).for_each(|c| colour[c] *= gain[c]));
    }
}

/// The blocks of `own` that show something before `world`: robots, people, what was carried away. `None` if that cannot be told.
///
/// The others must have been taken so far away that what stands before the world covers another part of it. A block differs
/// if its colour lies outside of the colours of the 3 x 3 blocks of background around it, so that texture is no difference
/// where poses are not exact.
pub fn moved_blocks(own: &BlockImage, others: &[&BlockImage], world: &World) -> Option<Vec<bool>> {
    let points = own.points(world);
    let predicted: Vec<Vec<[f32; 3]>> = others.iter().map(|other| own.predicted(&points, other)).collect();
    let mut values = Vec::new();
    let background: Vec<[f32; 3]> =
        (0..own.blocks.pixels.len()).map(|index| median(&predicted, &mut values, index)).collect();
    let (width, height) = (own.blocks.width, own.blocks.height);
    let found: Vec<bool> = (0..background.len()).map(|index| own.differs(&background, index)).collect();
    let is_solid = |index: &usize| {
        found[*index] && around(*index, width, height).filter(|near| found[*near]).count() >= MIN_NEIGHBOURS
    };
    let solid: Vec<bool> = (0..found.len()).map(|index| is_solid(&index)).collect();
    let known = background.iter().filter(|colour| !colour[0].is_nan()).count();
    let count = solid.iter().filter(|solid| **solid).count();
    let is_plausible = known > 0 && count as f64 <= MOVED_SHARE_LIMIT * known as f64;
    is_plausible.then(|| (0..solid.len()).map(|index| around(index, width, height).any(|near| solid[near])).collect())
}

/// The median colour that images predict for a block, by channel; NaN if too few of them do.
fn median(predicted: &[Vec<[f32; 3]>], values: &mut Vec<f32>, index: usize) -> [f32; 3] {
    core::array::from_fn(|c| {
        values.clear();
        values.extend(predicted.iter().map(|of| of[index][c]).filter(|value| !value.is_nan()));
        let middle = values.len() / 2;
        if values.len() < MIN_OTHERS { f32::NAN } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
    })
}

/// A block and its neighbours.
fn around(index: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let near = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
    near(index / width, height).flat_map(move |row| near(index % width, width).map(move |column| row * width + column))
}

impl BlockImage<'_> {
    /// Whether a block is of another colour than the background around it.
    fn differs(&self, background: &[[f32; 3]], index: usize) -> bool {
        let own = self.blocks.pixels[index];
        if own[3] != SURE || background[index][0].is_nan() {
            return false;
        }
        let near = || around(index, self.blocks.width, self.blocks.height).map(|near| background[near]);
        (0..3).any(|c| {
            // `min` and `max` leave NaN out.
            let low = near().map(|colour| colour[c]).fold(f32::INFINITY, f32::min);
            let high = near().map(|colour| colour[c]).fold(f32::NEG_INFINITY, f32::max);
            !(low - TOLERANCE..=high + TOLERANCE).contains(&f32::from(own[c]))
        })
    }
}
