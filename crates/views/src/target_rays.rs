//! The surfaces that the rays of the wanted view meet.

use glam::{DMat3, DVec2, DVec3, Vec3};

use super::camera::{AREA, CELL, Camera};
use super::optical;
use super::raster::{NOTHING, SURE, UNSURE};
use super::world::{Background, Goals, Hit, Surface, World};
use realitysim_geometry::{Isometry, multiversioned};

/// The wanted view: its pose and the surfaces that its rays meet. One target serves all sources.
#[derive(Clone, Debug)]
pub struct Target<'a> {
    pub(super) camera: &'a Camera,
    pub(super) world: &'a World,
    /// The goals as seen from the wanted camera.
    goals: Goals,
    /// Ground and hall as seen from there.
    background: Background,
    /// Position of the camera in `map`, metres.
    pub(super) place: DVec3,
    map_from_optical: DMat3,
    /// Unit rays in `map` at the corners of the cells and what they meet; `None` where the lens draws nothing.
    pub(super) nodes: Vec<Option<(DVec3, Hit)>>,
    /// The same in groups for vectorised projection, padded with rays that nothing draws.
    pub(super) node_hits: Vec<RayHits>,
    /// For each cell where surfaces meet, at the lens's edge, or where a goal stands: what each pixel meets.
    pub(super) mixed: Vec<Option<Box<RayHits>>>,
}

/// The surfaces that the pixels of a cell meet, row by row.
#[derive(Clone, Debug)]
pub(super) struct RayHits {
    /// Unit rays in `map`, separate arrays of x, y and z; NaN where the lens draws nothing.
    pub(super) rays: [[f32; AREA]; 3],
    /// Inverse distances along the rays, 1/m; 0 for what is far.
    pub(super) inverse_distances: [f32; AREA],
    /// Mask values: [`SURE`], [`UNSURE`] or [`NOTHING`].
    pub(super) sure: [u8; AREA],
    /// Whether the pixel shows a goal, which nothing hides.
    pub(super) goal: [bool; AREA],
}

/// A cell in which the lens draws nothing.
impl Default for RayHits {
    fn default() -> Self {
        Self { rays: [[f32::NAN; AREA]; 3], inverse_distances: [0.0; AREA], sure: [NOTHING; AREA], goal: [false; AREA] }
    }
}

impl RayHits {
    /// The corners of cells, at most [`AREA`] of them.
    fn of_nodes(nodes: &[Option<(DVec3, Hit)>]) -> Self {
        let mut hits = Self::default();
        for (i, (ray, hit)) in nodes.iter().enumerate().filter_map(|(i, node)| Some((i, node.as_ref()?))) {
            for (axis, part) in ray.to_array().into_iter().enumerate() {
                hits.rays[axis][i] = part as f32;
            }
            hits.inverse_distances[i] = hit.inverse_distance as f32;
            hits.sure[i] = mask_value(hit.surface);
        }
        hits
    }
}

/// Goals are widened by this many pixels, because their edges are soft.
pub(super) const SOFT_EDGE_PX: f64 = 1.2;

impl<'a> Target<'a> {
    /// The view of `camera` from `map_from_link`, its pose of `camera_link` in `map`.
    pub fn new(camera: &'a Camera, map_from_link: &Isometry, world: &'a World) -> Self {
        let map_from_optical = optical(map_from_link);
        let (place, rotation) = (map_from_optical.translation, DMat3::from_quat(map_from_optical.rotation));
        let background = world.background_from(place);
        let node = |ray: &DVec3| {
            let ray = rotation * *ray;
            (!ray.x.is_nan()).then(|| (ray, background.hit(ray)))
        };
        let nodes: Vec<Option<(DVec3, Hit)>> = camera.node_rays().iter().map(node).collect();
        let (columns, rows) = camera.cells();
        let goals = goal_cells(camera, &map_from_optical, world);
        let seen_goals = world.goals_from(place, SOFT_EDGE_PX / camera.lens().focal());
        let node_hits = nodes.chunks(AREA).map(RayHits::of_nodes).collect();
        let (map_from_optical, goals_seen, mixed) = (rotation, seen_goals, Vec::new());
        let mut target =
            Self { camera, world, goals: goals_seen, background, place, map_from_optical, nodes, node_hits, mixed };
        let hits = |(index, cell): (usize, (usize, usize))| {
            let surfaces = corners(columns, cell).map(|corner| target.surface_at(corner));
            let goal = goals.get(index).is_some_and(|goal| *goal);
            let mixed = surfaces[0].is_none() || surfaces.iter().any(|surface| *surface != surfaces[0]);
            let drawn = surfaces[0].is_some() || (0..AREA).any(|pixel| target.shows(cell, pixel));
            (drawn && (mixed || goal)).then(|| Box::new(target.ray_hits(cell, goal)))
        };
        target.mixed = cells(columns, rows).enumerate().map(hits).collect();
        target
    }

