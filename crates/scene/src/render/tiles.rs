//! The image in squares of rays, so that a thing is only looked for where it can be.

use core::ops::Range;

use super::rays::RayTable;

#[derive(Clone, Debug)]
pub(super) struct Tiles {
    tiles: Vec<Tile>,
}

/// Some neighbouring pixels and a cone around their rays.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
    cone: Cone,
}

/// A ball, as the camera sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    /// None around the camera.
    cone: Option<Cone>,
}

#[derive(Clone, Copy, Debug)]
struct Cone {
    /// In `camera_link`, of unit length.
    axis: [f32; 3],
    /// Of the angle between axis and mantle, at most a right angle.
    cos: f32,
    sin: f32,
}

const SIDE: usize = 8;
/// A pixel is looked at beyond its centre, and rays are not exact: so much more than to the outermost centre.
const MARGIN_PIXELS: f32 = 1.5;

impl Tiles {
    pub(super) fn new(rays: &RayTable) -> Self {
        let (width, height) = (rays.width(), rays.height());
        let tops = (0..height).step_by(SIDE);
        let tiles = tops.flat_map(|top| {
            let rows = top..(top + SIDE).min(height);
            (0..width)
                .step_by(SIDE)
                .filter_map(move |left| Tile::new(rays, left..(left + SIDE).min(width), rows.clone()))
        });
        Self { tiles: tiles.collect() }
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Tile> {
        self.tiles.iter()
    }
}

impl Tile {
    /// None where the lens sees nothing.
    fn new(rays: &RayTable, columns: Range<usize>, rows: Range<usize>) -> Option<Self> {
        let sees = |row: usize| {
            let seen = rays.seen(row);
            seen.start.max(columns.start) < seen.end.min(columns.end)
        };
        if !rows.clone().any(sees) {
            return None;
        }
        let axis = normalised(rays.at((columns.start + columns.end) / 2, (rows.start + rows.end) / 2));
        let angle = |column: usize, row: usize| angle_between(axis, normalised(rays.padded(column, row)));
        // One pixel around all of them, in the padded table's counting.
        let (right, bottom) = (columns.end + 1, rows.end + 1);
        let mut widest = 0f32;
        for row in rows.start..=bottom {
            for column in columns.start..=right {
                widest = widest.max(angle(column, row));
            }
        }
        let pixel = widest / (SIDE as f32 / 2.0);
        let angle = (widest + (MARGIN_PIXELS - 1.0) * pixel).min(core::f32::consts::FRAC_PI_2);
        Some(Self { columns, rows, cone: Cone { axis, cos: libm::cosf(angle), sin: libm::sinf(angle) } })
    }

    /// Whether a pixel can see any of it.
    #[inline]
    pub(super) fn may_see(&self, ball: &Ball) -> bool {
        let Some(ball) = &ball.cone else { return true };
        // Both angles together are at most half a turn: there the cosine falls throughout.
        dot(self.cone.axis, ball.axis) >= self.cone.cos * ball.cos - self.cone.sin * ball.sin
    }
}

impl Ball {
    /// `centre` in `camera_link`, in metres like `radius`.
    pub(super) fn new(centre: [f32; 3], radius: f32) -> Self {
        let distance = dot(centre, centre).sqrt();
        // Not for a NaN.
        let cone = (distance > radius).then(|| {
            let sin = radius / distance;
            Cone { axis: centre.map(|value| value / distance), cos: (1.0 - sin * sin).sqrt(), sin }
        });
        Self { cone }
    }
}

fn angle_between(a: [f32; 3], b: [f32; 3]) -> f32 {
    let difference: [f32; 3] = core::array::from_fn(|i| a[i] - b[i]);
    // Unlike the arc cosine exact for small angles.
    2.0 * libm::asinf((0.5 * dot(difference, difference).sqrt()).min(1.0))
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalised(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt().max(1e-9);
    v.map(|value| value / length)
}
