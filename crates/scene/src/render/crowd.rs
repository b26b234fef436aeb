//! Figures in front of the hall: the nearest first, edges by finer rays, a soft shadow where they stand.

use core::ops::Range;

use super::super::effects::{Crowd, Member};
use super::body::Body;
use super::fixed::byte;
use super::macro_texture::Colour;
use super::posed_figure::{Placed, View};
use super::rays::RayTable;
use super::solid::Hit;
use super::tiles::{Tile, Tiles};

#[derive(Clone, Debug)]
pub(super) struct CrowdView {
    members: Vec<(Member, Body)>,
    tiles: Tiles,
}

/// Which part of which figure a pixel's centre shows, and its colour.
struct Front {
    width: usize,
    height: usize,
    /// 0 is nobody.
    ids: Vec<u16>,
    colours: Vec<[u8; 3]>,
}

/// What can be seen in some pixels: figures and, of them, parts.
type Parts = Vec<(usize, Vec<usize>)>;

struct Busy<'a> {
    tile: &'a Tile,
    parts: Parts,
    /// Figures whose shadow may fall here.
    shadows: Vec<usize>,
}

/// Ids are figure * this + part + 1.
const PARTS: usize = 64;
/// A pixel on an edge is looked at by this many rays squared.
const FINER: usize = 4;
/// How dark a shadow is in its middle.
const SHADOW: f32 = 0.5;

impl CrowdView {
    pub(super) fn new(crowd: &Crowd, rays: &RayTable) -> Self {
        let members = crowd.members.iter().map(|member| (member.clone(), Body::new(member))).collect();
        Self { members, tiles: Tiles::new(rays) }
    }

    /// Over a picture of the empty hall, in these rows of it. What lies farther along a pixel's ray than `limit` says is
    /// hidden by something that the picture shows. Returns which pixels show somebody.
    pub(super) fn draw(
        &self,
        time: f64,
        view: &View,
        rows: &Range<usize>,
        limit: impl Fn(usize, usize) -> f32,
        pixels: &mut [u8],
    ) -> Vec<bool> {
        let placed: Vec<Placed> =
            self.members.iter().map(|(member, body)| Placed::new(member, body, time, view)).collect();
        let mut front = Front::new(view.rays);
        let busy: Vec<Busy> = self
            .tiles
            .iter()
            .filter(|tile| rows.contains(&tile.rows.start))
            .filter_map(|tile| Busy::new(tile, &placed))
            .collect();
        for busy in &busy {
            front.look(busy, &placed, view, &limit);
        }
        for busy in &busy {
            front.put(busy, &placed, view, &limit, pixels);
        }
        front.ids.iter().map(|id| *id != 0).collect()
    }
}

impl<'a> Busy<'a> {
    fn new(tile: &'a Tile, placed: &[Placed]) -> Option<Self> {
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

    /// Columns of a row that the lens draws on.
    fn columns(&self, rays: &RayTable, row: usize) -> core::ops::Range<usize> {
        let (seen, own) = (rays.seen(row), &self.tile.columns);
        own.start.max(seen.start)..own.end.min(seen.end)
    }
}

impl Front {
    fn new(rays: &RayTable) -> Self {
        let (width, height) = (rays.width(), rays.height());
        Self { width, height, ids: vec![0; width * height], colours: vec![[0; 3]; width * height] }
    }

    /// What the centres of a tile's pixels show.
    fn look(&mut self, busy: &Busy, placed: &[Placed], view: &View, limit: &impl Fn(usize, usize) -> f32) {
        if busy.parts.is_empty() {
            return;
        }
        for row in busy.tile.rows.clone() {
            for column in busy.columns(view.rays, row) {
                let ray = view.in_map(view.rays.at(column, row));
                if let Some((id, colour)) = nearest(&busy.parts, placed, ray, limit(column, row)) {
                    self.ids[row * self.width + column] = id;
                    self.colours[row * self.width + column] = colour.map(byte);
                }
            }
        }
    }

