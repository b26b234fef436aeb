//! The exact map: where in a source image lies what a pixel of the wanted view shows?
//!
//! A pixel's ray meets ground, goal or what is far; that place is drawn by the source's lens. With C the wanted
//! camera's place, r its unit ray and w the inverse distance of what it meets, the source (at S, rotation R) sees it in
//! the direction R^T (r + w (C - S)): one formula for all surfaces, w being 0 for what is far. The map is calculated at
//! the corners of cells of 8 x 8 pixels and interpolated in between; pixel by pixel where that would be wrong by more
//! than a tenth of a pixel, where surfaces meet, and where a goal stands.

use glam::{DMat3, DVec2, DVec3, Vec2};

use super::camera::{AREA, CELL};
use super::raster::{NOTHING, UNSURE};
use super::target_rays::{RayHits, SOFT_EDGE_PX, Target, between, cells, corners, goal_cells, sureness, turned};
use super::world::{Goals, Hit, Surface};
use super::{Candidate, optical};
use realitysim_geometry::multiversioned;

/// The map into one source.
#[derive(Clone, Debug)]
pub struct Warp<'a> {
    target: &'a Target<'a>,
    source: &'a Candidate<'a>,
    place: DVec3,
    source_from_map: DMat3,
    /// Source pixels at the corners of the cells; NaN where the source sees nothing.
    nodes: Vec<[f32; 2]>,
    /// By cell: to be calculated pixel by pixel.
    exact: Vec<bool>,
    /// By cell of the source: a goal can be seen in it. Empty without goals.
    goal_cells: Vec<bool>,
    /// Source pixels from and to which there are any of these.
    goal_box: [Vec2; 2],
    goals: Goals,
}

/// Where the pixels of a cell lie in the source, row by row; NaN for those that it does not show.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Patch {
    pub(super) u: [f32; AREA],
    pub(super) v: [f32; AREA],
    /// [`SURE`], [`UNSURE`] or [`NOTHING`].
    pub(super) sure: [u8; AREA],
}

/// A cell whose centre is interpolated worse than this is calculated pixel by pixel.
const TOLERANCE_PX: f64 = 0.1;
/// By the second differences at one corner: less than this is not looked at more closely.
const CERTAINLY_SMOOTH_PX: f32 = 0.04;

