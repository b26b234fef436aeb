//! Brightness and colour: the vignetting of lenses, and one gain per channel between images.

use super::Candidate;
use super::camera::CELL;
use super::ground_warp::Warp;
use super::raster::SURE;
use super::sample::read;
use super::target_rays::Target;
use realitysim_geometry::Lens;

/// Vignetting of a lens as relative illumination 1 + k1 r^2 + k2 r^4 + k3 r^6.
///
/// r is the distance from the image's centre as a share of half the diagonal. All zero: the lens darkens nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vignetting {
    /// The coefficients k1, k2, k3.
    pub k: [f64; 3],
}

/// Factors by which a source's pixels are multiplied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// Factors for red, green and blue.
    pub rgb: [f64; 3],
}

impl Gain {
    /// Leaves brightness as it is.
    pub const NONE: Self = Self { rgb: [1.0; 3] };
}

/// Darker values are noise.
const MIN_VALUE: u8 = 6;
/// Brighter values are clipped.
const CLIPPING_THRESHOLD: u8 = 249;
/// Every n-th corner of the view's cells is compared. The corners used still spread over the view, since rows have odd lengths.
const CORNER_STEP: usize = 2;
/// Fewer common points give no gain.
const MIN_PLACES: usize = 25;
/// Largest gain: no two exposures of a day differ by more.
const GAIN_LIMIT: f64 = 8.0;
/// A gain that differs less from 1 is ignored: less than half a step of a bright pixel.
const MIN_CHANGE: f64 = 0.002;
/// Pyramid level that brightness is read at, a quarter of the size: a mean over grain and noise.
const PYRAMID_LEVEL: usize = 2;

impl Vignetting {
    fn is_none(&self) -> bool {
        self.k == [0.0; 3]
    }

    /// Relative illumination at a pixel, at least 0.1 so that dividing by it does not amplify noise without bound.
    pub fn at(&self, lens: &Lens, u: f64, v: f64) -> f64 {
        // Most lenses have no known vignetting, and this runs for every corner of every cell.
        if self.is_none() { 1.0 } else { self.illumination(Self::r2(lens, u, v)) }
    }

    /// Squared distance of a pixel from the image's centre, as a share of half the diagonal's square.
    pub(super) fn r2(lens: &Lens, u: f64, v: f64) -> f64 {
        let (half_width, half_height) = (f64::from(lens.width()) / 2.0, f64::from(lens.height()) / 2.0);
        let (x, y) = (u + 0.5 - half_width, v + 0.5 - half_height);
        (x * x + y * y) / (half_width * half_width + half_height * half_height)
    }

    /// Relative illumination at a squared relative distance from the centre.
    pub(super) fn illumination(&self, r2: f64) -> f64 {
        let [k1, k2, k3] = self.k;
        (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))).max(0.1)
    }
}

/// Gains that make every source as bright as the first one, from the ground that both show.
pub(super) fn balance(target: &Target, warps: &[Warp], sources: &[Candidate]) -> Vec<Gain> {
    let (Some(first), Some(reference)) = (sources.first(), warps.first()) else { return Vec::new() };
    if sources.len() == 1 {
        return vec![Gain::NONE];
    }
    let places: Vec<(usize, [f64; 3])> = (0..target.node_count())
        .step_by(CORNER_STEP)
        .filter_map(|node| reading((reference, first), node).map(|reading| (node, reading)))
        .collect();
    let others = warps.iter().zip(sources).skip(1);
    let gain = |other| gain_between(&places, other).unwrap_or(Gain::NONE);
    core::iter::once(Gain::NONE).chain(others.map(gain)).collect()
}

/// The gain of `other`. `places` are corners of the view's cells with the colour that the reference shows there.
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
    let rgb: [f64; 3] = core::array::from_fn(|c| (wanted[c] / found[c]).clamp(1.0 / GAIN_LIMIT, GAIN_LIMIT));
    let shows = rgb.iter().any(|gain| (gain - 1.0).abs() > MIN_CHANGE);
    (count >= MIN_PLACES && shows).then_some(Gain { rgb })
}

/// The colour that a source shows at a corner of the view's cells, cleared of the lens's vignetting.
pub(super) fn reading((warp, source): (&Warp, &Candidate), node: usize) -> Option<[f64; 3]> {
    let [u, v] = warp.node(node);
    let (image, level) = source.image.level(PYRAMID_LEVEL);
    let scale = 1.0 / (1 << level) as f32;
    let [r, g, b, sure] = read(image, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5);
    let fits = sure == SURE && [r, g, b].iter().all(|value| (MIN_VALUE..=CLIPPING_THRESHOLD).contains(value));
    let light = source.vignetting.at(source.camera.lens(), f64::from(u), f64::from(v));
    fits.then(|| [r, g, b].map(|value| f64::from(value) / light))
}

/// Factors at the corners of the cells, from gain and both lenses' vignetting. `None` if all are 1.
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
        // At a corner that the source does not show, its vignetting is unknown.
        let light = if u.is_nan() { 1.0 } else { here / there };
        gain.rgb.map(|gain| (gain * light) as f32)
    };
    Some((0..target.node_count()).map(factor).collect())
}
