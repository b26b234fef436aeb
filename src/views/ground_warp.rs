//! The exact map: where in a source image lies what a pixel of the wanted view shows?
//!
//! A pixel's ray meets ground, goal or what is far; that place is drawn by the source's lens. With C the wanted
//! camera's place, r its unit ray and w the inverse distance of what it meets, the source (at S, rotation R) sees it in
//! the direction R^T (r + w (C - S)): one formula for all surfaces, w being 0 for what is far. The map is calculated at
//! the corners of cells of 8 x 8 pixels and interpolated in between; pixel by pixel where that would be wrong by more
//! than a tenth of a pixel, where surfaces meet, and where a goal stands.

use glam::{DMat3, DVec2, DVec3};

use super::Candidate;
use super::camera::{CELL, Camera};
use super::optical;
use super::raster::{NOTHING, SURE, UNSURE};
use super::world::{Goals, Hit, Surface, World};
use crate::geometry::Isometry;

/// The wanted view: what its rays meet. One for all sources.
#[derive(Clone, Debug)]
pub struct Target<'a> {
    camera: &'a Camera,
    world: &'a World,
    goals: Goals,
    /// Of the camera in `map`.
    place: DVec3,
    map_from_optical: DMat3,
    /// At the corners of the cells; `None` where the lens draws nothing.
    nodes: Vec<Option<(DVec3, Hit)>>,
    /// By cell: where surfaces meet, at the lens's edge, and where a goal stands, what each pixel meets.
    mixed: Vec<Option<Box<Looks>>>,
}

/// What the pixels of a cell meet, row by row, along which ray; `None` where the lens draws nothing.
type Looks = [Option<(DVec3, Hit)>; CELL * CELL];

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
    goals: Goals,
}

/// Where the pixels of a cell lie in the source, row by row; NaN for those that it does not show.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Patch {
    pub(super) u: [f32; CELL * CELL],
    pub(super) v: [f32; CELL * CELL],
    /// [`SURE`], [`UNSURE`] or [`NOTHING`].
    pub(super) sure: [u8; CELL * CELL],
}

/// A cell whose centre is interpolated worse than this is calculated pixel by pixel.
const TOLERANCE_PX: f64 = 0.1;
/// By the second differences at one corner: less than this is not looked at more closely.
const CERTAINLY_SMOOTH_PX: f64 = 0.04;
/// How many pixels wider than they are goals are taken to be: their edges are soft.
const SOFT_EDGE_PX: f64 = 1.2;

impl<'a> Target<'a> {
    pub fn new(camera: &'a Camera, map_from_link: &Isometry, world: &'a World) -> Self {
        let map_from_optical = optical(map_from_link);
        let (place, rotation) = (map_from_optical.translation, DMat3::from_quat(map_from_optical.rotation));
        let node = |ray: &DVec3| {
            let ray = rotation * *ray;
            (!ray.x.is_nan()).then(|| (ray, world.behind_goals(place, ray)))
        };
        let nodes: Vec<Option<(DVec3, Hit)>> = camera.node_rays().iter().map(node).collect();
        let (columns, rows) = camera.cells();
        let goals = goal_cells(camera, &map_from_optical, world);
        let seen_goals = world.goals_from(place, SOFT_EDGE_PX / camera.lens().focal());
        let mut target =
            Self { camera, world, goals: seen_goals, place, map_from_optical: rotation, nodes, mixed: Vec::new() };
        let looks = |(index, cell): (usize, (usize, usize))| {
            let surfaces = corners(columns, cell).map(|corner| target.surface_at(corner));
            let goal = goals.get(index).is_some_and(|goal| *goal);
            let mixed = surfaces[0].is_none() || surfaces.iter().any(|surface| *surface != surfaces[0]);
            let drawn = surfaces[0].is_some() || (0..CELL * CELL).any(|pixel| target.shows(cell, pixel));
            (drawn && (mixed || goal)).then(|| Box::new(target.looks(cell, goal)))
        };
        target.mixed = cells(columns, rows).enumerate().map(looks).collect();
        target
    }

