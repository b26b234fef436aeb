//! Drawing of figures in front of the hall: nearest surfaces, antialiased edges, and soft shadows on the ground.

use core::ops::Range;

use super::super::effects::{Crowd, Member};
use super::body::Body;
use super::fixed::byte;
use super::macro_texture::Colour;
use super::posed_figure::{PlacedFigure, View};
use super::rays::RayTable;
use super::solid::Hit;
use super::tiles::{Tile, Tiles};

/// The figures of a scene, prepared for drawing.
#[derive(Clone, Debug)]
pub(super) struct CrowdView {
    members: Vec<(Member, Body)>,
    tiles: Tiles,
}

/// For each pixel the part of a figure that its centre shows, and its colour.
struct FrontBuffer {
    width: usize,
    height: usize,
    /// Figure * [`PARTS_PER_FIGURE`] + part + 1, or 0 if the pixel shows no figure.
    ids: Vec<u16>,
    colours: Vec<[u8; 3]>,
    /// Distance of that part along the pixel's ray, metres, or infinity.
    distances_m: Vec<f32>,
}

/// Indices of figures, each with indices of its parts, that may be visible in some pixels.
type Parts = Vec<(usize, Vec<usize>)>;

/// A tile in which figures or their shadows may be visible.
struct OccupiedTile<'a> {
    tile: &'a Tile,
    parts: Parts,
    /// Figures whose shadow may fall into the tile.
    shadows: Vec<usize>,
}

/// Factor of the figure in the ids of [`FrontBuffer`]. No figure has more parts.
const PARTS_PER_FIGURE: usize = 64;
/// A pixel on an edge is sampled by the square of this number of rays.
const SUBSAMPLES_PER_SIDE: usize = 4;
/// Share of the light that is missing in the middle of a shadow.
const SHADOW_DEPTH: f32 = 0.5;

impl CrowdView {
    /// Prepares the figures for images with these rays.
    pub(super) fn new(crowd: &Crowd, rays: &RayTable) -> Self {
        let members = crowd.members.iter().map(|member| (member.clone(), Body::new(member))).collect();
        Self { members, tiles: Tiles::new(rays) }
    }

    /// Draws the figures at `time` (seconds) over some rows of a picture of the empty hall.
    ///
    /// `limit` gives for a pixel (column, row) the distance along its ray, metres, beyond which figures are hidden by
    /// something in the picture. Returns for every pixel of the image the distance along its ray, metres, of the figure that it shows,
    /// or infinity.
    pub(super) fn draw(
        &self,
        time: f64,
        view: &View,
        rows: &Range<usize>,
        limit: impl Fn(usize, usize) -> f32,
        pixels: &mut [u8],
    ) -> Vec<f32> {
        let placed: Vec<PlacedFigure> =
            self.members.iter().map(|(member, body)| PlacedFigure::new(member, body, time, view)).collect();
        let mut front = FrontBuffer::new(view.rays);
        let occupied: Vec<OccupiedTile> = self
            .tiles
            .iter()
            .filter(|tile| rows.contains(&tile.rows.start))
            .filter_map(|tile| OccupiedTile::new(tile, &placed))
            .collect();
        for tile in &occupied {
            front.trace(tile, &placed, view, &limit);
        }
        for tile in &occupied {
            front.composite(tile, &placed, view, &limit, pixels);
        }
        front.distances_m
    }
}

impl<'a> OccupiedTile<'a> {
    fn new(tile: &'a Tile, placed: &[PlacedFigure]) -> Option<Self> {
        let (mut parts, mut shadows) = (Parts::new(), Vec::new());
        for (which, figure) in placed.iter().enumerate() {
            if tile.may_see(&figure.shadow) {
                shadows.push(which);
            }
            if tile.may_see(&figure.ball) {
                let seen = |part: &usize| figure.parts[*part].iter().any(|ball| tile.may_see(ball));
                let seen: Vec<usize> = (0..figure.parts.len()).filter(seen).collect();
                if !seen.is_empty() {
                    parts.push((which, seen));
                }
            }
        }
        (!parts.is_empty() || !shadows.is_empty()).then_some(Self { tile, parts, shadows })
    }

    /// Columns of the tile in a row that the lens sees.
    fn columns(&self, rays: &RayTable, row: usize) -> core::ops::Range<usize> {
        let (seen, own) = (rays.visible_columns(row), &self.tile.columns);
        own.start.max(seen.start)..own.end.min(seen.end)
    }
}

impl FrontBuffer {
    fn new(rays: &RayTable) -> Self {
        let (width, height) = (rays.width(), rays.height());
        let count = width * height;
        Self {
            width,
            height,
            ids: vec![0; count],
            colours: vec![[0; 3]; count],
            distances_m: vec![f32::INFINITY; count],
        }
    }

    /// Finds what the pixel centres of a tile show.
    fn trace(
        &mut self,
        occupied: &OccupiedTile,
        placed: &[PlacedFigure],
        view: &View,
        limit: &impl Fn(usize, usize) -> f32,
    ) {
        if occupied.parts.is_empty() {
            return;
        }
        for row in occupied.tile.rows.clone() {
            for column in occupied.columns(view.rays, row) {
                let ray = view.in_map(view.rays.at(column, row));
                if let Some((id, colour, distance_m)) = nearest(&occupied.parts, placed, ray, limit(column, row)) {
                    let at = row * self.width + column;
                    self.ids[at] = id;
                    self.colours[at] = colour.map(byte);
                    self.distances_m[at] = distance_m;
                }
            }
        }
    }

