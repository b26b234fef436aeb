//! Partition of the image into square tiles, so that a figure is searched only where it can be visible.

use core::ops::Range;

use super::rays::RayTable;

/// All tiles of the image that the lens sees.
#[derive(Clone, Debug)]
pub(super) struct Tiles {
    tiles: Vec<Tile>,
}

/// A tile of neighbouring pixels with a cone around their rays.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
    cone: Cone,
}

/// A bounding ball as the camera sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ball {
    /// Cone around the ball, or `None` if the camera is inside the ball.
    cone: Option<Cone>,
}

/// A circular cone with its apex at the camera.
#[derive(Clone, Copy, Debug)]
struct Cone {
    /// Unit vector in `camera_link`.
    axis: [f32; 3],
    /// Cosine and sine of the half-angle, which is at most a right angle.
    cos: f32,
    sin: f32,
}

/// Side of a tile, pixels.
const SIDE: usize = 8;
/// Margin of the cone around the outermost pixel centres, because pixels have an extent and rays are not exact.
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
    /// The tile, or `None` if the lens sees nothing there.
    fn new(rays: &RayTable, columns: Range<usize>, rows: Range<usize>) -> Option<Self> {
        let sees = |row: usize| {
            let seen = rays.visible_columns(row);
            seen.start.max(columns.start) < seen.end.min(columns.end)
        };
        if !rows.clone().any(sees) {
            return None;
        }
        let axis = normalised(rays.at((columns.start + columns.end) / 2, (rows.start + rows.end) / 2));
        let angle = |column: usize, row: usize| angle_between(axis, normalised(rays.padded(column, row)));
        // All pixels of the tile and one pixel around it, in indices of the padded table.
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

    /// Whether a pixel of the tile may see a part of the ball.
    #[inline]
    pub(super) fn may_see(&self, ball: &Ball) -> bool {
        let Some(ball) = &ball.cone else { return true };
        // The sum of both angles is at most 180 degrees, where the cosine is monotonic.
        dot(self.cone.axis, ball.axis) >= self.cone.cos * ball.cos - self.cone.sin * ball.sin
    }
}

impl Ball {
    /// A ball with its `centre` in `camera_link`, metres.
    pub(super) fn new(centre: [f32; 3], radius: f32) -> Self {
        let distance = dot(centre, centre).sqrt();
        // The comparison is false for NaN.
        let cone = (distance > radius).then(|| {
            let sin = radius / distance;
            Cone { axis: centre.map(|value| value / distance), cos: (1.0 - sin * sin).sqrt(), sin }
        });
        Self { cone }
    }
}

fn angle_between(a: [f32; 3], b: [f32; 3]) -> f32 {
    let difference: [f32; 3] = core::array::from_fn(|i| a[i] - b[i]);
    // Unlike the arc cosine, this is exact for small angles.
    2.0 * libm::asinf((0.5 * dot(difference, difference).sqrt()).min(1.0))
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn normalised(v: [f32; 3]) -> [f32; 3] {
    let length = dot(v, v).sqrt().max(1e-9);
    v.map(|value| value / length)
}
