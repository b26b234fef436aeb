//! Repeating fine texture: value noise of several scales, with mip levels so that it averages out at a distance.

use super::super::stream::{Purpose, Stream};
use super::fixed::{ONE, fixed};

/// A square texture of values around 128 that repeats in both directions.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    /// Mip levels, each half the size of the one before, down to a single value.
    levels: Vec<Level>,
    texels_per_metre: f32,
}

/// A mip level: `side` x `side` values, row by row.
#[derive(Clone, Debug)]
struct Level {
    side: usize,
    texels_per_metre: f32,
    values: Vec<u8>,
}

/// Standard deviation of the values of a tile.
pub(super) const SPREAD: f32 = 27.7;
/// Five of six values differ from 128 by less than this.
pub(super) const REACH: f32 = 40.0;

/// Side of the finest level in texels, a power of two, so that coordinates wrap by masking.
const SIDE: usize = 1024;
/// Bits of the mantissa of an `f32`.
const MANTISSA_BITS: u32 = 23;
/// Scale of the noise in image values.
const AMPLITUDE: f64 = 46.0;

impl Tile {
    /// Draws a tile.
    pub(super) fn new(seed: u64, purpose: Purpose, texels_per_metre: f32) -> Self {
        let mut levels = vec![Level { side: SIDE, texels_per_metre, values: noise(seed, purpose) }];
        while let Some(finer) = levels.last().filter(|level| level.side > 1) {
            let next = finer.halved();
            levels.push(next);
        }
        Self { levels, texels_per_metre }
    }

    /// Mean of the finest level.
    pub(super) fn mean(&self) -> f32 {
        let values = &self.levels[0].values;
        values.iter().map(|value| u64::from(*value)).sum::<u64>() as f32 / values.len() as f32
    }

    /// Value at (x, y), metres, averaged over a footprint whose squared size is `size2`, square metres.
    ///
    /// Two mip levels are interpolated, so that no border between levels shows.
    // Always inlined, like `Level::sample`: the pixel loop is a tenth slower with calls here.
    #[inline(always)]
    pub(super) fn sample(&self, x: f32, y: f32, size2: f32) -> f32 {
        let texels2 = size2 * self.texels_per_metre * self.texels_per_metre;
        // The bits of a float are its logarithm, linear between powers of two. It is halved because texels2 is a square.
        let level = (texels2.to_bits() as i32 - 1f32.to_bits() as i32) >> 1;
        let last = self.levels.len() - 1;
        if level <= 0 {
            return self.levels[0].sample(x, y);
        }
        let finer = (level as usize >> MANTISSA_BITS).min(last);
        let share = (level % (1 << MANTISSA_BITS)) as f32 * (1.0 / (1 << MANTISSA_BITS) as f32);
        let fine = self.levels[finer].sample(x, y);
        fine + (self.levels[(finer + 1).min(last)].sample(x, y) - fine) * share
    }
}

impl Level {
    #[inline(always)]
    fn sample(&self, x: f32, y: f32) -> f32 {
        let mask = self.side - 1;
        let (column, fx) = fixed(x * self.texels_per_metre);
        let (row, fy) = fixed(y * self.texels_per_metre);
        let (left, top) = (column as usize & mask, (row as usize & mask) * self.side);
        let (right, bottom) = ((left + 1) & mask, (top + self.side) & (self.side * self.side - 1));
        let at = |row: usize, column: usize| u32::from(self.values[row + column]);
        let sum = (ONE - fy) * ((ONE - fx) * at(top, left) + fx * at(top, right))
            + fy * ((ONE - fx) * at(bottom, left) + fx * at(bottom, right));
        sum as i32 as f32 * (1.0 / (ONE * ONE) as f32)
    }

    /// The next coarser level, the mean of 2 x 2 values.
    fn halved(&self) -> Level {
        let side = self.side / 2;
        let at = |row: usize, column: usize| u32::from(self.values[row * self.side + column]);
        let mean = |i: usize| {
            let (row, column) = (2 * (i / side), 2 * (i % side));
            let sum = at(row, column) + at(row, column + 1) + at(row + 1, column) + at(row + 1, column + 1);
            ((sum + 2) / 4) as u8
        };
        Level { side, texels_per_metre: self.texels_per_metre / 2.0, values: (0..side * side).map(mean).collect() }
    }
}

/// Scales of the noise: side of a cell in texels, share of the amplitude. From fibres over tufts and pile to soft patches.
const OCTAVES: [(usize, f64); 5] = [(1, 0.42), (2, 0.30), (8, 0.16), (32, 0.18), (128, 0.16)];

/// The finest level of a tile.
fn noise(seed: u64, purpose: Purpose) -> Vec<u8> {
    let mut sum = vec![0.0; SIDE * SIDE];
    for (octave, (cell, share)) in OCTAVES.into_iter().enumerate() {
        add_octave(&mut sum, &mut Stream::new(seed, purpose, octave as u64), cell, share);
    }
    sum.into_iter().map(|value| libm::round(128.0 + 2.0 * AMPLITUDE * value).clamp(0.0, 255.0) as u8).collect()
}

/// Adds value noise of one scale: random values on a lattice, smoothly interpolated.
fn add_octave(sum: &mut [f64], stream: &mut Stream, cell: usize, share: f64) {
    let cells = SIDE / cell;
    let lattice: Vec<f64> = (0..cells * cells).map(|_| stream.between(-share, share)).collect();
    let smooth = |index: usize| {
        let t = (index % cell) as f64 / cell as f64;
        (index / cell, (index / cell + 1) % cells, t * t * (3.0 - 2.0 * t))
    };
    for (row, line) in sum.chunks_exact_mut(SIDE).enumerate() {
        let (top, bottom, ty) = smooth(row);
        for (column, value) in line.iter_mut().enumerate() {
            let (left, right, tx) = smooth(column);
            let mix = |row: usize| {
                let (a, b) = (lattice[row * cells + left], lattice[row * cells + right]);
                a + (b - a) * tx
            };
            *value += mix(top) + (mix(bottom) - mix(top)) * ty;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_stated_mean_spread_and_reach() {
        for seed in 0..5 {
            let tile = Tile::new(seed, Purpose::Turf, 256.0);
            let values: Vec<f32> = tile.levels[0].values.iter().map(|value| f32::from(*value)).collect();
            let of = |count: usize| count as f32 / values.len() as f32;
            let mean = tile.mean();
            let squares: f64 = values.iter().map(|value| f64::from((value - mean).powi(2))).sum();
            let spread = (squares / values.len() as f64).sqrt() as f32;
            assert!((spread / SPREAD - 1.0).abs() < 0.02, "{spread}");
            assert!((mean - 128.0).abs() < 4.0, "{mean}");
            let within = of(values.iter().filter(|value| (**value - 128.0).abs() < REACH).count());
            assert!((within - 5.0 / 6.0).abs() < 0.02, "{within}");
        }
    }
}
