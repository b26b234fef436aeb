//! The exact map from pixels of the wanted view to pixels of a source image.
//!
//! The ray of a pixel meets the ground, a goal or what is far, and the source's lens draws that point. With C the position
//! of the wanted camera, r its unit ray and w the inverse distance of the point, a source at S with rotation R sees the
//! point in the direction R^T (r + w (C - S)). The formula holds for all surfaces; w is 0 for what is far. The map is
//! computed at the corners of cells of 8 x 8 pixels and interpolated in between. It is computed for each pixel where
//! interpolation would be wrong by more than a tenth of a pixel, where surfaces meet, and where a goal stands.

use glam::{DMat3, DVec2, DVec3, Vec2};

use super::camera::{AREA, CELL};
use super::raster::{NOTHING, UNSURE};
use super::target_rays::{
    RayHits, SOFT_EDGE_PX, Target, cells, corners, goal_cells, interpolate_cell, mask_value, rotated,
};
use super::world::{Goals, Hit, Surface};
use super::{Candidate, optical};
use realitysim_geometry::multiversioned;

/// The map from the wanted view into one source image.
#[derive(Clone, Debug)]
pub struct Warp<'a> {
    target: &'a Target<'a>,
    source: &'a Candidate<'a>,
    /// Position of the source's camera in `map`, metres.
    place: DVec3,
    source_from_map: DMat3,
    /// Source pixels at the corners of the cells; NaN where the source shows nothing.
    nodes: Vec<[f32; 2]>,
    /// For each cell of the view: whether the map is computed for each pixel.
    exact: Vec<bool>,
    /// For each cell of the source: whether a goal can appear in it. Empty without goals.
    goal_cells: Vec<bool>,
    /// Bounding box of these cells in the source, pixels.
    goal_box: [Vec2; 2],
    /// The goals as seen from the source.
    goals: Goals,
}

/// Source coordinates of the pixels of a cell, row by row; NaN where the source does not show them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Patch {
    pub(super) u: [f32; AREA],
    pub(super) v: [f32; AREA],
    /// Mask value of each pixel: [`SURE`](super::raster::SURE), [`UNSURE`] or [`NOTHING`].
    pub(super) sure: [u8; AREA],
}

/// Largest error of interpolation at a cell's centre, pixels. Cells with a larger one are computed for each pixel.
const TOLERANCE_PX: f64 = 0.1;
/// Cells whose second differences imply a smaller error, in pixels, are accepted without computing the error at the centre.
const CERTAINLY_SMOOTH_PX: f32 = 0.04;

impl<'a> Warp<'a> {
    /// Computes the map at the corners of all cells of the view.
    pub fn new(target: &'a Target<'a>, source: &'a Candidate<'a>) -> Self {
        let map_from_optical = optical(&source.map_from_link);
        let source_from_map = DMat3::from_quat(map_from_optical.rotation).transpose();
        let place = map_from_optical.translation;
        let goal_cells = goal_cells(source.camera, &map_from_optical, target.world);
        let goal_box = box_of(&goal_cells, source.camera.cells().0);
        let goals = target.world.goals_from(place, SOFT_EDGE_PX / source.camera.lens().focal());
        let (nodes, exact) = (Vec::new(), Vec::new());
        let mut warp = Self { target, source, place, source_from_map, nodes, exact, goal_cells, goal_box, goals };
        let drawn = target.node_hits.iter().map(|hits| warp.drawn(hits));
        warp.nodes = drawn.flat_map(|Patch { u, v, .. }| u.into_iter().zip(v).map(|(u, v)| [u, v])).collect();
        warp.nodes.truncate(target.nodes.len());
        let (columns, rows) = target.camera.cells();
        warp.exact = cells(columns, rows)
            .zip(&target.mixed)
            .map(|(cell, mixed)| mixed.is_some() || !warp.is_smooth(cell))
            .collect();
        warp
    }

    pub(super) fn source(&self) -> &'a Candidate<'a> {
        self.source
    }

    /// The pixel at which the source draws the corner of a cell; NaN if it does not.
    pub(super) fn node(&self, node: usize) -> [f32; 2] {
        self.nodes[node]
    }

    /// Whether a goal can appear in the part of the source that shows this cell.
    pub(super) fn sees_goal_in(&self, cell: (usize, usize)) -> bool {
        let at = corners(self.target.camera.cells().0, cell);
        let [a, b, c, d] = at.map(|corner| Vec2::from_array(self.nodes[corner]));
        self.has_goal(a.min(b).min(c).min(d), a.max(b).max(c).max(d))
    }

    /// Position of the source's camera in `map`, metres.
    pub(super) fn place(&self) -> DVec3 {
        self.place
    }

    /// Distance between both cameras, metres.
    pub(super) fn baseline_m(&self) -> f64 {
        self.place.distance(self.target.place)
    }

