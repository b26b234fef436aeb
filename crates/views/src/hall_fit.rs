//! Finds the walls and the ceiling of a hall by the agreement of recorded images.
//!
//! A plane sweep (R. Collins, "A space-sweep approach to true multi-image matching", 1996) with one plane for each wall: at the right
//! distance, two images of a pair show the same detail at the pixels that the plane assigns to each other. Agreement is the normalized
//! correlation of local contrast over all samples of a pair, so that light and exposure do not matter.

use glam::{DVec2, DVec3};

use super::hall::Hall;
use super::raster::{Raster, SURE};
use super::{Camera, optical};
use realitysim_geometry::Isometry;

/// The detail of one recorded image: its local contrast, at a reduced size.
#[derive(Clone, Debug)]
pub struct HallImage<'a> {
    camera: &'a Camera,
    map_from_optical: Isometry,
    /// Full-size pixels a side that make one reduced pixel.
    reduction: usize,
    width: usize,
    height: usize,
    /// Local contrast, row by row, about -1 to 1; NaN where the image shows nothing, or what moves.
    detail: Vec<f32>,
}

/// Reduced images are at most this wide, pixels.
const MAX_WIDTH_PX: usize = 320;
/// Half the side of the square over which local contrast is taken, reduced pixels.
const NEIGHBOURHOOD_PX: usize = 4;
/// Gray levels that are added to the local standard deviation, so that noise on a plain wall is no detail.
const NOISE_LEVELS: f32 = 4.0;

impl<'a> HallImage<'a> {
    /// The detail of an image of `camera` that was taken from `map_from_link`, its pose of `camera_link` in `map`.
    pub fn new(camera: &'a Camera, map_from_link: &Isometry, image: &Raster) -> Self {
        let reduction = image.width.div_ceil(MAX_WIDTH_PX).max(1);
        let (width, height) = (image.width / reduction, image.height / reduction);
        let mean = |index: usize| -> f32 {
            let (left, top) = (index % width * reduction, index / width * reduction);
            let mut sum = 0u32;
            for v in top..top + reduction {
                for [red, green, blue, known] in &image.pixels[v * image.width + left..][..reduction] {
                    if *known != SURE {
                        return f32::NAN;
                    }
                    sum += u32::from(*red) + 2 * u32::from(*green) + u32::from(*blue);
                }
            }
            sum as f32 / (4 * reduction * reduction) as f32
        };
        let luma: Vec<f32> = (0..width * height).map(mean).collect();
        let detail = local_contrast(&luma, width, height);
        Self { camera, map_from_optical: optical(map_from_link), reduction, width, height, detail }
    }

    /// Position of the camera in `map`, metres.
    fn place(&self) -> DVec3 {
        self.map_from_optical.translation
    }

    /// The local contrast at a pixel of the full size, interpolated; NaN outside.
    fn at(&self, pixel: DVec2) -> f32 {
        let at = (pixel + 0.5) / self.reduction as f64 - 0.5;
        let (left, top) = (libm::floor(at.x), libm::floor(at.y));
        // NaN fails.
        if !(left >= 0.0 && top >= 0.0 && left + 1.0 < self.width as f64 && top + 1.0 < self.height as f64) {
            return f32::NAN;
        }
        let (across, down) = ((at.x - left) as f32, (at.y - top) as f32);
        let row = |v: usize| {
            let start = v * self.width + left as usize;
            self.detail[start] * (1.0 - across) + self.detail[start + 1] * across
        };
        row(top as usize) * (1.0 - down) + row(top as usize + 1) * down
    }

    /// Samples every `spacing`-th reduced pixel in both directions: its unit ray in `map`, and its local contrast.
    fn samples(&self, spacing: usize) -> Vec<(DVec3, f32)> {
        let mut samples = Vec::new();
        for v in (spacing / 2..self.height).step_by(spacing) {
            for u in (spacing / 2..self.width).step_by(spacing) {
                let detail = self.detail[v * self.width + u];
                if detail.is_nan() {
                    continue;
                }
                let centre = |at: usize| at * self.reduction + self.reduction / 2;
                let Some(ray) = self.camera.ray(centre(u), centre(v)) else { continue };
                samples.push((
                    self.map_from_optical.transform_vector(ray),
                    self.at(DVec2::new(centre(u) as f64, centre(v) as f64)),
                ));
            }
        }
        samples
    }
}