    pub fn camera(&self) -> &'a Camera {
        self.camera
    }

    pub(super) fn node_count(&self) -> usize {
        self.nodes.len()
    }

    pub(super) fn surface_at(&self, node: usize) -> Option<Surface> {
        self.nodes[node].map(|(_, hit)| hit.surface)
    }

    /// Whether the lens draws this pixel of a cell.
    pub(super) fn shows(&self, (column, row): (usize, usize), index: usize) -> bool {
        let (u, v) = (column * CELL + index % CELL, row * CELL + index / CELL);
        u < self.camera.width() && v < self.camera.height() && self.camera.shows()[v * self.camera.width() + u]
    }

    fn looks(&self, (column, row): (usize, usize), goal: bool) -> Looks {
        core::array::from_fn(|index| {
            let (u, v) = (column * CELL + index % CELL, row * CELL + index / CELL);
            (u < self.camera.width() && v < self.camera.height()).then(|| self.look(u, v, goal)).flatten()
        })
    }

    /// The unit ray of a pixel in `map`, and what it meets.
    fn look(&self, u: usize, v: usize, goal: bool) -> Option<(DVec3, Hit)> {
        let ray = self.map_from_optical * self.camera.ray(u, v)?;
        let behind = self.world.behind_goals(self.place, ray);
        let hit = if goal { self.goals.before(ray, behind) } else { behind };
        Some((ray, hit))
    }

    /// What this pixel shows; `None` where the lens draws nothing.
    pub fn surface(&self, u: usize, v: usize) -> Option<Surface> {
        Some(self.look(u, v, true)?.1.surface)
    }
}

