//! One image of several sources: for each pixel the best of them, with feathered seams.

use super::Candidate;
use super::answer::Request;
use super::camera::CELL;
use super::ground_warp::{Patch, Target, Warp, corners};
use super::photometry::{Gain, factors};
use super::raster::{NOTHING, Raster, SURE};
use super::sample::{Pixels, read_cell};
use super::world::Surface;

/// The picture, and which share of it each source has.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Composed {
    pub(super) image: Raster,
    pub(super) shares: Vec<f64>,
}

/// Sources whose score is within this share of the best one's are mixed: the width of a seam.
const FEATHER: f32 = 0.08;
/// Distance from the source's border, in pixels, from which on it does not count.
const BORDER_PX: f32 = 24.0;
/// Beside what is far, a source counts half when it was taken this far away: it shows another parallax.
const FAR_BASELINE_M: f64 = 0.3;
/// Copies are used from this many source pixels a pixel on, and the next ones from twice as many.
const SHRINKS_FROM: f32 = 1.5;

pub(super) fn compose(
    request: &Request,
    target: &Target,
    warps: &[Warp],
    sources: &[Candidate],
    gains: &[Gain],
) -> Composed {
    let camera = target.camera();
    let (columns, rows) = camera.cells();
    let weights = Weights::new(target, warps);
    let layers: Vec<Layer> = (warps.iter().zip(sources).zip(gains))
        .map(|((warp, source), gain)| Layer {
            warp,
            source,
            factors: factors(target, warp, source, gain, &request.vignetting),
        })
        .collect();
    let mut image = Raster::black(camera.width(), camera.height());
    for row in 0..rows {
        for column in 0..columns {
            let cell = compose_cell(&layers, &weights, target, (column, row));
            put(&mut image, &cell, column, row, camera.shows());
        }
    }
    Composed { image, shares: weights.shares() }
}

struct Layer<'a> {
    warp: &'a Warp<'a>,
    source: &'a Candidate<'a>,
    factors: Option<Vec<[f32; 3]>>,
}

fn compose_cell(layers: &[Layer], weights: &Weights, target: &Target, cell: (usize, usize)) -> Pixels {
    let at = corners(target.camera().cells().0, cell);
    let takes_part = |index: &usize| at.iter().any(|corner| weights.of(*index, *corner) > 0.0);
    let mut taking = (0..layers.len()).filter(takes_part);
    let mut pixels = match (taking.next(), taking.next()) {
        (None, _) => [[0; 4]; CELL * CELL],
        (Some(only), None) => layers[only].pixels(cell, &at),
        (Some(_), Some(_)) => blend(layers, weights, cell, &at),
    };
    // Corners may see what a pixel does not, and the other way round.
    let hole = |pixels: &Pixels| (0..CELL * CELL).any(|i| pixels[i][3] == NOTHING && target.shows(cell, i));
    for through_goals in [false, true] {
        for (index, layer) in layers.iter().enumerate() {
            if !layer.warp.may_show(cell.0, cell.1) || (!through_goals && takes_part(&index)) {
                continue;
            }
            if !hole(&pixels) {
                return pixels;
            }
            if through_goals && !layer.warp.sees_goal_in(cell) {
                continue;
            }
            let more = match through_goals {
                false => layer.pixels(cell, &at),
                true => layer.read(layer.warp.patch_through_goals(cell.0, cell.1), &at),
            };
            let holes = pixels.iter_mut().zip(more).filter(|(pixel, _)| pixel[3] == NOTHING);
            holes.for_each(|(pixel, more)| *pixel = more);
        }
    }
    pixels
}

