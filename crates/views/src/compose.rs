//! Composition of one image from several sources: the best source for each pixel, with feathered seams.

use super::Candidate;
use super::camera::{AREA, CELL, Camera};
use super::ground_warp::{Patch, Warp};
use super::photometry::{Gain, factors};
use super::raster::{NOTHING, Raster, SURE};
use super::sample::{Pixels, read_cell};
use super::synthesized_view::Request;
use super::target_rays::{Target, corners, interpolate_cell};
use super::weights::Weights;
use realitysim_geometry::multiversion::rounded;
use realitysim_geometry::multiversioned;

/// The composed picture, and the number of pixels that each source contributes.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Composed {
    pub(super) image: Raster,
    pub(super) pixels: Vec<f64>,
}

/// A smaller copy of a source is read from this many source pixels per view pixel on, and the next one from twice as many.
const SHRINKS_FROM: f32 = 1.5;
/// A pixel whose weights add up to less is shown by no source.
const MIN_WEIGHT: f32 = 1e-4;

/// Composes the view. `warps`, `sources` and `gains` are parallel, nearest source first.
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
    let mut filled = vec![0; layers.len()];
    for row in 0..rows {
        for column in 0..columns {
            let cell = compose_cell(&layers, &weights, target, (column, row), &mut filled);
            write_cell(&mut image, &cell, (column, row), camera);
        }
    }
    let pixels = weights.pixels().zip(filled).map(|(weighed, filled)| weighed + filled as f64).collect();
    Composed { image, pixels }
}

/// One source with its map and its brightness correction.
struct Layer<'a> {
    warp: &'a Warp<'a>,
    source: &'a Candidate<'a>,
    /// Factors for red, green and blue at the corners of the cells; `None` if brightness stays as it is.
    factors: Option<Vec<[f32; 3]>>,
}

/// Composes one cell. `filled` counts the pixels of each source that were taken only because no weighted source shows them.
fn compose_cell(
    layers: &[Layer],
    weights: &Weights,
    target: &Target,
    cell: (usize, usize),
    filled: &mut [usize],
) -> Pixels {
    let at = corners(target.camera().cells().0, cell);
    let takes_part = |index: &usize| at.iter().any(|corner| weights.weight(*index, *corner) > 0.0);
    let mut taking = (0..layers.len()).filter(takes_part);
    let (mut pixels, whole) = match (taking.next(), taking.next()) {
        (None, _) => ([[0; 4]; AREA], None),
        (Some(only), None) => (layers[only].pixels(cell, &at), Some(only)),
        (Some(_), Some(_)) => (blend(layers, weights, cell, &at), None),
    };
    if is_full(&pixels) {
        return pixels;
    }
    // A pixel may be visible although the corners of its cell are not, and a source without weight may be the only one to show it.
    let has_hole = |pixels: &Pixels| (0..AREA).any(|i| pixels[i][3] == NOTHING && target.shows(cell, i));
    for through_goals in [false, true] {
        for (index, layer) in layers.iter().enumerate() {
            if !layer.warp.may_show(cell.0, cell.1) || (!through_goals && whole == Some(index)) {
                continue;
            }
            if !has_hole(&pixels) {
                return pixels;
            }
            if through_goals && !layer.warp.sees_goal_in(cell) {
                continue;
            }
            let more = match through_goals {
                false => layer.pixels(cell, &at),
                true => layer.read(layer.warp.patch_through_goals(cell.0, cell.1), &at),
            };
            for (i, (pixel, more)) in pixels.iter_mut().zip(more).enumerate() {
                if pixel[3] == NOTHING && more[3] != NOTHING {
                    *pixel = more;
                    filled[index] += usize::from(target.shows(cell, i));
                }
            }
        }
    }
    pixels
}

fn is_full(pixels: &Pixels) -> bool {
    multiversioned!(|pixels: &Pixels| -> bool { pixels.iter().fold(true, |full, pixel| full & (pixel[3] != NOTHING)) })
}

/// The weighted mean of the sources that have weight in this cell.
fn blend(layers: &[Layer], weights: &Weights, cell: (usize, usize), at: &[usize; 4]) -> Pixels {
    let mut sums = Sums::default();
    for (index, layer) in layers.iter().enumerate() {
        let corners = at.map(|corner| weights.weight(index, corner));
        if corners != [0.0; 4] {
            sums.add(&layer.pixels(cell, at), corners);
        }
    }
    sums.means()
}

/// Weighted sums of the pixels of a cell, by channel.
struct Sums {
    channels: [[f32; AREA]; 3],
    weights: [f32; AREA],
    /// The largest mask value so far.
    sure: [u32; AREA],
}

impl Default for Sums {
    fn default() -> Self {
        Self { channels: [[0.0; AREA]; 3], weights: [0.0; AREA], sure: [NOTHING.into(); AREA] }
    }
}

