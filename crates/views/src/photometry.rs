//! Brightness and colour: what a lens darkens towards its border, and one gain per channel from image to image.

use super::Candidate;
use super::camera::CELL;
use super::ground_warp::Warp;
use super::raster::SURE;
use super::sample::read;
use super::target_rays::Target;
use realitysim_geometry::Lens;

/// Relative illumination 1 + k1 r^2 + k2 r^4 + k3 r^6; r is the distance from the image's centre as a share of half
/// the diagonal. All zero: the lens darkens nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vignetting {
    pub k: [f64; 3],
}

/// What a source's pixels are multiplied with, channel by channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    pub rgb: [f64; 3],
}

impl Gain {
    pub const NONE: Self = Self { rgb: [1.0; 3] };
}

/// Darker values are noise, brighter ones are cut off.
const DARKEST: u8 = 6;
const BRIGHTEST: u8 = 249;
/// Of the corners of the view's cells: enough of them, spread over the view, as a row's number of corners is no multiple.
const EVERY: usize = 2;
/// Fewer common places say nothing about gains.
const FEWEST: usize = 25;
/// No two exposures of a day differ by more.
const MOST_GAIN: f64 = 8.0;
/// Less than half a step of a bright pixel is none.
const LEAST_CHANGE: f64 = 0.002;
/// Copies a quarter of the size: means over grain and noise.
const LEVEL: usize = 2;

impl Vignetting {
    fn is_none(&self) -> bool {
        self.k == [0.0; 3]
    }

    /// At a pixel; never so dark that dividing by it would make noise of everything.
    pub fn at(&self, lens: &Lens, u: f64, v: f64) -> f64 {
        // Most sources darken nothing that is known of, and this is asked at every corner of every cell.
        if self.is_none() { 1.0 } else { self.illumination(Self::r2(lens, u, v)) }
    }

    /// Squared distance from the image's centre, as a share of half the diagonal's.
    pub(super) fn r2(lens: &Lens, u: f64, v: f64) -> f64 {
        let (half_width, half_height) = (f64::from(lens.width()) / 2.0, f64::from(lens.height()) / 2.0);
        let (x, y) = (u + 0.5 - half_width, v + 0.5 - half_height);
        (x * x + y * y) / (half_width * half_width + half_height * half_height)
    }

    pub(super) fn illumination(&self, r2: f64) -> f64 {
        let [k1, k2, k3] = self.k;
        (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))).max(0.1)
    }
}

/// Gains that make every source as bright as the first, by what both show of the same ground.
pub(super) fn balance(target: &Target, warps: &[Warp], sources: &[Candidate]) -> Vec<Gain> {
    let (Some(first), Some(reference)) = (sources.first(), warps.first()) else { return Vec::new() };
    if sources.len() == 1 {
        return vec![Gain::NONE];
    }
    let places: Vec<(usize, [f64; 3])> = (0..target.node_count())
        .step_by(EVERY)
        .filter_map(|node| reading((reference, first), node).map(|reading| (node, reading)))
        .collect();
    let others = warps.iter().zip(sources).skip(1);
    let gain = |other| gain_between(&places, other).unwrap_or(Gain::NONE);
    core::iter::once(Gain::NONE).chain(others.map(gain)).collect()
}

/// `places` are corners of the view's cells, and what the reference shows there.
fn gain_between(places: &[(usize, [f64; 3])], other: (&Warp, &Candidate)) -> Option<Gain> {
    let (mut wanted, mut found, mut count) = ([0.0; 3], [0.0; 3], 0usize);
    for (node, a) in places {
        let Some(b) = reading(other, *node) else { continue };
        (0..3).for_each(|c| {
            wanted[c] += a[c];
            found[c] += b[c];
        });
        count += 1;
    }
    let rgb: [f64; 3] = core::array::from_fn(|c| (wanted[c] / found[c]).clamp(1.0 / MOST_GAIN, MOST_GAIN));
    let shows = rgb.iter().any(|gain| (gain - 1.0).abs() > LEAST_CHANGE);
    (count >= FEWEST && shows).then_some(Gain { rgb })
}

/// What a source shows at a corner of the view's cells, as it would be without its lens's darkening.
pub(super) fn reading((warp, source): (&Warp, &Candidate), node: usize) -> Option<[f64; 3]> {
    let [u, v] = warp.node(node);
    let (image, level) = source.image.level(LEVEL);
    let scale = 1.0 / (1 << level) as f32;
    let [r, g, b, sure] = read(image, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5);
    let fits = sure == SURE && [r, g, b].iter().all(|value| (DARKEST..=BRIGHTEST).contains(value));
    let light = source.vignetting.at(source.camera.lens(), f64::from(u), f64::from(v));
    fits.then(|| [r, g, b].map(|value| f64::from(value) / light))
}

/// Factors at the corners of the cells: gain, and both lenses' darkening. `None` if nothing is to be done.
pub(super) fn factors(
    target: &Target,
    warp: &Warp,
    source: &Candidate,
    gain: &Gain,
    wanted: &Vignetting,
) -> Option<Vec<[f32; 3]>> {
    if *gain == Gain::NONE && (source.vignetting == *wanted && wanted.is_none()) {
        return None;
    }
    let (columns, _) = target.camera().cells();
    let factor = |node: usize| {
        let [u, v] = warp.node(node).map(f64::from);
        let (column, row) = (node % (columns + 1), node / (columns + 1));
        let there = source.vignetting.at(source.camera.lens(), u, v);
        let here = wanted.at(target.camera().lens(), (column * CELL) as f64, (row * CELL) as f64);
        // A corner that the source does not see has no darkening of its own.
        let light = if u.is_nan() { 1.0 } else { here / there };
        gain.rgb.map(|gain| (gain * light) as f32)
    };
    Some((0..target.node_count()).map(factor).collect())
}