fn blend(layers: &[Layer], weights: &Weights, cell: (usize, usize), at: &[usize; 4]) -> Pixels {
    let mut sums = [[0f32; 4]; CELL * CELL];
    let mut sure = [NOTHING; CELL * CELL];
    for (index, layer) in layers.iter().enumerate() {
        let [a, b, c, d] = at.map(|corner| weights.of(index, corner));
        if a + b + c + d == 0.0 {
            continue;
        }
        let pixels = layer.pixels(cell, at);
        for line in 0..CELL {
            let y = line as f32 / CELL as f32;
            let (left, right) = (a + (c - a) * y, b + (d - b) * y);
            let step = (right - left) / CELL as f32;
            for column in 0..CELL {
                let i = line * CELL + column;
                let [red, green, blue, shown] = pixels[i];
                let weight = if shown == NOTHING { 0.0 } else { left + step * column as f32 };
                let [r, g, b, sum] = sums[i];
                let more = |sum: f32, value: u8| sum + weight * f32::from(value);
                sums[i] = [more(r, red), more(g, green), more(b, blue), sum + weight];
                sure[i] = sure[i].max(if weight > 0.0 { shown } else { NOTHING });
            }
        }
    }
    core::array::from_fn(|i| {
        let [r, g, b, sum] = sums[i];
        let mean = |value: f32| (value / sum + 0.5) as u8;
        if sum > 1e-4 { [mean(r), mean(g), mean(b), sure[i]] } else { [0, 0, 0, NOTHING] }
    })
}

impl Layer<'_> {
    fn pixels(&self, cell: (usize, usize), at: &[usize; 4]) -> Pixels {
        self.read(self.warp.patch(cell.0, cell.1), at)
    }

    fn read(&self, mut patch: Patch, at: &[usize; 4]) -> Pixels {
        let (image, level) = self.source.image.level(self.level(at));
        if level > 0 {
            let scale = 1.0 / (1 << level) as f32;
            patch.u.iter_mut().chain(&mut patch.v).for_each(|x| *x = (*x + 0.5) * scale - 0.5);
        }
        let mut pixels = read(image, &patch);
        if let Some(factors) = &self.factors {
            multiply(&mut pixels, at.map(|corner| factors[corner]));
        }
        pixels
    }

    /// By how many powers of two the view shrinks the source here.
    fn level(&self, at: &[usize; 4]) -> usize {
        let [a, b, c, _] = at.map(|corner| self.warp.node(corner));
        let length = |p: [f32; 2], q: [f32; 2]| libm::hypotf(p[0] - q[0], p[1] - q[1]) / CELL as f32;
        let scale = length(a, b).max(length(a, c));
        let mut level = 0;
        let mut from = SHRINKS_FROM;
        // Not for NaN.
        while scale > from && level + 1 < super::raster::LEVELS {
            level += 1;
            from *= 2.0;
        }
        level
    }
}

/// What the source shows there; the fourth value says how sure that is.
fn read(image: &Raster, patch: &Patch) -> Pixels {
    let mut pixels = read_cell(image, &patch.u, &patch.v);
    for (pixel, sure) in pixels.iter_mut().zip(&patch.sure) {
        *pixel = if pixel[3] == SURE { [pixel[0], pixel[1], pixel[2], *sure] } else { [0, 0, 0, NOTHING] };
    }
    pixels
}

/// By factors given at the corners, the same interpolation as the map's.
fn multiply(pixels: &mut Pixels, corners: [[f32; 3]; 4]) {
    let [a, b, c, d] = corners;
    for (i, pixel) in pixels.iter_mut().enumerate() {
        let (x, y) = ((i % CELL) as f32 / CELL as f32, (i / CELL) as f32 / CELL as f32);
        for channel in 0..3 {
            let left = a[channel] + (c[channel] - a[channel]) * y;
            let right = b[channel] + (d[channel] - b[channel]) * y;
            let value = f32::from(pixel[channel]) * (left + (right - left) * x);
            pixel[channel] = (value + 0.5).min(255.0) as u8;
        }
    }
}

