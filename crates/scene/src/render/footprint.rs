//! Intersection of pixel rays with the ground, row by row, and the footprint of each pixel on the ground.

use super::rays::RayTable;

/// One row of rays rotated into `map`, with one extra pixel at each end.
pub(super) struct Turned {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
}

/// Points at which the rays of a row meet the plane z = 0. They have no meaning for rays that do not point down.
///
/// The fields are those of [`GroundPoint`], one value per column.
pub(super) struct GroundRow {
    x: Vec<f32>,
    y: Vec<f32>,
    xu: Vec<f32>,
    yu: Vec<f32>,
    xv: Vec<f32>,
    yv: Vec<f32>,
    down_u: Vec<f32>,
    down_v: Vec<f32>,
    size2: Vec<f32>,
    reach: Vec<f32>,
}

/// The point on the ground that a pixel shows, and its footprint.
#[derive(Clone, Copy, Debug)]
pub(super) struct GroundPoint {
    /// Position in `map`, metres.
    pub(super) x: f32,
    pub(super) y: f32,
    /// Step of the position from column to column, metres per pixel.
    pub(super) xu: f32,
    pub(super) yu: f32,
    /// Step of the position from row to row, metres per pixel.
    pub(super) xv: f32,
    pub(super) yv: f32,
    /// Downward component of the unit ray, above 0.
    pub(super) down: f32,
    /// Change of the downward component from column to column and from row to row.
    pub(super) down_u: f32,
    pub(super) down_v: f32,
    /// Square of the size of the footprint, square metres: the sum of squares of both steps.
    pub(super) size2: f32,
    /// Radius around the point outside of which the pixel sees nothing, metres.
    pub(super) reach: f32,
}

/// Reach of a pixel in footprints. The tent filter reaches one pixel, the rest allows for the change of the footprint within it.
const FOOTPRINTS: f32 = 1.5;

impl Turned {
    pub(super) fn new(width: usize) -> Self {
        let row = || vec![0.0; width + 2];
        Self { x: row(), y: row(), z: row() }
    }

    /// Rotates a row of rays into `map`. `rotation` is a 3 x 3 matrix, column by column.
    pub(super) fn turn(&mut self, rays: &RayTable, padded_row: usize, rotation: &[f32; 9]) {
        let [x, y, z] = rays.padded_row(padded_row);
        let r = rotation;
        let count = self.x.len();
        let (x, y, z) = (&x[..count], &y[..count], &z[..count]);
        let (to_x, to_y, to_z) = (&mut self.x[..count], &mut self.y[..count], &mut self.z[..count]);
        for i in 0..count {
            to_x[i] = r[0] * x[i] + r[3] * y[i] + r[6] * z[i];
            to_y[i] = r[1] * x[i] + r[4] * y[i] + r[7] * z[i];
            to_z[i] = r[2] * x[i] + r[5] * y[i] + r[8] * z[i];
        }
    }

    #[inline]
    pub(super) fn direction(&self, column: usize) -> [f32; 3] {
        [self.x[column + 1], self.y[column + 1], self.z[column + 1]]
    }
}

impl GroundRow {
    pub(super) fn new(width: usize) -> Self {
        let row = || vec![0.0; width];
        let [x, y, xu, yu, xv, yv] = core::array::from_fn(|_| row());
        Self { x, y, xu, yu, xv, yv, down_u: row(), down_v: row(), size2: row(), reach: row() }
    }

