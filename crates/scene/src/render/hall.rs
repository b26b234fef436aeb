//! The hall around the carpet. It is a box with a floor, four walls and a ceiling with lamps.

use glam::DVec2;

use super::super::stream::{Purpose, Stream};
use super::macro_texture::{Canvas, Colour, Sheet};

/// The hall with its textures. The origin of `map` is in the middle of its floor.
#[derive(Clone, Debug)]
pub(super) struct Hall {
    /// Half extents of the floor in x and y, metres.
    pub(super) half: [f32; 2],
    floor: Sheet,
    /// The four walls side by side: x along them, y from the floor up.
    walls: Sheet,
    ceiling: Sheet,
}

/// Distance from the edge of the carpet to the wall, metres.
const AISLE_M: f64 = 6.0;
/// Height of the ceiling above the floor, metres.
const HEIGHT_M: f64 = 6.5;

impl Hall {
    /// Draws the textures of a hall around a carpet with these half extents.
    pub(super) fn new(carpet_half: DVec2, seed: u64) -> Self {
        let half = carpet_half + DVec2::splat(AISLE_M);
        let stream = |part| Stream::new(seed, Purpose::Hall, part);
        Self {
            half: half.as_vec2().to_array(),
            floor: floor(half, &mut stream(0)),
            walls: walls(half, &mut stream(1)),
            ceiling: ceiling(half, &mut stream(2)),
        }
    }

    /// x and y of the point at which a ray ends on floor, walls or ceiling.
    #[inline]
    pub(super) fn end_of(&self, camera: &[f32; 3], direction: [f32; 3]) -> [f32; 2] {
        let [dx, dy, dz] = direction;
        let to_wall = |half: f32, from: f32, along: f32| (half - from * along.signum()) / along.abs().max(1e-9);
        let up = if dz > 0.0 { HEIGHT_M as f32 - camera[2] } else { camera[2] };
        let t = to_wall(self.half[0], camera[0], dx).min(to_wall(self.half[1], camera[1], dy));
        let t = t.min(up / dz.abs().max(1e-9));
        [camera[0] + t * dx, camera[1] + t * dy]
    }

    /// Colour of the floor at (x, y) in `map`.
    #[inline]
    pub(super) fn floor(&self, x: f32, y: f32) -> Colour {
        self.floor.sample(x + self.half[0], y + self.half[1])
    }

    /// Colour of wall or ceiling for a ray that does not end on the floor.
    #[inline]
    pub(super) fn above_floor(&self, camera: &[f32; 3], direction: [f32; 3]) -> Colour {
        let [hx, hy] = self.half;
        let [cx, cy, cz] = *camera;
        let [dx, dy, dz] = direction;
        // The distance to a wall that is parallel to the ray is practically infinite.
        let to_x = (hx - cx * dx.signum()) / dx.abs().max(1e-9);
        let to_y = (hy - cy * dy.signum()) / dy.abs().max(1e-9);
        let to_ceiling = if dz > 1e-6 { (HEIGHT_M as f32 - cz) / dz } else { f32::INFINITY };
        if to_ceiling < to_x.min(to_y) {
            return self.ceiling.sample(cx + to_ceiling * dx + hx, cy + to_ceiling * dy + hy);
        }
        let (along, t) = if to_x < to_y {
            let y = cy + to_x * dy;
            (if dx > 0.0 { y + hy } else { 2.0 * hy + 2.0 * hx + hy - y }, to_x)
        } else {
            let x = cx + to_y * dx;
            (if dy > 0.0 { 2.0 * hy + hx - x } else { 4.0 * hy + 2.0 * hx + x + hx }, to_y)
        };
        self.walls.sample(along, cz + t * dz)
    }
}

fn floor(half: DVec2, stream: &mut Stream) -> Sheet {
    let mut canvas = Canvas::new(2.0 * half.x, 2.0 * half.y, 0.08, [104.0, 90.0, 74.0]);
    canvas.mottle(stream, 3.0, 0.10);
    canvas.mottle(stream, 0.7, 0.05);
    // The varnish reflects the lamps more in the middle of the hall than along the walls.
    canvas.paint(|x, y, colour| {
        let edge = (x.min(2.0 * half.x - x)).min(y.min(2.0 * half.y - y));
        let gain = 0.72 + 0.28 * (edge / 3.0).clamp(0.0, 1.0);
        *colour = colour.map(|value| value * gain);
    });
    canvas.finish()
}