    /// The pixel at which the source draws the point that a unit ray of the view meets.
    fn draw(&self, ray: DVec3, hit: Hit) -> Option<DVec2> {
        let seen = ray + hit.inverse_distance * (self.target.place - self.place);
        self.source.camera.projector().project(self.source_from_map * seen)
    }

    /// Whether interpolation between the corners is accurate enough and no goal can hide anything in the source.
    fn is_smooth(&self, cell: (usize, usize)) -> bool {
        let (columns, rows) = self.target.camera.cells();
        let node = |node: usize| Vec2::from_array(self.nodes[node]);
        let [a, b, c, d] = corners(columns, cell).map(node);
        if self.has_goal(a.min(b).min(c).min(d), a.max(b).max(c).max(d)) {
            return false;
        }
        // In the middle, interpolation is wrong by an eighth of the second differences.
        let bend = |before: usize, at: usize, after: usize| (node(before) - 2.0 * node(at) + node(after)).abs();
        let (column, row) = (cell.0.clamp(1, columns - 1), cell.1.clamp(1, rows - 1));
        let at = row * (columns + 1) + column;
        let bends = bend(at - 1, at, at + 1) + bend(at - columns - 1, at, at + columns + 1);
        bends.max_element() < CERTAINLY_SMOOTH_PX * 8.0
            || self.centre_error(cell, ((a + b + c + d) / 4.0).as_dvec2()) <= TOLERANCE_PX
    }

    /// Error of interpolation at the centre of a cell, pixels; infinite where a corner is not drawn.
    fn centre_error(&self, (column, row): (usize, usize), interpolated: DVec2) -> f64 {
        let camera = self.target.camera;
        let (u, v) = (column * CELL + CELL / 2, row * CELL + CELL / 2);
        if interpolated.x.is_nan() || u >= camera.width() || v >= camera.height() {
            return f64::INFINITY;
        }
        let centre = self.target.ray_hit(u, v, false).and_then(|(ray, hit)| self.draw(ray, hit));
        centre.map_or(f64::INFINITY, |centre| centre.distance(interpolated))
    }

    /// Whether a goal can appear within this rectangle of the source.
    fn has_goal(&self, low: Vec2, high: Vec2) -> bool {
        let [from, to] = self.goal_box;
        // The comparison is false for NaN.
        if !(high.cmpge(from) & low.cmplt(to)).all() {
            return false;
        }
        let (columns, rows) = self.source.camera.cells();
        let place = |value: f32, count: usize| ((value.max(0.0) as usize) / CELL).min(count - 1);
        (place(low.y, rows)..=place(high.y, rows))
            .any(|row| self.goal_cells[row * columns..][place(low.x, columns)..=place(high.x, columns)].contains(&true))
    }

    /// The source pixel that shows what this pixel of the view shows, and the surface that it is. Computed without interpolation.
    pub fn pixel(&self, u: usize, v: usize) -> Option<(DVec2, Surface)> {
        let (ray, hit) = self.target.ray_hit(u, v, true)?;
        self.unhidden(ray, hit)
    }

    /// The pixel at which the source draws the point that a ray of the view meets, or `None` if a goal hides it there.
    fn unhidden(&self, ray: DVec3, hit: Hit) -> Option<(DVec2, Surface)> {
        let at = self.draw(ray, hit)?;
        let hidden = hit.surface != Surface::Goal
            && self.has_goal(at.as_vec2(), at.as_vec2())
            && self.is_hidden(ray, hit.inverse_distance);
        (!hidden).then_some((at, hit.surface))
    }

    /// Whether a goal hides, from the source, the point at this inverse distance along a ray of the view.
    fn is_hidden(&self, ray: DVec3, inverse_distance: f64) -> bool {
        let seen = ray + inverse_distance * (self.target.place - self.place);
        let length = seen.length();
        self.goals.hides(seen / length, inverse_distance / length)
    }

    /// The same as [`Self::pixel`], with interpolation where that is accurate enough: the map that views are made with.
    pub fn interpolated(&self, u: usize, v: usize) -> Option<(DVec2, Surface)> {
        let patch = self.patch(u / CELL, v / CELL);
        let index = v % CELL * CELL + u % CELL;
        let surface = match patch.sure[index] {
            NOTHING => return None,
            UNSURE => Surface::Far,
            _ => Surface::Ground,
        };
        Some((DVec2::new(f64::from(patch.u[index]), f64::from(patch.v[index])), surface))
    }

    /// Whether the source draws any corner of a cell.
    pub(super) fn may_show(&self, column: usize, row: usize) -> bool {
        let (columns, _) = self.target.camera.cells();
        corners(columns, (column, row)).iter().any(|corner| !self.nodes[*corner][0].is_nan())
    }

    /// The map for the pixels of a cell.
    pub(super) fn patch(&self, column: usize, row: usize) -> Patch {
        let (columns, _) = self.target.camera.cells();
        if self.exact[row * columns + column] {
            self.patch_by_pixel(column, row)
        } else {
            self.patch_by_corners(column, row)
        }
    }