/// How much of each source stands at each corner of the cells.
struct Weights {
    /// Source by source; those of a corner add up to 1, or 0 where no source shows it.
    weights: Vec<Vec<f32>>,
}

impl Weights {
    fn new(target: &Target, warps: &[Warp]) -> Self {
        let mut weights: Vec<Vec<f32>> = warps.iter().map(|warp| scores(target, warp)).collect();
        for node in 0..target.node_count() {
            let best = weights.iter().map(|scores| scores[node]).fold(0.0, f32::max);
            let least = best * (1.0 - FEATHER);
            let left = |score: f32| (score - least).max(0.0);
            let sum: f32 = weights.iter().map(|scores| left(scores[node])).sum();
            for scores in &mut weights {
                scores[node] = if sum > 0.0 { left(scores[node]) / sum } else { 0.0 };
            }
        }
        Self { weights }
    }

    fn of(&self, source: usize, node: usize) -> f32 {
        self.weights[source][node]
    }

    /// Of what is shown at all.
    fn shares(&self) -> Vec<f64> {
        let sums: Vec<f64> = self.weights.iter().map(|w| w.iter().map(|w| f64::from(*w)).sum()).collect();
        let all: f64 = sums.iter().sum();
        sums.iter().map(|sum| sum / all.max(1e-9)).collect()
    }
}

/// How good a source is at the corners of the cells: resolution (source pixels to a pixel), distance from its border,
/// and for what is far how near it was taken. 0 where it shows nothing.
fn scores(target: &Target, warp: &Warp) -> Vec<f32> {
    let (columns, rows) = target.camera().cells();
    let source = warp.source();
    let (width, height) = (source.camera.width() as f32 - 1.0, source.camera.height() as f32 - 1.0);
    let far = (1.0 / (1.0 + warp.baseline_m() / FAR_BASELINE_M)) as f32;
    let score = |node: usize| {
        let [u, v] = warp.node(node);
        let border = u.min(v).min(width - u).min(height - v);
        if border.is_nan() || border < 0.0 || !shows(source, u, v) {
            return 0.0;
        }
        let (column, row) = (node % (columns + 1), node / (columns + 1));
        let step = |before: usize, after: usize| {
            let ([a, b], [c, d]) = (warp.node(before), warp.node(after));
            [c - a, d - b]
        };
        let [left, right] = [column.saturating_sub(1), (column + 1).min(columns)].map(|c| row * (columns + 1) + c);
        let [above, below] = [row.saturating_sub(1), (row + 1).min(rows)].map(|r| r * (columns + 1) + column);
        let ([ux, vx], [uy, vy]) = (step(left, right), step(above, below));
        let area = (ux * vy - uy * vx).abs() / (4 * CELL * CELL) as f32;
        let resolution = if area.is_nan() { 0.5 } else { area.clamp(0.05, 4.0) };
        let edge = (border / BORDER_PX).clamp(0.05, 1.0);
        let near = if target.surface_at(node) == Some(Surface::Far) { far } else { 1.0 };
        resolution * edge * near
    };
    (0..target.node_count()).map(score).collect()
}

/// Whether the source's pixel there shows the world.
fn shows(source: &Candidate, u: f32, v: f32) -> bool {
    let image = source.image.full();
    image.pixels[(v + 0.5) as usize * image.width + (u + 0.5) as usize][3] == SURE
}

/// The part of a cell that lies in the image; black where the lens draws nothing.
fn put(image: &mut Raster, cell: &Pixels, column: usize, row: usize, shows: &[bool]) {
    let (left, top) = (column * CELL, row * CELL);
    let count = CELL.min(image.width - left);
    for (line, pixels) in cell.chunks_exact(CELL).enumerate().take(image.height - top) {
        let start = (top + line) * image.width + left;
        for ((to, from), shows) in image.pixels[start..start + count].iter_mut().zip(pixels).zip(&shows[start..]) {
            if *shows {
                *to = *from;
            }
        }
    }
}