    /// A tile of the final picture.
    fn put(
        &self,
        busy: &Busy,
        placed: &[Placed],
        view: &View,
        limit: &impl Fn(usize, usize) -> f32,
        pixels: &mut [u8],
    ) {
        for row in busy.tile.rows.clone() {
            for column in busy.columns(view.rays, row) {
                let at = row * self.width + column;
                let Some(pixel) = pixels.get_mut(3 * at..3 * at + 3) else { continue };
                let around = self.around(column, row);
                let inside = around.iter().all(|id| *id == self.ids[at]);
                if inside && self.ids[at] != 0 {
                    pixel.copy_from_slice(&self.colours[at]);
                    continue;
                }
                let limit = limit(column, row);
                // What ends before the ground has no shadow of the ground.
                if limit == f32::INFINITY {
                    shade(pixel, &busy.shadows, placed, view, column, row);
                }
                if !inside {
                    mix(pixel, &parts_of(&around), placed, view, (column, row), limit);
                }
            }
        }
    }

    /// The ids of a pixel and its eight neighbours.
    fn around(&self, column: usize, row: usize) -> [u16; 9] {
        core::array::from_fn(|which| {
            let near = |at: usize, step: usize, count: usize| (at + step).saturating_sub(1).min(count - 1);
            self.ids[near(row, which / 3, self.height) * self.width + near(column, which % 3, self.width)]
        })
    }
}

/// Between neighbours nothing else than the neighbours is looked for.
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
        let (figure, part) = ((usize::from(id) - 1) / PARTS, (usize::from(id) - 1) % PARTS);
        match found.last_mut() {
            Some((last, parts)) if *last == figure => parts.push(part),
            _ => found.push((figure, vec![part])),
        }
    }
    found
}

fn nearest(parts: &Parts, placed: &[Placed], ray: [f32; 3], limit: f32) -> Option<(u16, Colour)> {
    let mut first: Option<(usize, usize, Hit)> = None;
    for (which, parts) in parts {
        let figure = &placed[*which];
        let ray = figure.turned(ray);
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
    Some(((which * PARTS + part + 1) as u16, figure.colour(part, &hit, figure.turned(ray))))
}

/// A pixel on an edge: figures over what it shows already.
fn mix(pixel: &mut [u8], parts: &Parts, placed: &[Placed], view: &View, (column, row): (usize, usize), limit: f32) {
    let [left, right] = [column, column + 2].map(|c| view.rays.padded(c, row + 1));
    let [above, below] = [row, row + 2].map(|r| view.rays.padded(column + 1, r));
    let middle = view.rays.at(column, row);
    let (mut sum, mut covered) = ([0.0; 3], 0.0);
    for finer in 0..FINER * FINER {
        let offset = |index: usize| (index as f32 + 0.5) / FINER as f32 - 0.5;
        let (u, v) = (offset(finer % FINER), offset(finer / FINER));
        let ray = core::array::from_fn(|i| middle[i] + 0.5 * (u * (right[i] - left[i]) + v * (below[i] - above[i])));
        if let Some((_, colour)) = nearest(parts, placed, view.in_map(ray), limit) {
            covered += 1.0;
            sum = core::array::from_fn(|channel| sum[channel] + colour[channel].clamp(0.0, 255.0));
        }
    }
    let rays = (FINER * FINER) as f32;
    for (value, sum) in pixel.iter_mut().zip(sum) {
        *value = byte((sum + (rays - covered) * f32::from(*value)) / rays);
    }
}

/// Under a figure less light reaches the ground.
fn shade(pixel: &mut [u8], shadows: &[usize], placed: &[Placed], view: &View, column: usize, row: usize) {
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
        let (x, y) = (ground[0] - figure.place[0], ground[1] - figure.place[1]);
        let inside = 1.0 - (x * x + y * y) / (figure.shadow_m * figure.shadow_m);
        if inside > 0.0 {
            gain *= 1.0 - SHADOW * inside * inside;
        }
    }
    if gain < 1.0 {
        for value in pixel {
            *value = byte(f32::from(*value) * gain);
        }
    }
}
