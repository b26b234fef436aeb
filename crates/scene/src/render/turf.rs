//! Blades of turf and the paint on them, filtered like everything else by the pixel's footprint.

use super::super::effects::{SunPatches, Turf};
use super::super::stream::{self, Purpose, Stream};
use super::macro_texture::Colour;
use super::tile::{REACH, SPREAD, Tile};

#[derive(Clone, Debug)]
pub(super) struct TurfLook {
    blades: Tile,
    /// How far paint strays in x and in y, and the value that is no stray: lines lie, on the whole, where the field's description has them.
    strays: [(Tile, f32); 2],
    /// Change of brightness, as a share, for each unit of the tile's value.
    blade_gain: f32,
    /// Metres for each unit of a tile's value.
    ragged_m: f32,
    paint: Colour,
    /// Share of the paint that the darkest blades hide.
    hidden_share: f32,
    glint_share: f32,
    glints: u64,
}

/// Blades are a few millimetres wide.
const TEXELS_PER_METRE: f32 = 256.0;
/// Edges stray within centimetres, and lines are straight over metres.
const STRAY_TEXELS_PER_METRE: f32 = 640.0;
/// Against flat carpet: turf is darker, and its green less bright.
const TINT: Colour = [0.80, 0.66, 0.80];
const THIN_PAINT: Colour = [104.0, 116.0, 104.0];
const GOOD_PAINT: Colour = [214.0, 220.0, 212.0];
/// Side of the piece of ground on which a blade may glint.
const GLINT_M: f32 = 0.006;
const GLINT: f32 = 220.0;

impl TurfLook {
    pub(super) fn new(effect: &Turf, seed: u64) -> Self {
        let key = |part: u64| Stream::new(seed, Purpose::Turf, part).key();
        let tile = |part: u64, texels| Tile::new(key(part), Purpose::Turf, texels);
        let share = effect.paint as f32;
        Self {
            blades: tile(0, TEXELS_PER_METRE),
            strays: [1, 2].map(|part| {
                let stray = tile(part, STRAY_TEXELS_PER_METRE);
                let mean = stray.mean();
                (stray, mean)
            }),
            blade_gain: effect.blades as f32 / SPREAD,
            ragged_m: effect.ragged_mm as f32 * 1e-3 / SPREAD,
            paint: core::array::from_fn(|c| THIN_PAINT[c] + (GOOD_PAINT[c] - THIN_PAINT[c]) * share),
            hidden_share: 0.6 * (1.0 - share),
            glint_share: effect.glint_share as f32,
            glints: key(3),
        }
    }

    /// By how much the paint at this place has strayed from where it should be, metres. `size2` is the square of the pixel's footprint.
    // Never inlined, here and below, and by value: what few scenes have shall not crowd the pixel loop.
    #[inline(never)]
    pub(super) fn stray(&self, x: f32, y: f32, size2: f32) -> [f32; 2] {
        [0, 1].map(|axis| {
            let (stray, mean) = &self.strays[axis];
            self.ragged_m * (stray.sample(x, y, 0.5 * size2) - mean)
        })
    }

    /// Of turf as bright as `base` if it were flat carpet, of which the share `paint` is painted.
    #[inline(never)]
    pub(super) fn colour(&self, x: f32, y: f32, size2: f32, base: Colour, paint: f32) -> Colour {
        let blade = self.blades.sample(x, y, 0.5 * size2) - 128.0;
        let gain = (1.0 + self.blade_gain * blade).max(0.15);
        let paint = paint * (1.0 - self.hidden_share * (0.5 - blade / (2.0 * REACH)).clamp(0.0, 1.0));
        let glint = if self.glint_share > 0.0 { self.glint(x, y, size2) } else { 0.0 };
        core::array::from_fn(|c| {
            let bare = base[c] * TINT[c] * gain;
            // Paint is as rough as what it lies on, but shades less.
            let painted = self.paint[c] * (0.5 + 0.5 * gain);
            bare + (painted - bare) * paint + glint
        })
    }

    fn glint(&self, x: f32, y: f32, size2: f32) -> f32 {
        let [(column, _), (row, _)] = [x, y].map(|at| split(at / GLINT_M));
        let (drawn, hash) = drawn(self.glints, column, row);
        if drawn >= self.glint_share {
            return 0.0;
        }
        // A pixel that covers more ground than the glint shows it fainter in proportion.
        let seen = (2.0 * GLINT_M * GLINT_M / size2).min(1.0);
        // Blades are turned towards the lamps more or less.
        GLINT * seen * (hash & 0xff) as f32 / 255.0
    }
}

#[derive(Clone, Debug)]
pub(super) struct Sunlight {
    more: f32,
    share: f32,
    length_m: f32,
    edge_m: f32,
    /// Along the panes.
    direction: [f32; 2],
    panes: u64,
}

/// Sunlight is warmer than the hall's.
const WARMTH: Colour = [1.05, 1.0, 0.85];

impl Sunlight {
    pub(super) fn new(effect: &SunPatches, seed: u64) -> Self {
        let mut stream = Stream::new(seed, Purpose::SunPatches, 0);
        let angle = stream.between(0.0, core::f64::consts::PI);
        Self {
            more: effect.gain as f32 - 1.0,
            share: effect.share as f32,
            length_m: effect.length_m as f32,
            edge_m: effect.edge_m as f32,
            direction: [libm::cos(angle) as f32, libm::sin(angle) as f32],
            panes: Stream::new(seed, Purpose::SunPatches, 1).key(),
        }
    }

    /// What of this colour is there in the sun.
    #[inline(never)]
    pub(super) fn on(&self, x: f32, y: f32, colour: Colour) -> Colour {
        let [dx, dy] = self.direction;
        let (column, u) = split((x * dx + y * dy) / self.length_m);
        let (row, v) = split((y * dx - x * dy) / (0.5 * self.length_m));
        let (drawn, _) = drawn(self.panes, column, row);
        if drawn >= self.share {
            return colour;
        }
        let inside = |share: f32, length_m: f32| smooth((share.min(1.0 - share) * length_m / self.edge_m).min(1.0));
        let lit = self.more * inside(u, self.length_m) * inside(v, 0.5 * self.length_m);
        core::array::from_fn(|c| colour[c] * (1.0 + lit * WARMTH[c]))
    }
}

/// A number from 0 to 1 for a cell of a grid, and the bits that it was made from, of which the lowest 40 are free.
fn drawn(key: u64, column: i64, row: i64) -> (f32, u64) {
    let hash = stream::at(key, (column as u64).wrapping_mul(0x1_0000_0001) ^ (row as u64).rotate_left(32));
    ((hash >> 40) as f32 / (1u64 << 24) as f32, hash)
}

/// From 0 to 1 without a corner at either end.
fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// The whole number below, and what is left.
fn split(value: f32) -> (i64, f32) {
    let whole = value.floor();
    (whole as i64, value - whole)
}