/// Difference from the mean of the neighbourhood, divided by its standard deviation plus some noise. NaN beside an unknown pixel.
fn local_contrast(luma: &[f32], width: usize, height: usize) -> Vec<f32> {
    let squares: Vec<f32> = luma.iter().map(|value| value * value).collect();
    let (means, mean_squares) = (box_means(luma, width, height), box_means(&squares, width, height));
    let contrast = |((value, mean), square): ((&f32, &f32), &f32)| {
        (value - mean) / ((square - mean * mean).max(0.0).sqrt() + NOISE_LEVELS)
    };
    luma.iter().zip(&means).zip(&mean_squares).map(contrast).collect()
}

/// Means over squares around each pixel, clipped at the image's border; NaN where the square holds a NaN.
fn box_means(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let mean = |from: &dyn Fn(usize) -> f32, at: usize, end: usize| {
        let range = at.saturating_sub(NEIGHBOURHOOD_PX)..(at + NEIGHBOURHOOD_PX + 1).min(end);
        let count = range.len() as f32;
        range.map(from).sum::<f32>() / count
    };
    let rows: Vec<f32> =
        (0..width * height).map(|i| mean(&|u| values[i / width * width + u], i % width, width)).collect();
    (0..width * height).map(|i| mean(&|v| rows[v * width + i % width], i / width, height)).collect()
}

/// Distances between the cameras of a pair: enough parallax, and still the same objects at a similar size.
const BASELINE_M: core::ops::RangeInclusive<f64> = 0.4..=2.5;
/// Largest angle between the directions from both cameras' optical axes, as a cosine: the images overlap.
const MIN_AXES_COSINE: f64 = 0.5;
/// Most pairs that are compared.
const MAX_PAIRS: usize = 48;
/// Fewest pairs that tell anything, of which half find a plane and half confirm it.
const MIN_PAIRS: usize = 8;
/// Fewest samples of a pair on one plane.
const MIN_SAMPLES: usize = 60;
/// Spacing of samples in reduced pixels while the hall's direction is sought, and when distances are measured.
const SPACING_PX: [usize; 2] = [8, 4];
/// Nearest and farthest distance of a wall from the ground's edge that is looked for, metres.
const WALL_BEYOND_M: [f64; 2] = [0.3, 30.0];
/// Lowest and highest ceiling that is looked for, metres.
const CEILING_M: [f64; 2] = [2.2, 25.0];
/// Number of distances in a sweep, evenly spaced in their inverse.
const STEPS: usize = 72;
/// Largest angle of a sample's azimuth from a wall's normal, as a cosine.
const MIN_WALL_COSINE: f64 = 0.72;
/// Elevations, as sines, of the samples of walls and of the ceiling. Below the horizon people and boards stand before a wall.
const WALL_SINES: [f64; 2] = [0.02, 0.5];
const MIN_CEILING_SINE: f64 = 0.4;
/// Smallest gain of the mean correlation over "far" that makes a plane known.
const MIN_GAIN: f64 = 0.04;
/// Smallest share of the pairs kept aside that the plane must serve better than "far".
const MIN_CONFIRMING_SHARE: f64 = 0.75;
/// Largest angle between hall and field, degrees; beyond it another wall is the first.
const MAX_YAW_DEG: f64 = 45.0;
/// Steps in which angles are tried, degrees: first all, then those around the best.
const YAW_STEPS_DEG: [f64; 3] = [9.0, 3.0, 1.0];
/// Gain of the mean correlation that makes a hall stand at an angle to the field. Few do.
const MIN_YAW_GAIN: f64 = 0.02;

/// What the images say about the hall.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HallFit {
    /// The planes that the images determine.
    pub hall: Hall,
    /// Number of pairs of images that were compared.
    pub pairs: usize,
}

