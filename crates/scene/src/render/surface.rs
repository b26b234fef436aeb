//! The colour of the surface that a ray meets.

use glam::DVec2;

use super::super::stream::{Purpose, Stream};
use super::footprint::{GroundPoint, GroundRow};
use super::hall::Hall;
use super::lines::LineMap;
use super::macro_texture::{Canvas, Colour, Sheet};
use super::shape::inside_rectangle;
use super::tile::Tile;
use super::turf::{Sunlight, TurfLook};
use super::wear::Wear;
use realitysim_geometry::Field;

/// Carpet, lines and hall with their textures.
#[derive(Clone, Debug)]
pub(super) struct World {
    carpet_half: [f32; 2],
    carpet: Sheet,
    fibres: Tile,
    lines: LineMap,
    effects: GroundEffects,
    pub(super) hall: Hall,
}

/// The effects of a scene on the ground.
#[derive(Clone, Debug)]
pub(super) struct GroundEffects {
    pub(super) turf: Option<TurfLook>,
    pub(super) wear: Option<Wear>,
    pub(super) sun: Option<Sunlight>,
}

/// Colour of new paint.
const PAINT: Colour = [222.0, 226.0, 222.0];
/// Minimum downward component of a unit ray that reaches the floor within any hall.
const MIN_DOWN: f32 = 1e-4;
/// Texels per metre of the fibres.
const TEXELS_PER_METRE: f32 = 256.0;
/// Contrast of the fibres on carpet, paint and floor: relative change of brightness per unit of the tile.
const CARPET_GAIN: f32 = 0.75 / 128.0;
const PAINT_GAIN: f32 = 0.18 / 128.0;
const FLOOR_GAIN: f32 = 0.12 / 128.0;

impl World {
    /// Prepares textures and lines. The seed draws the textures.
    pub(super) fn new(field: &Field, effects: GroundEffects, seed: u64) -> Self {
        let half = field.carpet_half_extent();
        Self {
            carpet_half: half.as_vec2().to_array(),
            carpet: carpet(half, seed),
            fibres: Tile::new(seed, Purpose::Carpet, TEXELS_PER_METRE),
            lines: LineMap::new(field),
            effects,
            hall: Hall::new(half, seed),
        }
    }

    /// Colour that a pixel shows, 0 to 255 per channel. `ray` is its unit ray in `map`, `ground` has the points of its row.
    #[inline]
    pub(super) fn colour(&self, camera: &[f32; 3], ray: [f32; 3], ground: &GroundRow, column: usize) -> Colour {
        let down = -ray[2];
        if down < MIN_DOWN {
            return self.hall.above_floor(camera, ray);
        }
        let p = ground.point(column, down);
        let on_floor = inside_rectangle(&p, self.hall.half[0], self.hall.half[1]);
        if on_floor == 0.0 {
            return self.hall.above_floor(camera, ray);
        }
        // Half of the sum of squares is the mean of the squares of both axes.
        let fibre = self.fibres.sample(p.x, p.y, 0.5 * p.size2) - 128.0;
        let on_carpet = inside_rectangle(&p, self.carpet_half[0], self.carpet_half[1]);
        let mut colour = [0.0; 3];
        if on_carpet > 0.0 {
            let base = self.carpet.sample(p.x + self.carpet_half[0], p.y + self.carpet_half[1]);
            let turf = self.effects.turf.as_ref();
            let [aside_x, aside_y] = turf.map_or([0.0; 2], |turf| turf.paint_displacement(p.x, p.y, p.size2));
            let mut paint = self.lines.coverage(&GroundPoint { x: p.x + aside_x, y: p.y + aside_y, ..p });
            if let Some(wear) = &self.effects.wear
                && paint > 0.0
            {
                paint *= wear.remaining_paint(&p);
            }
            let (gain, paint_gain) = (1.0 + CARPET_GAIN * fibre, paint * (1.0 + PAINT_GAIN * fibre));
            let bare_gain = (1.0 - paint) * gain;
            colour = match turf {
                Some(turf) => turf.colour(p.x, p.y, p.size2, base, paint),
                None => [
                    bare_gain * base[0] + paint_gain * PAINT[0],
                    bare_gain * base[1] + paint_gain * PAINT[1],
                    bare_gain * base[2] + paint_gain * PAINT[2],
                ],
            };
        }
        if on_carpet < 1.0 {
            let gain = 1.0 + FLOOR_GAIN * fibre;
            colour = mix(self.hall.floor(p.x, p.y).map(|value| value * gain), colour, on_carpet);
        }
        if let Some(sun) = &self.effects.sun {
            colour = sun.illuminate(p.x, p.y, colour);
        }
        if on_floor < 1.0 {
            colour = mix(self.hall.above_floor(camera, ray), colour, on_floor);
        }
        colour
    }
}

#[inline]
fn mix(a: Colour, b: Colour, share: f32) -> Colour {
    [a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share, a[2] + (b[2] - a[2]) * share]
}

/// Texture of the carpet: lanes of pile brushed in alternating directions, worn and stained in patches.
fn carpet(half: DVec2, seed: u64) -> Sheet {
    let stream = |part: u64| Stream::new(seed, Purpose::Carpet, 100 + part);
    let mut canvas = Canvas::new(2.0 * half.x, 2.0 * half.y, 0.05, [66.0, 122.0, 62.0]);
    let lane_m = stream(0).between(0.9, 1.3);
    canvas.paint(|x, _, colour| {
        let side = libm::sin(x / lane_m * core::f64::consts::PI);
        let gain = 1.0 + 0.06 * (3.0 * side).clamp(-1.0, 1.0);
        *colour = [colour[0] * gain, colour[1] * (0.3 + 0.7 * gain), colour[2] * gain];
    });
    canvas.mottle(&mut stream(1), 1.7, 0.10);
    canvas.mottle(&mut stream(2), 0.45, 0.06);
    canvas.finish()
}
