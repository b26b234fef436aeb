//! The image in squares of rays, so that a thing is only looked for where it can be.

use super::rays::RayTable;

#[derive(Clone, Debug)]
pub(super) struct Tiles {
    tiles: Vec<Tile>,
}

/// Some neighbouring pixels and a cone around their rays.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    pub(super) columns: core::ops::Range<usize>,
    pub(super) rows: core::ops::Range<usize>,
    /// In `camera_link`, of unit length.
    axis: [f32; 3],
    /// Between axis and cone, radians.
    angle: f32,
}

const SIDE: usize = 16;
/// Rays go a pixel beyond the outermost pixels' centres; so much more than to those centres.
const MARGIN: f32 = 1.2;

impl Tiles {
    pub(super) fn new(rays: &RayTable) -> Self {
        let (width, height) = (rays.width(), rays.height());
        let tiles = (0..height.div_ceil(SIDE) * width.div_ceil(SIDE)).filter_map(|at| {
            let (left, top) = (at % width.div_ceil(SIDE) * SIDE, at / width.div_ceil(SIDE) * SIDE);
            Tile::new(rays, left..(left + SIDE).min(width), top..(top + SIDE).min(height))
        });
        Self { tiles: tiles.collect() }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Tile> {
        self.tiles.iter()
    }
}

impl Tile {
    /// None where the lens sees nothing.
    fn new(rays: &RayTable, columns: core::ops::Range<usize>, rows: core::ops::Range<usize>) -> Option<Self> {
        if rows.clone().all(|row| columns.clone().all(|column| !rays.seen(row).contains(&column))) {
            return None;
        }
        let axis = normalised(rays.at((columns.start + columns.end) / 2, (rows.start + rows.end) / 2));
        let least = rows
            .clone()
            .flat_map(|row| columns.clone().map(move |column| (column, row)))
            .map(|(column, row)| dot(axis, normalised(rays.at(column, row))))
            .fold(1.0, f32::min);
        // One pixel more on each side of a tile of a single pixel still needs some room.
        let angle = MARGIN * libm::acosf(least.clamp(-1.0, 1.0)) + 0.02;
        Some(Self { columns, rows, axis, angle })
    }

    /// Whether a pixel can see any of a ball at this place in `camera_link`.
    pub(super) fn may_see(&self, centre: [f32; 3], radius: f32) -> bool {
        let distance = dot(centre, centre).sqrt();
        // Also for a NaN.
        if !(distance > radius) {
            return true;
        }
        let off_axis = libm::acosf((dot(self.axis, centre) / distance).clamp(-1.0, 1.0));
        off_axis <= self.angle + libm::asinf(radius / distance)
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalised(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt().max(1e-9);
    v.map(|value| value / length)
}