impl Sums {
    /// Adds the pixels of one source, whose weights are given at the corners of the cell.
    fn add(&mut self, pixels: &Pixels, corners: [f32; 4]) {
        let sums = self;
        multiversioned!(|sums: &mut Sums, pixels: &Pixels, corners: [f32; 4]| {
            let weights = interpolate_cell(corners);
            for (i, pixel) in pixels.iter().enumerate() {
                let [red, green, blue, known] = unpack(*pixel);
                let weight = if known == u32::from(NOTHING) { 0.0 } else { weights[i] };
                let [reds, greens, blues] = &mut sums.channels;
                reds[i] += weight * red as i32 as f32;
                greens[i] += weight * green as i32 as f32;
                blues[i] += weight * blue as i32 as f32;
                sums.weights[i] += weight;
                let known = if weight > 0.0 { known } else { NOTHING.into() };
                sums.sure[i] = sums.sure[i].max(known);
            }
        });
    }

    /// The weighted means; black where the weights add up to too little.
    fn means(&self) -> Pixels {
        let sums = self;
        multiversioned!(|sums: &Sums| -> Pixels {
            let mut pixels = [[0; 4]; AREA];
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let sum = sums.weights[i];
                let enough = sum > MIN_WEIGHT;
                let per_weight = if enough { 1.0 / sum } else { 0.0 };
                let [red, green, blue] = &sums.channels;
                let sure = if enough { sums.sure[i] } else { NOTHING.into() };
                let [red, green, blue] = [red[i] * per_weight, green[i] * per_weight, blue[i] * per_weight];
                *pixel = pack([rounded(red), rounded(green), rounded(blue), sure]);
            }
            pixels
        })
    }
}

/// Unpacks the four channels of a pixel in a form that the compiler vectorises.
#[inline(always)]
fn unpack(pixel: [u8; 4]) -> [u32; 4] {
    let pixel = u32::from_le_bytes(pixel);
    [pixel & 255, pixel >> 8 & 255, pixel >> 16 & 255, pixel >> 24]
}

/// Packs four channels, each at most 255, into a pixel.
#[inline(always)]
fn pack([red, green, blue, sure]: [u32; 4]) -> [u8; 4] {
    (red | green << 8 | blue << 16 | sure << 24).to_le_bytes()
}

impl Layer<'_> {
    /// The pixels of a cell as this source shows them.
    fn pixels(&self, cell: (usize, usize), at: &[usize; 4]) -> Pixels {
        self.read(self.warp.patch(cell.0, cell.1), at)
    }

    /// Reads the source at the coordinates of `patch` and corrects its brightness.
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

    /// The pyramid level to read: how many powers of two the view shrinks the source here.
    fn level(&self, at: &[usize; 4]) -> usize {
        let [a, b, c, _] = at.map(|corner| self.warp.node(corner));
        let square = |p: [f32; 2], q: [f32; 2]| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2);
        let square = square(a, b).max(square(a, c));
        let mut level = 0;
        let mut from = SHRINKS_FROM * CELL as f32;
        // The comparison is false for NaN.
        while square > from * from && level + 1 < super::raster::LEVELS {
            level += 1;
            from *= 2.0;
        }
        level
    }
}

/// Reads the source. Pixels that are not sure in the source become black; the others take their mask value from `patch`.
fn read(image: &Raster, patch: &Patch) -> Pixels {
    let mut pixels = read_cell(image, &patch.u, &patch.v);
    let (target, sure) = (&mut pixels, &patch.sure);
    multiversioned!(|target: &mut Pixels, sure: &[u8; AREA]| {
        for (pixel, sure) in target.iter_mut().zip(sure) {
            let [red, green, blue, known] = unpack(*pixel);
            let keep = if known == u32::from(SURE) { u32::MAX } else { 0 };
            *pixel = pack([red & keep, green & keep, blue & keep, u32::from(*sure) & keep]);
        }
    });
    pixels
}

/// Multiplies pixels by factors given at the corners of the cell, interpolated like the map.
fn multiply(pixels: &mut Pixels, corners: [[f32; 3]; 4]) {
    multiversioned!(|pixels: &mut Pixels, corners: [[f32; 3]; 4]| {
        let [[ar, ag, ab], [br, bg, bb], [cr, cg, cb], [dr, dg, db]] = corners;
        let (reds, greens, blues) = (
            interpolate_cell([ar, br, cr, dr]),
            interpolate_cell([ag, bg, cg, dg]),
            interpolate_cell([ab, bb, cb, db]),
        );
        let times = |value: u32, factor: f32| rounded((value as i32 as f32 * factor).min(255.0));
        for (i, pixel) in pixels.iter_mut().enumerate() {
            let [red, green, blue, sure] = unpack(*pixel);
            *pixel = pack([times(red, reds[i]), times(green, greens[i]), times(blue, blues[i]), sure]);
        }
    });
}

/// Writes the part of a cell that lies in the image; black where the lens draws nothing.
fn write_cell(image: &mut Raster, cell: &Pixels, (column, row): (usize, usize), camera: &Camera) {
    let (left, top) = (column * CELL, row * CELL);
    let count = CELL.min(image.width - left);
    let is_full = camera.is_full((column, row));
    for (line, pixels) in cell.chunks_exact(CELL).enumerate().take(image.height - top) {
        let start = (top + line) * image.width + left;
        let to = &mut image.pixels[start..start + count];
        if is_full && let Ok(to) = <&mut [[u8; 4]; CELL]>::try_from(&mut *to) {
            to.copy_from_slice(pixels);
            continue;
        }
        for ((to, from), shows) in to.iter_mut().zip(pixels).zip(&camera.shows()[start..]) {
            *to = if *shows { *from } else { [0, 0, 0, NOTHING] };
        }
    }
}