    fn patch_by_corners(&self, column: usize, row: usize) -> Patch {
        let (columns, _) = self.target.camera.cells();
        let at = corners(columns, (column, row));
        let corners = at.map(|corner| self.nodes[corner]);
        let sure = self.target.surface_at(at[0]).map_or(NOTHING, mask_value);
        let mut patch = multiversioned!(|corners: [[f32; 2]; 4], sure: u8| -> Patch {
            let [[au, av], [bu, bv], [cu, cv], [du, dv]] = corners;
            Patch { u: interpolate_cell([au, bu, cu, du]), v: interpolate_cell([av, bv, cv, dv]), sure: [sure; AREA] }
        });
        // Pixels that interpolate from an undrawn corner are not shown.
        if corners.iter().any(|[u, v]| (u + v).is_nan()) {
            for i in 0..AREA {
                if (patch.u[i] + patch.v[i]).is_nan() {
                    patch.sure[i] = NOTHING;
                }
            }
        }
        patch
    }

    fn patch_by_pixel(&self, column: usize, row: usize) -> Patch {
        let (columns, _) = self.target.camera.cells();
        match &self.target.mixed[row * columns + column] {
            Some(hits) => self.draw_all(hits),
            None => self.draw_all(&self.target.ray_hits((column, row), false)),
        }
    }

    /// The map of a cell as if no goal hid anything in the source, marked unsure. It is used where a goal hides the cell in every source.
    pub(super) fn patch_through_goals(&self, column: usize, row: usize) -> Patch {
        let hits = self.target.ray_hits((column, row), false);
        Patch { sure: [UNSURE; AREA], ..self.drawn(&hits) }
    }

    /// The map of a cell computed for each pixel, leaving out what a goal hides in the source.
    fn draw_all(&self, hits: &RayHits) -> Patch {
        let mut patch = self.drawn(hits);
        if self.goal_cells.is_empty() {
            return patch;
        }
        let hidden = self.goals.hides_each(&self.seen(hits), &hits.inverse_distances);
        for (i, hidden) in hidden.into_iter().enumerate() {
            if hidden && !hits.goal[i] {
                (patch.u[i], patch.v[i], patch.sure[i]) = (f32::NAN, f32::NAN, NOTHING);
            }
        }
        patch
    }

    /// The directions, in `map`, in which the source sees the points that the view's rays meet.
    #[inline(always)]
    fn seen(&self, hits: &RayHits) -> [[f32; AREA]; 3] {
        let apart = (self.target.place - self.place).as_vec3();
        let [mut x, mut y, mut z] = hits.rays;
        for (i, nearness) in hits.inverse_distances.iter().enumerate() {
            x[i] += nearness * apart.x;
            y[i] += nearness * apart.y;
            z[i] += nearness * apart.z;
        }
        [x, y, z]
    }

    /// Projects the points that the view's rays meet into the source.
    fn drawn(&self, hits: &RayHits) -> Patch {
        let warp = self;
        multiversioned!(|warp: &Warp, hits: &RayHits| -> Patch {
            let seen = rotated(&warp.source_from_map, &warp.seen(hits));
            let [u, v] = warp.source.camera.projector().project_all(&seen);
            let mut sure = hits.sure;
            for (sure, u) in sure.iter_mut().zip(&u) {
                *sure = if u.is_nan() { NOTHING } else { *sure };
            }
            Patch { u, v, sure }
        })
    }

    /// Distance in pixels between where view and source draw the same ground, root mean square.
    pub(super) fn rms_shift_px(&self) -> f64 {
        let (columns, _) = self.target.camera.cells();
        let (mut sum, mut count) = (0.0, 0usize);
        for (index, [u, v]) in self.nodes.iter().enumerate() {
            if !u.is_nan() && self.target.surface_at(index) == Some(Surface::Ground) {
                let (column, row) = (index % (columns + 1), index / (columns + 1));
                let shift =
                    DVec2::new(f64::from(*u), f64::from(*v)) - DVec2::new((column * CELL) as f64, (row * CELL) as f64);
                sum += shift.length_squared();
                count += 1;
            }
        }
        libm::sqrt(sum / count.max(1) as f64)
    }
}

/// Bounding box of all marked cells, pixels. It is empty (from infinity to minus infinity) if no cell is marked.
fn box_of(cells: &[bool], columns: usize) -> [Vec2; 2] {
    let marked = cells.iter().enumerate().filter(|(_, marked)| **marked);
    let corner = |index: usize| Vec2::new((index % columns * CELL) as f32, (index / columns * CELL) as f32);
    marked.fold([Vec2::INFINITY, Vec2::NEG_INFINITY], |[from, to], (index, _)| {
        [from.min(corner(index)), to.max(corner(index) + CELL as f32)]
    })
}
