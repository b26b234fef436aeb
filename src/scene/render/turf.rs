//! Blades of turf and the paint on them, filtered like everything else by the pixel's footprint.

use super::super::effects::{SunPatches, Turf};
use super::super::stream::{self, Purpose, Stream};
use super::footprint::GroundPoint;
use super::sheet::Colour;
use super::tile::Tile;

#[derive(Clone, Debug)]
pub(super) struct TurfLook {
    blades: Tile,
    strays: [Tile; 2],
    /// For each unit of a tile around 128.
    blade_gain: f32,
    ragged_m: f32,
    paint: Colour,
    /// Share of the paint that blades which stand out of it hide where they are darkest.
    shows_through: f32,
    glint_share: f32,
    glints: u64,
}

/// Blades are a few millimetres wide.
const TEXELS_PER_METRE: f32 = 256.0;
/// Edges stray over centimetres.
const STRAY_TEXELS_PER_METRE: f32 = 640.0;
/// A tile's values are 128 +- about this.
const SPREAD: f32 = 40.0;
/// Against flat carpet: turf is darker, and its green less bright.
const TINT: Colour = [0.80, 0.66, 0.80];
const THIN_PAINT: Colour = [104.0, 116.0, 104.0];
const GOOD_PAINT: Colour = [214.0, 220.0, 212.0];
/// Side of the piece of ground on which a blade may glint.
const GLINT_M: f32 = 0.006;
const GLINT: f32 = 220.0;

impl TurfLook {
    pub(super) fn new(effect: &Turf, seed: u64) -> Self {
        let tile = |part: u64, texels| Tile::new(seed.wrapping_add(part), Purpose::Turf, texels);
        let share = effect.paint as f32;
        Self {
            blades: tile(0, TEXELS_PER_METRE),
            strays: [tile(1, STRAY_TEXELS_PER_METRE), tile(2, STRAY_TEXELS_PER_METRE)],
            blade_gain: effect.blades as f32 / SPREAD,
            ragged_m: effect.ragged_mm as f32 * 1e-3 / SPREAD,
            paint: core::array::from_fn(|c| THIN_PAINT[c] + (GOOD_PAINT[c] - THIN_PAINT[c]) * share),
            shows_through: 0.6 * (1.0 - share),
            glint_share: effect.glint_share as f32,
            glints: Stream::new(seed, Purpose::Turf, 3).key(),
        }
    }

    /// Where the paint lies whose coverage counts at this place.
    pub(super) fn strayed(&self, p: &GroundPoint) -> GroundPoint {
        let [x, y] = [0, 1].map(|axis| self.ragged_m * (self.strays[axis].sample(p.x, p.y, 0.5 * p.size2) - 128.0));
        GroundPoint { x: p.x + x, y: p.y + y, ..*p }
    }

    /// Of turf as bright as `base` if it were flat carpet, so much of which is painted.
    #[inline(never)]
    pub(super) fn colour(&self, p: &GroundPoint, base: Colour, paint: f32) -> Colour {
        let blade = self.blades.sample(p.x, p.y, 0.5 * p.size2) - 128.0;
        let gain = (1.0 + self.blade_gain * blade).max(0.15);
        let paint = paint * (1.0 - self.shows_through * (0.5 - blade / (2.0 * SPREAD)).clamp(0.0, 1.0));
        let glint = if self.glint_share > 0.0 { self.glint(p) } else { 0.0 };
        core::array::from_fn(|c| {
            let bare = base[c] * TINT[c] * gain;
            // Paint is as rough as what it lies on, but shades less.
            let painted = self.paint[c] * (0.5 + 0.5 * gain);
            bare + (painted - bare) * paint + glint
        })
    }

    fn glint(&self, p: &GroundPoint) -> f32 {
        let cell = |at: f32| i64::from((at / GLINT_M).floor() as i32) as u64;
        let hash = stream::at(self.glints, cell(p.x).wrapping_mul(0x1_0000_0001) ^ cell(p.y).rotate_left(32));
        let drawn = (hash >> 40) as f32 / (1u64 << 24) as f32;
        if drawn >= self.glint_share {
            return 0.0;
        }
        // A pixel of more ground than that sees it the less, ...
        let seen = (2.0 * GLINT_M * GLINT_M / p.size2).min(1.0);
        // ... and not all blades are turned to the lamps alike.
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

    #[inline(never)]
    pub(super) fn on(&self, p: &GroundPoint, colour: Colour) -> Colour {
        let [dx, dy] = self.direction;
        let (along, across) = (p.x * dx + p.y * dy, p.y * dx - p.x * dy);
        let (column, u) = split(along / self.length_m);
        let (row, v) = split(across / (0.5 * self.length_m));
        let hash = stream::at(self.panes, (column as u64).wrapping_mul(0x1_0000_0001) ^ (row as u64).rotate_left(32));
        if (hash >> 40) as f32 / (1u64 << 24) as f32 >= self.share {
            return colour;
        }
        let fades = |inside_m: f32| {
            let t = (inside_m / self.edge_m).clamp(0.0, 1.0);
            t * t * (3.0 - 2.0 * t)
        };
        let inside = |share: f32, length_m: f32| fades(share.min(1.0 - share) * length_m);
        let lit = self.more * inside(u, self.length_m) * inside(v, 0.5 * self.length_m);
        core::array::from_fn(|c| colour[c] * (1.0 + lit * WARMTH[c]))
    }
}

/// The whole number below, and what is left.
fn split(value: f32) -> (i64, f32) {
    let whole = value.floor();
    (whole as i64, value - whole)
}