    /// Lens of the wanted view.
    pub fn camera(&self) -> &'a Camera {
        self.camera
    }

    /// Rotates a direction in `map` into the optical frame of the wanted camera.
    pub(super) fn optical_from_map(&self, direction: DVec3) -> DVec3 {
        self.map_from_optical.transpose() * direction
    }

    pub(super) fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// The surface at a corner of cells, or `None` where the lens draws nothing.
    pub(super) fn surface_at(&self, node: usize) -> Option<Surface> {
        self.nodes[node].map(|(_, hit)| hit.surface)
    }

    /// Whether the lens draws this pixel of a cell.
    pub(super) fn shows(&self, (column, row): (usize, usize), index: usize) -> bool {
        let (u, v) = (column * CELL + index % CELL, row * CELL + index / CELL);
        u < self.camera.width() && v < self.camera.height() && self.camera.shows()[v * self.camera.width() + u]
    }

    /// Computes what the pixels of a cell meet; goals are tested only if `goal` is set.
    pub(super) fn ray_hits(&self, (column, row): (usize, usize), goal: bool) -> RayHits {
        let mut hits = RayHits::default();
        self.camera.cell_rays(column, row, &mut hits.rays);
        self.intersect_background(&mut hits);
        if goal {
            self.intersect_goals(&mut hits);
        }
        hits
    }

    /// Rotates the camera's rays into `map` and intersects them with ground and hall, like [`Background::hit`].
    fn intersect_background(&self, hits: &mut RayHits) {
        let target = self;
        multiversioned!(|target: &Target, hits: &mut RayHits| {
            let [x, y, z] = rotated(&target.map_from_optical, &hits.rays);
            let (place, half) = (target.place.as_vec3(), target.world.ground_half().as_vec2());
            let [floor, rest @ ..] = target.background.hall.planes();
            for i in 0..AREA {
                let along = |plane: Vec3| plane.x * x[i] + plane.y * y[i] + plane.z * z[i];
                let nearness = along(floor);
                let nearest = rest.iter().fold(0.0f32, |nearest, plane| nearest.max(along(*plane)));
                let distance = 1.0 / nearness;
                let on_carpet =
                    ((place.x + x[i] * distance).abs() <= half.x) & ((place.y + y[i] * distance).abs() <= half.y);
                let ground = (nearness > 0.0) & (nearness >= nearest) & on_carpet;
                hits.inverse_distances[i] = nearest.max(nearness);
                let far = if x[i].is_nan() { NOTHING } else { UNSURE };
                hits.sure[i] = if ground { SURE } else { far };
            }
            hits.rays = [x, y, z];
        });
    }

    /// Replaces hits by those of goals that stand before them.
    fn intersect_goals(&self, hits: &mut RayHits) {
        let met = self.goals.first_hits(&hits.rays);
        for (i, distance) in met.into_iter().enumerate() {
            if hits.sure[i] != NOTHING && distance.is_finite() && distance * hits.inverse_distances[i] < 1.0 {
                hits.inverse_distances[i] = 1.0 / distance;
                hits.sure[i] = mask_value(Surface::Goal);
                hits.goal[i] = true;
            }
        }
    }

    /// The unit ray of a pixel in `map`, and what it meets; goals are tested only if `goal` is set.
    pub(super) fn ray_hit(&self, u: usize, v: usize, goal: bool) -> Option<(DVec3, Hit)> {
        let ray = self.map_from_optical * self.camera.ray(u, v)?;
        let behind = self.background.hit(ray);
        let hit = if goal { self.goals.nearest_hit(ray, behind) } else { behind };
        Some((ray, hit))
    }

    /// The surface that this pixel shows, or `None` where the lens draws nothing.
    pub fn surface(&self, u: usize, v: usize) -> Option<Surface> {
        Some(self.ray_hit(u, v, true)?.1.surface)
    }
}

/// Rotates vectors that are given as separate arrays of x, y and z.
#[inline(always)]
pub(super) fn rotated(by: &DMat3, [xs, ys, zs]: &[[f32; AREA]; 3]) -> [[f32; AREA]; 3] {
    let [a, b, c] = [by.x_axis, by.y_axis, by.z_axis].map(|axis| axis.as_vec3());
    let mut to = [[0.0; AREA]; 3];
    for i in 0..AREA {
        let (x, y, z) = (xs[i], ys[i], zs[i]);
        to[0][i] = a.x * x + b.x * y + c.x * z;
        to[1][i] = a.y * x + b.y * y + c.y * z;
        to[2][i] = a.z * x + b.z * y + c.z * z;
    }
    to
}

/// The mask value of a pixel that shows this surface.
pub(super) fn mask_value(surface: Surface) -> u8 {
    match surface {
        Surface::Ground | Surface::Goal => SURE,
        Surface::Far => UNSURE,
    }
}

/// All cells as (column, row), row by row.
pub(super) fn cells(columns: usize, rows: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..rows).flat_map(move |row| (0..columns).map(move |column| (column, row)))
}

/// Indices of the corners of a cell: upper left, upper right, lower left, lower right.
pub(super) fn corners(columns: usize, (column, row): (usize, usize)) -> [usize; 4] {
    let upper = row * (columns + 1) + column;
    let lower = upper + columns + 1;
    [upper, upper + 1, lower, lower + 1]
}

/// Interpolates values at the corners of a cell for each of its pixels.
#[inline(always)]
pub(super) fn interpolate_cell([a, b, c, d]: [f32; 4]) -> [f32; AREA] {
    let mut values = [0.0; AREA];
    for line in 0..CELL {
        let y = line as f32 / CELL as f32;
        let (left, right) = (a + (c - a) * y, b + (d - b) * y);
        let step = (right - left) / CELL as f32;
        for column in 0..CELL {
            values[line * CELL + column] = left + step * column as f32;
        }
    }
    values
}

/// For each cell of a camera's image: whether a bar of a goal can appear in it. Empty without goals.
pub(super) fn goal_cells(camera: &Camera, map_from_optical: &Isometry, world: &World) -> Vec<bool> {
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
