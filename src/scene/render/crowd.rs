//! Figures in front of the hall: the nearest first, edges by finer rays, a soft shadow where they stand.

use super::super::effects::{Crowd, Member};
use super::body::Body;
use super::fixed::byte;
use super::light::Lit;
use super::rays::RayTable;
use super::sheet::Colour;
use super::solid::Hit;
use super::tiles::{Ball, Tile, Tiles};

#[derive(Clone, Debug)]
pub(super) struct CrowdView {
    members: Vec<(Member, Body)>,
    tiles: Tiles,
}

/// The camera of one frame: its place in `map`, its rotation column by column.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) rays: &'a RayTable,
    pub(super) rotation: &'a [f32; 9],
    pub(super) camera: &'a [f32; 3],
}

/// A figure where it stands in this frame.
struct Placed<'a> {
    body: &'a Body,
    place: [f32; 2],
    /// Cosine and sine of its yaw.
    turn: [f32; 2],
    swing: f32,
    /// The camera, seen from the figure.
    camera: [f32; 3],
    /// Around the body, around each of its parts, around its shadow.
    ball: Ball,
    parts: Vec<Vec<Ball>>,
    shadow: Ball,
    shadow_m: f32,
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
/// How dark the shadow is in its middle, and how far it reaches beyond the body.
const SHADOW: f32 = 0.5;
const SHADOW_BEYOND_M: f32 = 0.22;
/// Two steps, as a share of the height.
const TWO_STEPS: f32 = 0.75;
/// Towards the brighter side of the hall.
const SUN: [f32; 2] = [0.64, -0.77];

impl CrowdView {
    pub(super) fn new(crowd: &Crowd, rays: &RayTable) -> Self {
        let members = crowd.members.iter().map(|member| (member.clone(), Body::new(member))).collect();
        Self { members, tiles: Tiles::new(rays) }
    }