impl<'a> Warp<'a> {
    pub fn new(target: &'a Target<'a>, source: &'a Candidate<'a>) -> Self {
        let map_from_optical = optical(&source.map_from_link);
        let source_from_map = DMat3::from_quat(map_from_optical.rotation).transpose();
        let place = map_from_optical.translation;
        let goal_cells = goal_cells(source.camera, &map_from_optical, target.world);
        let goal_box = box_of(&goal_cells, source.camera.cells().0);
        let goals = target.world.goals_from(place, SOFT_EDGE_PX / source.camera.lens().focal());
        let (nodes, exact) = (Vec::new(), Vec::new());
        let mut warp = Self { target, source, place, source_from_map, nodes, exact, goal_cells, goal_box, goals };
        let drawn = target.node_looks.iter().map(|looks| warp.drawn(looks));
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

    /// Where the source draws the corner of a cell; NaN if it does not.
    pub(super) fn node(&self, node: usize) -> [f32; 2] {
        self.nodes[node]
    }

    /// Whether the source has a goal where it shows this cell.
    pub(super) fn sees_goal_in(&self, cell: (usize, usize)) -> bool {
        let at = corners(self.target.camera.cells().0, cell);
        let [a, b, c, d] = at.map(|corner| Vec2::from_array(self.nodes[corner]));
        self.has_goal(a.min(b).min(c).min(d), a.max(b).max(c).max(d))
    }

    /// Metres between both cameras.
    pub(super) fn baseline_m(&self) -> f64 {
        self.place.distance(self.target.place)
    }

    fn draw(&self, ray: DVec3, hit: Hit) -> Option<DVec2> {
        let seen = ray + hit.inverse_distance * (self.target.place - self.place);
        self.source.camera.projector().project(self.source_from_map * seen)
    }

    /// Whether interpolation between the corners is good enough, and nothing stands in the source's way.
    fn is_smooth(&self, cell: (usize, usize)) -> bool {
        let (columns, rows) = self.target.camera.cells();
        let node = |node: usize| Vec2::from_array(self.nodes[node]);
        let [a, b, c, d] = corners(columns, cell).map(node);
        if self.has_goal(a.min(b).min(c).min(d), a.max(b).max(c).max(d)) {
            return false;
        }
        // An eighth of the second differences is what interpolation gets wrong in the middle.
        let bend = |before: usize, at: usize, after: usize| (node(before) - 2.0 * node(at) + node(after)).abs();
        let (column, row) = (cell.0.clamp(1, columns - 1), cell.1.clamp(1, rows - 1));
        let at = row * (columns + 1) + column;
        let bends = bend(at - 1, at, at + 1) + bend(at - columns - 1, at, at + columns + 1);
        bends.max_element() < CERTAINLY_SMOOTH_PX * 8.0
            || self.centre_error(cell, ((a + b + c + d) / 4.0).as_dvec2()) <= TOLERANCE_PX
    }

    /// How far interpolation is off in the middle of a cell; infinite where a corner is not drawn.
    fn centre_error(&self, (column, row): (usize, usize), interpolated: DVec2) -> f64 {
        let camera = self.target.camera;
        let (u, v) = (column * CELL + CELL / 2, row * CELL + CELL / 2);
        if interpolated.x.is_nan() || u >= camera.width() || v >= camera.height() {
            return f64::INFINITY;
        }
        let centre = self.target.look(u, v, false).and_then(|(ray, hit)| self.draw(ray, hit));
        centre.map_or(f64::INFINITY, |centre| centre.distance(interpolated))
    }

    /// Whether the source has a goal within this rectangle.
    fn has_goal(&self, low: Vec2, high: Vec2) -> bool {
        let [from, to] = self.goal_box;
        // Not for NaN.
        if !(high.cmpge(from) & low.cmplt(to)).all() {
            return false;
        }
        let (columns, rows) = self.source.camera.cells();
        let place = |value: f32, count: usize| ((value.max(0.0) as usize) / CELL).min(count - 1);
        (place(low.y, rows)..=place(high.y, rows))
            .any(|row| self.goal_cells[row * columns..][place(low.x, columns)..=place(high.x, columns)].contains(&true))
    }

    /// Where the source shows what this pixel of the view shows, and what that is.
    pub fn pixel(&self, u: usize, v: usize) -> Option<(DVec2, Surface)> {
        let (ray, hit) = self.target.look(u, v, true)?;
        self.unhidden(ray, hit)
    }

    /// Where the source draws what a ray of the view meets, unless a goal hides it there.
    fn unhidden(&self, ray: DVec3, hit: Hit) -> Option<(DVec2, Surface)> {
        let at = self.draw(ray, hit)?;
        let hidden = hit.surface != Surface::Goal
            && self.has_goal(at.as_vec2(), at.as_vec2())
            && self.is_hidden(ray, hit.inverse_distance);
        (!hidden).then_some((at, hit.surface))
    }

    /// Whether a goal stands before what lies at this inverse distance along a ray of the view.
    fn is_hidden(&self, ray: DVec3, inverse_distance: f64) -> bool {
        let seen = ray + inverse_distance * (self.target.place - self.place);
        let length = seen.length();
        self.goals.hide(seen / length, inverse_distance / length)
    }

    /// The same by interpolation where that is good enough: what views are made with.
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

    /// Whether any corner of a cell is drawn by the source.
    pub(super) fn may_show(&self, column: usize, row: usize) -> bool {
        let (columns, _) = self.target.camera.cells();
        corners(columns, (column, row)).iter().any(|corner| !self.nodes[*corner][0].is_nan())
    }

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
        let sure = self.target.surface_at(at[0]).map_or(NOTHING, sureness);
        let mut patch = multiversioned!(|corners: [[f32; 2]; 4], sure: u8| -> Patch {
            let [[au, av], [bu, bv], [cu, cv], [du, dv]] = corners;
            Patch { u: between([au, bu, cu, du]), v: between([av, bv, cv, dv]), sure: [sure; AREA] }
        });
        // A corner that the source does not draw says nothing of the places near it.
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
            Some(looks) => self.draw_all(looks),
            None => self.draw_all(&self.target.looks((column, row), false)),
        }
    }

    /// The cell as if no goal stood in the source's way, and so unsure: better than black, where every source has one.
    pub(super) fn patch_through_goals(&self, column: usize, row: usize) -> Patch {
        let looks = self.target.looks((column, row), false);
        Patch { sure: [UNSURE; AREA], ..self.drawn(&looks) }
    }

    /// Where the source draws what the view's rays meet, unless a goal hides it there.
    fn draw_all(&self, looks: &RayHits) -> Patch {
        let mut patch = self.drawn(looks);
        if self.goal_cells.is_empty() {
            return patch;
        }
        let hidden = self.goals.hide_all(&self.seen(looks), &looks.inverse_distances);
        for (i, hidden) in hidden.into_iter().enumerate() {
            if hidden && !looks.goal[i] {
                (patch.u[i], patch.v[i], patch.sure[i]) = (f32::NAN, f32::NAN, NOTHING);
            }
        }
        patch
    }

    /// In which directions the source sees what the view's rays meet, in `map`.
    #[inline(always)]
    fn seen(&self, looks: &RayHits) -> [[f32; AREA]; 3] {
        let apart = (self.target.place - self.place).as_vec3();
        let [mut x, mut y, mut z] = looks.rays;
        for (i, nearness) in looks.inverse_distances.iter().enumerate() {
            x[i] += nearness * apart.x;
            y[i] += nearness * apart.y;
            z[i] += nearness * apart.z;
        }
        [x, y, z]
    }

    fn drawn(&self, looks: &RayHits) -> Patch {
        let warp = self;
        multiversioned!(|warp: &Warp, looks: &RayHits| -> Patch {
            let seen = turned(&warp.source_from_map, &warp.seen(looks));
            let [u, v] = warp.source.camera.projector().project_all(&seen);
            let mut sure = looks.sure;
            for (sure, u) in sure.iter_mut().zip(&u) {
                *sure = if u.is_nan() { NOTHING } else { *sure };
            }
            Patch { u, v, sure }
        })
    }

    /// How far apart view and source draw the same ground, root mean square.
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

/// Around all cells that are marked, pixels; where none is, nothing lies within.
fn box_of(cells: &[bool], columns: usize) -> [Vec2; 2] {
    let marked = cells.iter().enumerate().filter(|(_, marked)| **marked);
    let corner = |index: usize| Vec2::new((index % columns * CELL) as f32, (index / columns * CELL) as f32);
    marked.fold([Vec2::INFINITY, Vec2::NEG_INFINITY], |[from, to], (index, _)| {
        [from.min(corner(index)), to.max(corner(index) + CELL as f32)]
    })
}