/// Fits the hall to images. `ground_half` are the half extents of the ground, metres: walls stand outside. A plane is known only if the
/// pairs that it was not found with confirm it.
pub fn fit_hall(images: &[HallImage], ground_half: DVec2) -> HallFit {
    let pairs = pairs(images);
    if pairs.len() < MIN_PAIRS {
        return HallFit { pairs: pairs.len(), ..HallFit::default() };
    }
    let [coarse, fine] =
        SPACING_PX.map(|spacing| images.iter().map(|image| image.samples(spacing)).collect::<Vec<_>>());
    let sweep = |samples, hall: Hall, plane| Sweep { images, samples, pairs: &pairs, ground_half, hall, plane };
    let turned = |yaw_deg: f64| Hall { yaw_rad: yaw_deg.to_radians(), ..Hall::default() };
    let merit = |yaw_deg: f64| -> f64 {
        let gains: Vec<f64> =
            (0..4).filter_map(|wall| Some(sweep(&coarse, turned(yaw_deg), Plane::Wall(wall)).best(2)?.gain)).collect();
        gains.iter().sum::<f64>() / gains.len().max(1) as f64
    };
    let aligned = merit(0.0);
    let (mut best, mut reach_deg) = ((aligned, 0.0), MAX_YAW_DEG);
    for step_deg in YAW_STEPS_DEG {
        let count = libm::floor(reach_deg / step_deg) as i32;
        let tried = (-count..=count).map(|step| best.1 + f64::from(step) * step_deg);
        best = tried.map(|yaw_deg| (merit(yaw_deg), yaw_deg)).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or(best);
        reach_deg = step_deg;
    }
    let yaw_deg = if best.0 >= aligned + MIN_YAW_GAIN { best.1 } else { 0.0 };
    let mut hall = turned(yaw_deg);
    hall.walls_m = core::array::from_fn(|wall| sweep(&fine, hall, Plane::Wall(wall)).known());
    hall.ceiling_m = sweep(&fine, hall, Plane::Ceiling).known();
    if hall.is_unknown() {
        hall.yaw_rad = 0.0;
    }
    HallFit { hall, pairs: pairs.len() }
}

/// Pairs of images with parallax and overlap, spread evenly over all such pairs.
fn pairs(images: &[HallImage]) -> Vec<(usize, usize)> {
    let axis = |image: &HallImage| image.map_from_optical.transform_vector(DVec3::Z);
    let suits = |(first, second): &(usize, usize)| {
        let [first, second] = [&images[*first], &images[*second]];
        BASELINE_M.contains(&first.place().distance(second.place())) && axis(first).dot(axis(second)) >= MIN_AXES_COSINE
    };
    let all: Vec<(usize, usize)> = (0..images.len())
        .flat_map(|first| (first + 1..images.len()).map(move |second| (first, second)))
        .filter(suits)
        .collect();
    let count = MAX_PAIRS.min(all.len());
    (0..count).map(|index| all[index * all.len() / count]).collect()
}

/// A plane of the hall.
#[derive(Clone, Copy, Debug)]
enum Plane {
    Wall(usize),
    Ceiling,
}

/// The sweep of one plane.
struct Sweep<'a> {
    images: &'a [HallImage<'a>],
    samples: &'a [Vec<(DVec3, f32)>],
    pairs: &'a [(usize, usize)],
    ground_half: DVec2,
    hall: Hall,
    plane: Plane,
}

/// The best distance of a sweep.
struct Best {
    distance_m: f64,
    /// Mean correlation at that distance, less that at an infinite one.
    gain: f64,
}