impl<'a> Warp<'a> {
    pub fn new(target: &'a Target<'a>, source: &'a Candidate<'a>) -> Self {
        let map_from_optical = optical(&source.map_from_link);
        let source_from_map = DMat3::from_quat(map_from_optical.rotation).transpose();
        let place = map_from_optical.translation;
        let goal_cells = goal_cells(source.camera, &map_from_optical, target.world);
        let goals = target.world.goals_from(place, SOFT_EDGE_PX / source.camera.lens().focal());
        let mut warp =
            Self { target, source, place, source_from_map, nodes: Vec::new(), exact: Vec::new(), goal_cells, goals };
        let nodes: Vec<DVec2> = target
            .nodes
            .iter()
            .map(|node| node.and_then(|(ray, hit)| warp.draw(ray, hit)).unwrap_or(DVec2::NAN))
            .collect();
        let (columns, rows) = target.camera.cells();
        warp.exact = cells(columns, rows)
            .zip(&target.mixed)
            .map(|(cell, mixed)| mixed.is_some() || !warp.is_smooth(cell, &nodes))
            .collect();
        warp.nodes = nodes.iter().map(|node| [node.x as f32, node.y as f32]).collect();
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
        let corners = at.map(|corner| self.nodes[corner].map(f64::from)).map(|[u, v]| DVec2::new(u, v));
        let [a, b, c, d] = corners;
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
    fn is_smooth(&self, cell: (usize, usize), nodes: &[DVec2]) -> bool {
        let (columns, rows) = self.target.camera.cells();
        let [a, b, c, d] = corners(columns, cell).map(|corner| nodes[corner]);
        if self.has_goal(a.min(b).min(c).min(d), a.max(b).max(c).max(d)) {
            return false;
        }
        // An eighth of the second differences is what interpolation gets wrong in the middle.
        let bend = |before: usize, at: usize, after: usize| (nodes[before] - 2.0 * nodes[at] + nodes[after]).abs();
        let (column, row) = (cell.0.clamp(1, columns - 1), cell.1.clamp(1, rows - 1));
        let at = row * (columns + 1) + column;
        let bends = bend(at - 1, at, at + 1) + bend(at - columns - 1, at, at + columns + 1);
        bends.max_element() < CERTAINLY_SMOOTH_PX * 8.0
            || self.centre_error(cell, (a + b + c + d) / 4.0) <= TOLERANCE_PX
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
    fn has_goal(&self, low: DVec2, high: DVec2) -> bool {
        if self.goal_cells.is_empty() {
            return false;
        }
        let (columns, rows) = self.source.camera.cells();
        let place = |value: f64, count: usize| ((value.max(0.0) as usize) / CELL).min(count - 1);
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
        if hit.surface != Surface::Goal && self.has_goal(at, at) {
            let seen = ray + hit.inverse_distance * (self.target.place - self.place);
            let length = seen.length();
            if self.goals.hide(seen / length, hit.inverse_distance / length) {
                return None;
            }
        }
        Some((at, hit.surface))
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
        let [a, b, c, d] = at.map(|corner| self.nodes[corner]);
        let sure = self.target.surface_at(at[0]).map_or(NOTHING, sureness);
        let mut patch = Patch { u: [0.0; CELL * CELL], v: [0.0; CELL * CELL], sure: [sure; CELL * CELL] };
        const STEP: f32 = 1.0 / CELL as f32;
        for line in 0..CELL {
            let down = line as f32 * STEP;
            let between = |i: usize| {
                let (left, right) = (a[i] + (c[i] - a[i]) * down, b[i] + (d[i] - b[i]) * down);
                (left, (right - left) * STEP)
            };
            let ((u, du), (v, dv)) = (between(0), between(1));
            for i in 0..CELL {
                patch.u[line * CELL + i] = u + du * i as f32;
                patch.v[line * CELL + i] = v + dv * i as f32;
                // A corner that the source does not draw says nothing of the places near it.
                if (patch.u[line * CELL + i] + patch.v[line * CELL + i]).is_nan() {
                    patch.sure[line * CELL + i] = NOTHING;
                }
            }
        }
        patch
    }

    fn patch_by_pixel(&self, column: usize, row: usize) -> Patch {
        let mut patch = Patch { u: [f32::NAN; CELL * CELL], v: [f32::NAN; CELL * CELL], sure: [NOTHING; CELL * CELL] };
        let (columns, _) = self.target.camera.cells();
        let by_pixel;
        let looks = match &self.target.mixed[row * columns + column] {
            Some(looks) => looks.as_ref(),
            None => {
                by_pixel = self.target.looks((column, row), false);
                &by_pixel
            }
        };
        for (index, look) in looks.iter().enumerate() {
            if let Some((at, surface)) = look.and_then(|(ray, hit)| self.unhidden(ray, hit)) {
                (patch.u[index], patch.v[index]) = (at.x as f32, at.y as f32);
                patch.sure[index] = sureness(surface);
            }
        }
        patch
    }

    /// The cell as if no goal stood in the source's way, and so unsure: better than black, where every source has one.
    pub(super) fn patch_through_goals(&self, column: usize, row: usize) -> Patch {
        let mut patch = Patch { u: [f32::NAN; CELL * CELL], v: [f32::NAN; CELL * CELL], sure: [UNSURE; CELL * CELL] };
        for (index, look) in self.target.looks((column, row), false).iter().enumerate() {
            if let Some(at) = look.and_then(|(ray, hit)| self.draw(ray, hit)) {
                (patch.u[index], patch.v[index]) = (at.x as f32, at.y as f32);
            }
        }
        patch
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

pub(super) fn sureness(surface: Surface) -> u8 {
    match surface {
        Surface::Ground | Surface::Goal => SURE,
        Surface::Far => UNSURE,
    }
}

fn cells(columns: usize, rows: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row)))
}

/// Nodes at the corners of a cell: upper left, upper right, lower left, lower right.
pub(super) fn corners(columns: usize, (column, row): (usize, usize)) -> [usize; 4] {
    let upper = row * (columns + 1) + column;
    let lower = upper + columns + 1;
    [upper, upper + 1, lower, lower + 1]
}

/// The cells of a camera's image in which a goal's bars can be seen; empty without goals.
fn goal_cells(camera: &Camera, map_from_optical: &Isometry, world: &World) -> Vec<bool> {
    if world.bars().is_empty() {
        return Vec::new();
    }
    let (columns, rows) = camera.cells();
    let mut marked = vec![false; columns * rows];
    let optical_from_map = map_from_optical.inverse();
    for bar in world.bars() {
        for place in bar.places() {
            let place = optical_from_map.transform_point(place);
            let Some(pixel) = camera.projector().project(place) else { continue };
            let reach = DVec2::splat(camera.lens().focal() * (bar.radius() + 0.03) / place.length().max(0.05) + 3.0);
            let (low, high) = ((pixel - reach) / CELL as f64, (pixel + reach) / CELL as f64);
            if high.x < 0.0 || high.y < 0.0 || low.x >= columns as f64 || low.y >= rows as f64 {
                continue;
            }
            for row in low.y.max(0.0) as usize..=(high.y as usize).min(rows - 1) {
                marked[row * columns..][low.x.max(0.0) as usize..=(high.x as usize).min(columns - 1)].fill(true);
            }
        }
    }
    marked
}
