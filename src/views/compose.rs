//! One image of several sources: for each pixel the best of them, with feathered seams.

use super::Candidate;
use super::answer::Request;
use super::camera::{AREA, CELL, Camera};
use super::ground_warp::{Patch, Warp};
use super::photometry::{Gain, factors};
use super::raster::{NOTHING, Raster, SURE};
use super::sample::{Pixels, read_cell};
use super::target::{Target, corners};
use super::weights::Weights;
use crate::vectorised::vectorised;

/// The picture, and which share of it each source has.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Composed {
    pub(super) image: Raster,
    pub(super) shares: Vec<f64>,
}

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
            put(&mut image, &cell, (column, row), camera);
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
        (None, _) => [[0; 4]; AREA],
        (Some(only), None) => layers[only].pixels(cell, &at),
        (Some(_), Some(_)) => blend(layers, weights, cell, &at),
    };
    if vectorised(|| is_full(&pixels)) {
        return pixels;
    }
    // Corners may see what a pixel does not, and the other way round.
    let hole = |pixels: &Pixels| (0..AREA).any(|i| pixels[i][3] == NOTHING && target.shows(cell, i));
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

#[inline(always)]
fn is_full(pixels: &Pixels) -> bool {
    pixels.iter().fold(true, |full, pixel| full & (pixel[3] != NOTHING))
}

fn blend(layers: &[Layer], weights: &Weights, cell: (usize, usize), at: &[usize; 4]) -> Pixels {
    let mut sums = Sums::default();
    for (index, layer) in layers.iter().enumerate() {
        let corners = at.map(|corner| weights.of(index, corner));
        if corners != [0.0; 4] {
            let pixels = layer.pixels(cell, at);
            vectorised(|| sums.add(&pixels, corners));
        }
    }
    vectorised(|| sums.means())
}

/// Pixels of a cell, weighed and added up: red, green, blue and the weights.
struct Sums {
    sums: [[f32; AREA]; 4],
    sure: [u32; AREA],
}

impl Default for Sums {
    fn default() -> Self {
        Self { sums: [[0.0; AREA]; 4], sure: [NOTHING.into(); AREA] }
    }
}

impl Sums {
    /// `corners`: the weights there.
    #[inline(always)]
    fn add(&mut self, pixels: &Pixels, corners: [f32; 4]) {
        let weights = between(corners);
        let [reds, greens, blues, sums] = &mut self.sums;
        for (i, [red, green, blue, known]) in pixels.iter().enumerate() {
            let weight = if *known == NOTHING { 0.0 } else { weights[i] };
            reds[i] += weight * f32::from(*red);
            greens[i] += weight * f32::from(*green);
            blues[i] += weight * f32::from(*blue);
            sums[i] += weight;
            let known = if weight > 0.0 { *known } else { NOTHING };
            self.sure[i] = self.sure[i].max(known.into());
        }
    }

    #[inline(always)]
    fn means(&self) -> Pixels {
        let mut pixels = [[0; 4]; AREA];
        for (i, pixel) in pixels.iter_mut().enumerate() {
            let sum = self.sums[3][i];
            let enough = sum > 1e-4;
            let per_weight = if enough { 1.0 / sum } else { 0.0 };
            let mean = |channel: usize| (self.sums[channel][i] * per_weight + 0.5) as u8;
            *pixel = [mean(0), mean(1), mean(2), if enough { self.sure[i] as u8 } else { NOTHING }];
        }
        pixels
    }
}

/// Values at the corners of a cell, interpolated for its pixels.
#[inline(always)]
fn between([a, b, c, d]: [f32; 4]) -> [f32; AREA] {
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
            vectorised(|| multiply(&mut pixels, at.map(|corner| factors[corner])));
        }
        pixels
    }

    /// By how many powers of two the view shrinks the source here.
    fn level(&self, at: &[usize; 4]) -> usize {
        let [a, b, c, _] = at.map(|corner| self.warp.node(corner));
        let square = |p: [f32; 2], q: [f32; 2]| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
        let square = square(a, b).max(square(a, c));
        let mut level = 0;
        let mut from = SHRINKS_FROM * CELL as f32;
        // Not for NaN.
        while square > from * from && level + 1 < super::raster::LEVELS {
            level += 1;
            from *= 2.0;
        }
        level
    }
}

/// What the source shows there; the fourth value says how sure that is.
fn read(image: &Raster, patch: &Patch) -> Pixels {
    let mut pixels = read_cell(image, &patch.u, &patch.v);
    vectorised(|| {
        for (pixel, sure) in pixels.iter_mut().zip(&patch.sure) {
            let [red, green, blue, known] = *pixel;
            *pixel = if known == SURE { [red, green, blue, *sure] } else { [0, 0, 0, NOTHING] };
        }
    });
    pixels
}

/// By factors given at the corners, the same interpolation as the map's.
#[inline(always)]
fn multiply(pixels: &mut Pixels, corners: [[f32; 3]; 4]) {
    let factors: [[f32; AREA]; 3] = core::array::from_fn(|channel| between(corners.map(|corner| corner[channel])));
    for (i, pixel) in pixels.iter_mut().enumerate() {
        for (value, factors) in pixel.iter_mut().zip(&factors) {
            *value = (f32::from(*value) * factors[i] + 0.5).min(255.0) as u8;
        }
    }
}

/// The part of a cell that lies in the image; black where the lens draws nothing.
fn put(image: &mut Raster, cell: &Pixels, (column, row): (usize, usize), camera: &Camera) {
    let (left, top) = (column * CELL, row * CELL);
    let count = CELL.min(image.width - left);
    let is_full = camera.is_full((column, row));
    for (line, pixels) in cell.chunks_exact(CELL).enumerate().take(image.height - top) {
        let start = (top + line) * image.width + left;
        let to = &mut image.pixels[start..start + count];
        if is_full {
            to.copy_from_slice(pixels);
            continue;
        }
        for ((to, from), shows) in to.iter_mut().zip(pixels).zip(&camera.shows()[start..]) {
            *to = if *shows { *from } else { [0, 0, 0, NOTHING] };
        }
    }
}