    /// Over a picture of the empty hall.
    pub(super) fn draw(&self, time: f64, view: &View, light: &impl Lit, pixels: &mut [u8]) {
        let placed: Vec<Placed> =
            self.members.iter().map(|(member, body)| Placed::new(member, body, time, view)).collect();
        let mut front = Front::new(view.rays);
        let busy: Vec<Busy> = self.tiles.iter().filter_map(|tile| Busy::new(tile, &placed)).collect();
        for busy in &busy {
            front.look(busy, &placed, view, light);
        }
        for busy in &busy {
            front.put(busy, &placed, view, light, pixels);
        }
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

impl<'a> Placed<'a> {
    fn new(member: &Member, body: &'a Body, time: f64, view: &View) -> Self {
        let standpoint = member.at(time);
        let (sin, cos) = libm::sincos(standpoint.pose.yaw);
        let (place, turn) = ([standpoint.pose.x as f32, standpoint.pose.y as f32], [cos as f32, sin as f32]);
        let height = member.height as f32;
        let swing = |walked: f64| libm::sin(core::f64::consts::TAU * walked / f64::from(TWO_STEPS * height)) as f32;
        let shadow_m = member.width as f32 / 2.0 + SHADOW_BEYOND_M;
        let in_camera = |p: [f32; 3]| {
            let map = [place[0] + turn[0] * p[0] - turn[1] * p[1], place[1] + turn[1] * p[0] + turn[0] * p[1], p[2]];
            let d: [f32; 3] = core::array::from_fn(|i| map[i] - view.camera[i]);
            let r = view.rotation;
            core::array::from_fn(|i| r[3 * i] * d[0] + r[3 * i + 1] * d[1] + r[3 * i + 2] * d[2])
        };
        let swing = standpoint.walked.map_or(0.0, swing);
        let ball = |(centre, radius): &([f32; 3], f32)| Ball::new(in_camera(*centre), *radius);
        let parts: Vec<Vec<_>> = body.parts.iter().map(|part| part.balls(swing)).collect();
        let middle = [0.0, 0.0, height / 2.0];
        let reach = |(centre, radius): &([f32; 3], f32)| {
            let d: [f32; 3] = core::array::from_fn(|i| centre[i] - middle[i]);
            radius + (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt()
        };
        let around = parts.iter().flatten().map(reach).fold(0.0, f32::max);
        let dx = [view.camera[0] - place[0], view.camera[1] - place[1]];
        Self {
            body,
            place,
            turn,
            swing,
            camera: [turn[0] * dx[0] + turn[1] * dx[1], turn[0] * dx[1] - turn[1] * dx[0], view.camera[2]],
            ball: ball(&(middle, around)),
            parts: parts.iter().map(|balls| balls.iter().map(ball).collect()).collect(),
            shadow: ball(&([0.0; 3], shadow_m)),
            shadow_m,
        }
    }

    /// A ray in `map`, seen from the figure.
    #[inline]
    fn turned(&self, ray: [f32; 3]) -> [f32; 3] {
        let [cos, sin] = self.turn;
        [cos * ray[0] + sin * ray[1], cos * ray[1] - sin * ray[0], ray[2]]
    }

    /// `ray` as the figure sees it.
    fn colour(&self, part: usize, hit: &Hit, ray: [f32; 3], light: &impl Lit) -> Colour {
        let n = hit.normal;
        let scale = 1.0 / (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-9);
        let [cos, sin] = self.turn;
        let sun = [cos * SUN[0] + sin * SUN[1], cos * SUN[1] - sin * SUN[0]];
        let up = n[2] * scale;
        let aside = (n[0] * sun[0] + n[1] * sun[1]) * scale;
        let height = self.camera[2] + hit.t * ray[2];
        // Lamps hang from the ceiling; near the ground the carpet shines back less than the hall.
        let gain = (0.70 + 0.25 * up + 0.16 * aside) * (0.8 + 0.2 * (2.0 * height).clamp(0.0, 1.0));
        light.lit(self.body.parts[part].colour.map(|value| value * gain), || self.place)
    }
}

impl Front {
    fn new(rays: &RayTable) -> Self {
        let (width, height) = (rays.width(), rays.height());
        Self { width, height, ids: vec![0; width * height], colours: vec![[0; 3]; width * height] }
    }

    /// What the centres of a tile's pixels show.
    fn look(&mut self, busy: &Busy, placed: &[Placed], view: &View, light: &impl Lit) {
        if busy.parts.is_empty() {
            return;
        }
        for row in busy.tile.rows.clone() {
            for column in busy.columns(view.rays, row) {
                let ray = view.in_map(view.rays.at(column, row));
                if let Some((id, colour)) = nearest(&busy.parts, placed, ray, light) {
                    self.ids[row * self.width + column] = id;
                    self.colours[row * self.width + column] = colour.map(byte);
                }
            }
        }
    }

    /// A tile of the final picture.
    fn put(&self, busy: &Busy, placed: &[Placed], view: &View, light: &impl Lit, pixels: &mut [u8]) {
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
                shade(pixel, &busy.shadows, placed, view, column, row);
                if !inside {
                    mix(pixel, &parts_of(&around), placed, view, light, column, row);
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

fn nearest(parts: &Parts, placed: &[Placed], ray: [f32; 3], light: &impl Lit) -> Option<(u16, Colour)> {
    let mut first: Option<(usize, usize, Hit)> = None;
    for (which, parts) in parts {
        let figure = &placed[*which];
        let ray = figure.turned(ray);
        for &part in parts {
            if let Some(hit) = figure.body.parts[part].hit(figure.camera, ray, figure.swing)
                && first.as_ref().is_none_or(|(_, _, nearest)| hit.t < nearest.t)
            {
                first = Some((*which, part, hit));
            }
        }
    }
    let (which, part, hit) = first?;
    let figure = &placed[which];
    Some(((which * PARTS + part + 1) as u16, figure.colour(part, &hit, figure.turned(ray), light)))
}

/// A pixel on an edge: figures over what it shows already.
fn mix(pixel: &mut [u8], parts: &Parts, placed: &[Placed], view: &View, light: &impl Lit, column: usize, row: usize) {
    let [left, right] = [column, column + 2].map(|c| view.rays.padded(c, row + 1));
    let [above, below] = [row, row + 2].map(|r| view.rays.padded(column + 1, r));
    let middle = view.rays.at(column, row);
    let (mut sum, mut covered) = ([0.0; 3], 0.0);
    for finer in 0..FINER * FINER {
        let offset = |index: usize| (index as f32 + 0.5) / FINER as f32 - 0.5;
        let (u, v) = (offset(finer % FINER), offset(finer / FINER));
        let ray = core::array::from_fn(|i| middle[i] + 0.5 * (u * (right[i] - left[i]) + v * (below[i] - above[i])));
        if let Some((_, colour)) = nearest(parts, placed, view.in_map(ray), light) {
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

impl View<'_> {
    #[inline]
    fn in_map(&self, ray: [f32; 3]) -> [f32; 3] {
        let r = self.rotation;
        core::array::from_fn(|i| r[i] * ray[0] + r[i + 3] * ray[1] + r[i + 6] * ray[2])
    }
}
