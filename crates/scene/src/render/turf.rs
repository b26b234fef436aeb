//! Look of artificial turf with its paint, and of patches of sunlight. Textures are filtered by the footprint of the pixel.

use super::super::effects::{SunPatches, Turf};
use super::super::stream::{self, Purpose, Stream};
use super::macro_texture::Colour;
use super::tile::{REACH, SPREAD, Tile};

/// Turf, prepared for the pixel loop.
#[derive(Clone, Debug)]
pub(super) struct TurfLook {
    blades: Tile,
    /// Tiles for the displacement of paint in x and in y, each with its mean value, which stands for no displacement.
    ///
    /// So lines are on average where the description of the field has them.
    displacements: [(Tile, f32); 2],
    /// Relative change of brightness per unit of the tile.
    blade_gain: f32,
    /// Displacement of paint per unit of the tile, metres.
    ragged_m: f32,
    paint: Colour,
    /// Share of the paint that the darkest blades hide.
    hidden_share: f32,
    glint_share: f32,
    /// Key of the random stream of glints.
    glints: u64,
}

/// Texels per metre of the blades, which are a few millimetres wide.
const TEXELS_PER_METRE: f32 = 256.0;
/// Texels per metre of the displacement. Edges are ragged over centimetres, and lines are straight over metres.
const STRAY_TEXELS_PER_METRE: f32 = 640.0;
/// Colour of turf relative to flat carpet: it is darker, and its green is less bright.
const TINT: Colour = [0.80, 0.66, 0.80];
/// Colours of the worst and the best paint.
const THIN_PAINT: Colour = [104.0, 116.0, 104.0];
const GOOD_PAINT: Colour = [214.0, 220.0, 212.0];
/// Side of a cell of ground on which a blade may glint, metres.
const GLINT_M: f32 = 0.006;
/// Maximum image value that a glint adds.
const GLINT: f32 = 220.0;

impl TurfLook {
    pub(super) fn new(effect: &Turf, seed: u64) -> Self {
        let key = |part: u64| Stream::new(seed, Purpose::Turf, part).key();
        let tile = |part: u64, texels| Tile::new(key(part), Purpose::Turf, texels);
        let share = effect.paint as f32;
        Self {
            blades: tile(0, TEXELS_PER_METRE),
            displacements: [1, 2].map(|part| {
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

    /// Displacement of the paint at (x, y) from its nominal position, metres.
    ///
    /// `size2` is the square of the size of the pixel's footprint, square metres.
    // Never inlined, here and below, and arguments by value: effects that few scenes have must not slow the pixel loop.
    #[inline(never)]
    pub(super) fn paint_displacement(&self, x: f32, y: f32, size2: f32) -> [f32; 2] {
        [0, 1].map(|axis| {
            let (tile, mean) = &self.displacements[axis];
            self.ragged_m * (tile.sample(x, y, 0.5 * size2) - mean)
        })
    }

    /// Colour of turf at (x, y). `base` is the colour of flat carpet there, `paint` the painted share of the pixel.
    #[inline(never)]
    pub(super) fn colour(&self, x: f32, y: f32, size2: f32, base: Colour, paint: f32) -> Colour {
        let blade = self.blades.sample(x, y, 0.5 * size2) - 128.0;
        let gain = (1.0 + self.blade_gain * blade).max(0.15);
        let paint = paint * (1.0 - self.hidden_share * (0.5 - blade / (2.0 * REACH)).clamp(0.0, 1.0));
        let glint = if self.glint_share > 0.0 { self.glint(x, y, size2) } else { 0.0 };
        core::array::from_fn(|c| {
            let bare = base[c] * TINT[c] * gain;
            // Paint has the structure of the blades under it, but with less contrast.
            let coated = self.paint[c] * (0.5 + 0.5 * gain);
            bare + (coated - bare) * paint + glint
        })
    }

    /// Image value that a glint adds at (x, y).
    fn glint(&self, x: f32, y: f32, size2: f32) -> f32 {
        let [(column, _), (row, _)] = [x, y].map(|at| floor_and_rest(at / GLINT_M));
        let (drawn, hash) = cell_random(self.glints, column, row);
        if drawn >= self.glint_share {
            return 0.0;
        }
        // In a pixel that covers more ground than the glint, the glint is fainter in proportion.
        let seen = (2.0 * GLINT_M * GLINT_M / size2).min(1.0);
        // The strength is random, because blades have different orientations.
        GLINT * seen * (hash & 0xff) as f32 / 255.0
    }
}

/// Patches of sunlight, prepared for the pixel loop.
#[derive(Clone, Debug)]
pub(super) struct Sunlight {
    /// Gain in the sun minus 1.
    extra_gain: f32,
    share: f32,
    length_m: f32,
    edge_m: f32,
    /// Unit vector along the panes in `map`.
    direction: [f32; 2],
    /// Key of the random stream that selects the lit panes.
    panes: u64,
}

/// Colour of sunlight relative to the light of the hall: it is warmer.
const WARMTH: Colour = [1.05, 1.0, 0.85];

impl Sunlight {
    pub(super) fn new(effect: &SunPatches, seed: u64) -> Self {
        let mut stream = Stream::new(seed, Purpose::SunPatches, 0);
        let angle = stream.between(0.0, core::f64::consts::PI);
        Self {
            extra_gain: effect.gain as f32 - 1.0,
            share: effect.share as f32,
            length_m: effect.length_m as f32,
            edge_m: effect.edge_m as f32,
            direction: [libm::cos(angle) as f32, libm::sin(angle) as f32],
            panes: Stream::new(seed, Purpose::SunPatches, 1).key(),
        }
    }

    /// The colour of the ground at (x, y) with sunlight, if it is in a patch.
    #[inline(never)]
    pub(super) fn illuminate(&self, x: f32, y: f32, colour: Colour) -> Colour {
        let [dx, dy] = self.direction;
        let (column, u) = floor_and_rest((x * dx + y * dy) / self.length_m);
        let (row, v) = floor_and_rest((y * dx - x * dy) / (0.5 * self.length_m));
        let (drawn, _) = cell_random(self.panes, column, row);
        if drawn >= self.share {
            return colour;
        }
        let inside = |share: f32, length_m: f32| smooth((share.min(1.0 - share) * length_m / self.edge_m).min(1.0));
        let lit = self.extra_gain * inside(u, self.length_m) * inside(v, 0.5 * self.length_m);
        core::array::from_fn(|c| colour[c] * (1.0 + lit * WARMTH[c]))
    }
}

/// Random number from 0 to 1 for a cell of a grid, and the 64 random bits behind it, of which it does not use the lowest 40.
fn cell_random(key: u64, column: i64, row: i64) -> (f32, u64) {
    let hash = stream::at(key, (column as u64).wrapping_mul(0x1_0000_0001) ^ (row as u64).rotate_left(32));
    ((hash >> 40) as f32 / (1u64 << 24) as f32, hash)
}

/// Transition from 0 to 1 with zero slope at both ends ("smoothstep").
fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// Integer part, rounded down, and the rest.
fn floor_and_rest(value: f32) -> (i64, f32) {
    let whole = value.floor();
    (whole as i64, value - whole)
}