impl Sweep<'_> {
    /// The distance at which the pairs with an even number agree best, if those with an odd number confirm it.
    fn known(&self) -> Option<f64> {
        let best = self.best(2)?;
        let mut votes = (0, 0);
        for pair in self.pairs.iter().skip(1).step_by(2) {
            let Some([there, far]) = self.correlations(*pair, [1.0 / best.distance_m, 0.0]) else { continue };
            votes = (votes.0 + usize::from(there > far), votes.1 + 1);
        }
        let is_confirmed = votes.1 >= MIN_PAIRS / 2 && votes.0 as f64 >= MIN_CONFIRMING_SHARE * votes.1 as f64;
        (best.gain >= MIN_GAIN && is_confirmed).then_some(best.distance_m)
    }

    /// The distance at which every `every`-th pair agrees best; `None` if too few show the plane.
    fn best(&self, every: usize) -> Option<Best> {
        let inverse: [f64; STEPS + 1] =
            core::array::from_fn(|step| if step == STEPS { 0.0 } else { self.inverse(step) });
        let mut sums = [0.0; STEPS + 1];
        let mut counted = 0usize;
        for pair in self.pairs.iter().step_by(every) {
            let Some(found) = self.correlations(*pair, inverse) else { continue };
            sums.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
            counted += 1;
        }
        if counted < MIN_PAIRS / 2 {
            return None;
        }
        let (best, _) = sums[..STEPS].iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        // At an end of the sweep it is no maximum: the plane may be anywhere beyond.
        if best == 0 || best + 1 == STEPS {
            return None;
        }
        let gain = (sums[best] - sums[STEPS]) / counted as f64;
        // The vertex of the parabola through the three values around the best.
        let [before, at, after] = [sums[best - 1], sums[best], sums[best + 1]];
        let bend = before - 2.0 * at + after;
        let shift = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        let step = self.inverse(1) - self.inverse(0);
        Some(Best { distance_m: 1.0 / (inverse[best] + shift * step), gain })
    }

    /// The inverse of the plane's distance (of a wall, from the field's centre) at a step of the sweep, 1/m.
    fn inverse(&self, step: usize) -> f64 {
        let [near, far] = match self.plane {
            Plane::Ceiling => CEILING_M,
            Plane::Wall(wall) => {
                let extent = self.hall.normal(wall).abs().dot(self.ground_half);
                WALL_BEYOND_M.map(|beyond| extent + beyond)
            }
        };
        let share = step as f64 / (STEPS - 1) as f64;
        1.0 / near + share * (1.0 / far - 1.0 / near)
    }

    /// Correlations of a pair for several inverse distances of the plane (0: infinitely far); `None` if it shows too little of the plane.
    fn correlations<const N: usize>(&self, (first, second): (usize, usize), inverse: [f64; N]) -> Option<[f64; N]> {
        let other = &self.images[second];
        let (from, to) = (self.images[first].place(), other.place());
        let optical_from_map = other.map_from_optical.rotation.conjugate();
        let normal = match self.plane {
            Plane::Ceiling => DVec3::Z,
            Plane::Wall(wall) => self.hall.normal(wall).extend(0.0),
        };
        let rays: Vec<&(DVec3, f32)> =
            self.samples[first].iter().filter(|(ray, _)| self.may_meet(*ray, normal)).collect();
        let mut found = [0.0; N];
        for (found, inverse) in found.iter_mut().zip(inverse) {
            // The camera's distance from the plane is less than the centre's.
            let to_plane = if inverse > 0.0 { 1.0 / inverse - normal.dot(from) } else { f64::INFINITY };
            let mut sums = Correlation::default();
            for (ray, detail) in &rays {
                let seen = *ray + ray.dot(normal) / to_plane.max(0.05) * (from - to);
                let Some(pixel) = other.camera.projector().project(optical_from_map * seen) else { continue };
                sums.add(*detail, other.at(pixel));
            }
            *found = sums.value()?;
        }
        Some(found)
    }

    /// Whether a ray is of those that this plane is measured with.
    fn may_meet(&self, ray: DVec3, normal: DVec3) -> bool {
        match self.plane {
            Plane::Ceiling => ray.z >= MIN_CEILING_SINE,
            Plane::Wall(_) => {
                let level = libm::hypot(ray.x, ray.y);
                (WALL_SINES[0]..=WALL_SINES[1]).contains(&ray.z) && ray.dot(normal) >= MIN_WALL_COSINE * level
            }
        }
    }
}

/// Sums for the correlation of two samples without mean.
#[derive(Clone, Copy, Debug, Default)]
struct Correlation {
    product: f64,
    squares: [f64; 2],
    count: usize,
}

impl Correlation {
    fn add(&mut self, one: f32, other: f32) {
        if one.is_nan() || other.is_nan() {
            return;
        }
        let (one, other) = (f64::from(one), f64::from(other));
        self.product += one * other;
        self.squares[0] += one * one;
        self.squares[1] += other * other;
        self.count += 1;
    }

    /// The correlation, -1 to 1; `None` for too few samples.
    fn value(&self) -> Option<f64> {
        let scale = libm::sqrt(self.squares[0] * self.squares[1]);
        (self.count >= MIN_SAMPLES).then(|| if scale > 0.0 { self.product / scale } else { 0.0 })
    }
}