/// Colours of clothes, boxes and banners: anything but the green of the carpet.
const CLUTTER: [[f64; 3]; 10] = [
    [52.0, 50.0, 56.0],
    [128.0, 52.0, 46.0],
    [48.0, 64.0, 118.0],
    [176.0, 150.0, 96.0],
    [92.0, 72.0, 60.0],
    [196.0, 192.0, 186.0],
    [70.0, 84.0, 104.0],
    [150.0, 96.0, 60.0],
    [34.0, 36.0, 44.0],
    [120.0, 104.0, 120.0],
];

fn walls(half: DVec2, stream: &mut Stream) -> Sheet {
    let length = 4.0 * (half.x + half.y);
    let mut canvas = Canvas::new(length, HEIGHT_M, 0.06, [172.0, 162.0, 148.0]);
    canvas.rectangle([0.0, 0.0], [length, 1.1], [134.0, 122.0, 110.0]);
    canvas.mottle(stream, 5.0, 0.10);
    windows(&mut canvas, stream, length);
    // Doors and banners are drawn first, and what stands in front of the wall is drawn over them.
    let mut place = |count: f64, low: [f64; 2], high: [f64; 2], wide: [f64; 2], dim: f64| {
        for _ in 0..(count * length) as usize {
            let x = stream.between(0.0, length);
            let (bottom, top) = (stream.between(low[0], low[1]), stream.between(high[0], high[1]));
            let width = stream.between(wide[0], wide[1]);
            let colour = CLUTTER[(stream.uniform() * CLUTTER.len() as f64) as usize % CLUTTER.len()];
            canvas.rectangle([x, bottom], [x + width, top], colour.map(|value| value * dim));
        }
    };
    place(0.07, [0.0, 0.0], [2.0, 2.3], [0.9, 1.8], 0.8);
    place(0.10, [1.6, 2.6], [2.8, 3.6], [0.8, 3.0], 1.05);
    place(0.35, [0.0, 0.0], [0.6, 1.1], [0.5, 1.8], 0.9);
    place(0.45, [0.0, 0.2], [1.2, 1.85], [0.3, 0.55], 1.0);
    canvas.blur(2);
    // The lower wall is in the shade of what stands in front of it.
    canvas.paint(|_, height, colour| {
        let gain = 0.62 + 0.38 * (height / 1.2).clamp(0.0, 1.0);
        *colour = colour.map(|value| value * gain);
    });
    canvas.finish()
}

/// Paints a band of high windows along parts of the walls, between pillars.
fn windows(canvas: &mut Canvas, stream: &mut Stream, length: f64) {
    let mut x = stream.between(0.0, 3.0);
    while x < length {
        let width = stream.between(1.6, 2.6);
        if stream.uniform() < 0.6 {
            let glow = stream.between(0.85, 1.0);
            canvas.rectangle([x, 4.0], [x + width, 5.6], [222.0, 230.0, 238.0].map(|value| value * glow));
        }
        x += width + stream.between(0.5, 0.9);
    }
}

fn ceiling(half: DVec2, stream: &mut Stream) -> Sheet {
    let (width, depth) = (2.0 * half.x, 2.0 * half.y);
    let mut canvas = Canvas::new(width, depth, 0.08, [138.0, 136.0, 132.0]);
    canvas.mottle(stream, 4.0, 0.08);
    let mut beam = 1.0;
    while beam < width {
        canvas.rectangle([beam, 0.0], [beam + 0.35, depth], [104.0, 100.0, 96.0]);
        beam += 3.0;
    }
    let mut row = 1.5;
    while row < depth {
        let mut column = 1.8;
        while column < width {
            canvas.rectangle([column, row], [column + 1.5, row + 0.35], [250.0, 250.0, 244.0]);
            column += 3.0;
        }
        row += 2.4;
    }
    canvas.blur(2);
    canvas.finish()
}