    /// Draws a tile into the final picture, with edges and shadows.
    fn composite(
        &self,
        occupied: &OccupiedTile,
        placed: &[PlacedFigure],
        view: &View,
        limit: &impl Fn(usize, usize) -> f32,
        pixels: &mut [u8],
    ) {
        for row in occupied.tile.rows.clone() {
            for column in occupied.columns(view.rays, row) {
                let at = row * self.width + column;
                let Some(pixel) = pixels.get_mut(3 * at..3 * at + 3) else { continue };
                let around = self.neighbourhood(column, row);
                let inside = around.iter().all(|id| *id == self.ids[at]);
                if inside && self.ids[at] != 0 {
                    pixel.copy_from_slice(&self.colours[at]);
                    continue;
                }
                let limit = limit(column, row);
                // A ray that ends before the ground shows no shadow on it.
                if limit == f32::INFINITY {
                    apply_shadows(pixel, &occupied.shadows, placed, view, column, row);
                }
                if !inside {
                    blend_edge(pixel, &parts_of(&around), placed, view, (column, row), limit);
                }
            }
        }
    }

    /// The ids of a pixel and its eight neighbours.
    fn neighbourhood(&self, column: usize, row: usize) -> [u16; 9] {
        core::array::from_fn(|which| {
            let near = |at: usize, step: usize, count: usize| (at + step).saturating_sub(1).min(count - 1);
            self.ids[near(row, which / 3, self.height) * self.width + near(column, which % 3, self.width)]
        })
    }
}

/// The parts among the ids of a neighbourhood. On an edge only these are sampled.
fn parts_of(ids: &[u16; 9]) -> Parts {
    let mut sorted = *ids;
    sorted.sort_unstable();
    let mut found = Parts::new();
    let mut before = 0;
    for id in sorted {
        if id == before {
            continue;
        }
        before = id;
        let (figure, part) = ((usize::from(id) - 1) / PARTS_PER_FIGURE, (usize::from(id) - 1) % PARTS_PER_FIGURE);
        match found.last_mut() {
            Some((last, parts)) if *last == figure => parts.push(part),
            _ => found.push((figure, vec![part])),
        }
    }
    found
}

/// The first hit of a unit ray nearer than `limit`: id, colour, and distance in metres.
fn nearest(parts: &Parts, placed: &[PlacedFigure], ray: [f32; 3], limit: f32) -> Option<(u16, Colour, f32)> {
    let mut first: Option<(usize, usize, Hit)> = None;
    for (which, parts) in parts {
        let figure = &placed[*which];
        let ray = figure.to_figure(ray);
        for &part in parts {
            if let Some(hit) = figure.body.parts[part].hit(figure.camera, ray, figure.swing)
                && hit.t < first.as_ref().map_or(limit, |(_, _, nearest)| nearest.t)
            {
                first = Some((*which, part, hit));
            }
        }
    }
    let (which, part, hit) = first?;
    let figure = &placed[which];
    let id = (which * PARTS_PER_FIGURE + part + 1) as u16;
    Some((id, figure.colour(part, &hit, figure.to_figure(ray)), hit.t))
}

/// Blends figures over the colour of a pixel on an edge, by finer rays.
fn blend_edge(
    pixel: &mut [u8],
    parts: &Parts,
    placed: &[PlacedFigure],
    view: &View,
    (column, row): (usize, usize),
    limit: f32,
) {
    let [left, right] = [column, column + 2].map(|c| view.rays.padded(c, row + 1));
    let [above, below] = [row, row + 2].map(|r| view.rays.padded(column + 1, r));
    let middle = view.rays.at(column, row);
    let (mut sum, mut covered) = ([0.0; 3], 0.0);
    for sample in 0..SUBSAMPLES_PER_SIDE * SUBSAMPLES_PER_SIDE {
        let offset = |index: usize| (index as f32 + 0.5) / SUBSAMPLES_PER_SIDE as f32 - 0.5;
        let (u, v) = (offset(sample % SUBSAMPLES_PER_SIDE), offset(sample / SUBSAMPLES_PER_SIDE));
        let ray = core::array::from_fn(|i| middle[i] + 0.5 * (u * (right[i] - left[i]) + v * (below[i] - above[i])));
        if let Some((_, colour, _)) = nearest(parts, placed, view.in_map(ray), limit) {
            covered += 1.0;
            sum = core::array::from_fn(|channel| sum[channel] + colour[channel].clamp(0.0, 255.0));
        }
    }
    let rays = (SUBSAMPLES_PER_SIDE * SUBSAMPLES_PER_SIDE) as f32;
    for (value, sum) in pixel.iter_mut().zip(sum) {
        *value = byte((sum + (rays - covered) * f32::from(*value)) / rays);
    }
}

/// Darkens a pixel that shows ground near the feet of figures.
fn apply_shadows(pixel: &mut [u8], shadows: &[usize], placed: &[PlacedFigure], view: &View, column: usize, row: usize) {
    if shadows.is_empty() {
        return;
    }
    let ray = view.in_map(view.rays.at(column, row));
    if ray[2] > -1e-3 {
        return;
    }
    let t = view.camera[2] / -ray[2];
    let ground = [view.camera[0] + t * ray[0], view.camera[1] + t * ray[1]];
    let mut gain = 1.0;
    for which in shadows {
        let figure = &placed[*which];
        let (x, y) = (ground[0] - figure.position[0], ground[1] - figure.position[1]);
        let inside = 1.0 - (x * x + y * y) / (figure.shadow_m * figure.shadow_m);
        if inside > 0.0 {
            gain *= 1.0 - SHADOW_DEPTH * inside * inside;
        }
    }
    if gain < 1.0 {
        for value in pixel {
            *value = byte(f32::from(*value) * gain);
        }
    }
}