    /// Intersects a row with the ground. The rows above and below give the derivatives.
    ///
    /// With t = -c.z / d.z the point is c + t d, and its derivative is t (d' - d d'.z / d.z).
    // Never inlined: the compiler vectorizes the loop only in a function of its own.
    #[inline(never)]
    pub(super) fn meet(&mut self, above: &Turned, here: &Turned, below: &Turned, camera: &[f32; 3]) {
        let n = self.x.len();
        let padded = n + 2;
        let (dx, dy, dz) = (&here.x[..padded], &here.y[..padded], &here.z[..padded]);
        let (ax, ay, az) = (&above.x[..padded], &above.y[..padded], &above.z[..padded]);
        let (bx, by, bz) = (&below.x[..padded], &below.y[..padded], &below.z[..padded]);
        let (x, y) = (&mut self.x[..n], &mut self.y[..n]);
        let (xu, yu) = (&mut self.xu[..n], &mut self.yu[..n]);
        let (xv, yv) = (&mut self.xv[..n], &mut self.yv[..n]);
        let (down_u, down_v) = (&mut self.down_u[..n], &mut self.down_v[..n]);
        let (size2, reach) = (&mut self.size2[..n], &mut self.reach[..n]);
        for i in 0..n {
            let inverse = 1.0 / dz[i + 1];
            let t = -camera[2] * inverse;
            let (rx, ry) = (dx[i + 1] * inverse, dy[i + 1] * inverse);
            x[i] = camera[0] - camera[2] * rx;
            y[i] = camera[1] - camera[2] * ry;
            let half = 0.5 * t;
            let zu = dz[i + 2] - dz[i];
            xu[i] = half * ((dx[i + 2] - dx[i]) - rx * zu);
            yu[i] = half * ((dy[i + 2] - dy[i]) - ry * zu);
            let zv = bz[i + 1] - az[i + 1];
            xv[i] = half * ((bx[i + 1] - ax[i + 1]) - rx * zv);
            yv[i] = half * ((by[i + 1] - ay[i + 1]) - ry * zv);
            down_u[i] = -0.5 * zu;
            down_v[i] = -0.5 * zv;
        }
        // A second loop, because the compiler does not vectorize the one above if it has more outputs.
        for i in 0..n {
            let s = xu[i] * xu[i] + yu[i] * yu[i] + xv[i] * xv[i] + yv[i] * yv[i];
            size2[i] = s;
            reach[i] = FOOTPRINTS * s.sqrt();
        }
    }

    #[inline]
    /// The point of one column. `down` is the downward component of its ray.
    pub(super) fn point(&self, column: usize, down: f32) -> GroundPoint {
        GroundPoint {
            x: self.x[column],
            y: self.y[column],
            xu: self.xu[column],
            yu: self.yu[column],
            xv: self.xv[column],
            yv: self.yv[column],
            down,
            down_u: self.down_u[column],
            down_v: self.down_v[column],
            size2: self.size2[column],
            reach: self.reach[column],
        }
    }
}

impl GroundPoint {
    /// Signed distance in pixels from this pixel to a line on the ground, and pixels per metre there.
    ///
    /// `s` is the signed distance to the line in metres, which grows along the unit vector (nx, ny). The product of s and
    /// the downward component of the ray is linear in the ray, because camera and line span a plane. So it is nearly
    /// linear in pixels. s itself is not: towards the horizon it grows without bound within a pixel.
    #[inline]
    pub(super) fn pixels_to(&self, s: f32, nx: f32, ny: f32) -> (f32, f32) {
        let gu = s * self.down_u + self.down * (nx * self.xu + ny * self.yu);
        let gv = s * self.down_v + self.down * (nx * self.xv + ny * self.yv);
        let pixels_per_metre = self.down / (gu * gu + gv * gv).sqrt().max(1e-12);
        (s * pixels_per_metre, pixels_per_metre)
    }
}

/// Share of a pixel that lies on the positive side of an edge at signed distance `pixels`.
///
/// It is the integral of a tent filter two pixels wide. A box filter would snap thin lines to whole pixels. The tent keeps
/// their centre exact, as real optics do.
#[inline]
pub(super) fn tent_integral(pixels: f32) -> f32 {
    let t = pixels.clamp(-1.0, 1.0);
    0.5 + t - 0.5 * t * t.abs()
}
