//! Points with colours to begin a training from, and the brightness of images relative to them.

use glam::{DVec2, DVec3};

use super::super::image_database::ImageDatabase;
use super::super::record::Record;
use super::TrainingProgress;
use realitysim_geometry::{Field, Isometry};
use realitysim_views::{Camera, Hall, Raster, SURE};

/// A point of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeedPoint {
    /// Position in `map`, metres.
    pub at: DVec3,
    /// Red, green and blue.
    pub colour: [u8; 3],
    /// Whether it lies on the ground, which has the same brightness from everywhere.
    pub is_ground: bool,
}

/// Number of images that colours are taken from, spread evenly over the chosen ones.
pub(super) const SAMPLED_IMAGES: usize = 64;
/// Most points of the ground.
const GROUND_POINTS: f64 = 40_000.0;
/// Smallest distance between points of the ground, metres.
const MIN_GROUND_STEP_M: f64 = 0.03;
/// Distance between points of walls and ceiling, metres.
const HALL_STEP_M: f64 = 0.2;
/// Distance between points of a goal's bars, metres.
const BAR_STEP_M: f64 = 0.05;
/// Where a plane of the hall ends whose neighbour is unknown: this far beyond the ground, metres.
const UNKNOWN_REACH_M: f64 = 5.0;
/// Height of walls without a ceiling, metres.
const UNKNOWN_CEILING_M: f64 = 4.0;
/// Pixel values outside of this range say nothing about brightness: too dark, or saturated.
const TELLING: core::ops::RangeInclusive<u8> = 24..=240;
/// Fewest points that determine the brightness of an image.
const MIN_POINTS: usize = 200;

/// Points of ground, goals and hall that images show, each with the colour that the nearest of the sampled images has there.
pub(super) fn seed_points(
    database: &ImageDatabase,
    chosen: &[(usize, Record)],
    progress: TrainingProgress<'_>,
) -> Vec<SeedPoint> {
    let (field, world) = (database.field(), database.world());
    let bare = ground(world.ground_half()).map(|at| (at, true));
    let bars = bars(field).filter(|_| world.has_goals());
    let solid = bars.chain(hall(world.hall(), world.ground_half())).map(|at| (at, false));
    let places: Vec<(DVec3, bool)> = bare.chain(solid).collect();
    let mut nearest: Vec<(f64, [u8; 3])> = vec![(f64::INFINITY, [0; 3]); places.len()];
    let step = chosen.len().div_ceil(SAMPLED_IMAGES).max(1);
    let sampled: Vec<&(usize, Record)> = chosen.iter().step_by(step).collect();
    for (done, (number, record)) in sampled.iter().enumerate() {
        progress(done as u64, sampled.len() as u64);
        let (Ok(image), Some(camera)) = (database.image(*number), database.camera(record)) else { continue };
        let map_from_optical = record.pose() * Isometry::link_from_optical();
        for ((at, _), known) in places.iter().zip(&mut nearest) {
            let distance = at.distance_squared(map_from_optical.translation);
            if distance < known.0
                && let Some(colour) = colour_at(*at, camera, &map_from_optical, image.full())
            {
                *known = (distance, colour);
            }
        }
    }
    let seen = places.into_iter().zip(nearest).filter(|(_, (distance, _))| distance.is_finite());
    seen.map(|((at, is_ground), (_, colour))| SeedPoint { at, colour, is_ground }).collect()
}

/// The pixel values of an image over those of the ground's points: the median for each channel.
pub(super) fn gain(points: &[SeedPoint], camera: &Camera, map_from_optical: &Isometry, image: &Raster) -> [f64; 3] {
    let seen: Vec<([u8; 3], [u8; 3])> = points
        .iter()
        .filter(|point| point.is_ground)
        .filter_map(|point| Some((colour_at(point.at, camera, map_from_optical, image)?, point.colour)))
        .collect();
    core::array::from_fn(|channel| {
        let pairs = seen.iter().map(|(here, there)| (here[channel], there[channel]));
        let telling = pairs.filter(|(here, there)| TELLING.contains(here) && TELLING.contains(there));
        let mut ratios: Vec<f64> = telling.map(|(here, there)| f64::from(here) / f64::from(there)).collect();
        ratios.sort_by(f64::total_cmp);
        if ratios.len() < MIN_POINTS { 1.0 } else { ratios[ratios.len() / 2] }
    })
}

/// The colour of the pixel that shows a point, unless something moving, the robot itself or nothing is there.
fn colour_at(at: DVec3, camera: &Camera, map_from_optical: &Isometry, image: &Raster) -> Option<[u8; 3]> {
    let pixel = camera.lens().project(map_from_optical.inverse().transform_point(at))?;
    let (u, v) = (libm::round(pixel.x), libm::round(pixel.y));
    if u < 0.0 || v < 0.0 || u >= image.width as f64 || v >= image.height as f64 {
        return None;
    }
    let [red, green, blue, known] = image.pixels[v as usize * image.width + u as usize];
    (known == SURE).then_some([red, green, blue])
}

/// A grid of the ground.
fn ground(half: DVec2) -> impl Iterator<Item = DVec3> {
    let step = libm::sqrt(4.0 * half.x * half.y / GROUND_POINTS).max(MIN_GROUND_STEP_M);
    grid([-half.x, half.x], [-half.y, half.y], step).map(|at| at.extend(0.0))
}

/// Points along the axes of the goals' bars.
fn bars(field: &Field) -> impl Iterator<Item = DVec3> {
    field.goal_bars().into_iter().flat_map(|[from, to]| {
        let pieces = libm::ceil(from.distance(to) / BAR_STEP_M).max(1.0);
        (0..=pieces as usize).map(move |piece| from.lerp(to, piece as f64 / pieces))
    })
}

/// Grids of the walls and the ceiling that are known, and of the floor between the ground and known walls.
fn hall(hall: &Hall, ground_half: DVec2) -> impl Iterator<Item = DVec3> {
    let hall = *hall;
    let reach = hall.walls_m.map(|wall| wall.unwrap_or(ground_half.length() + UNKNOWN_REACH_M));
    let top = hall.ceiling_m.unwrap_or(UNKNOWN_CEILING_M);
    let walls = (0..4).filter(move |wall| hall.walls_m[*wall].is_some()).flat_map(move |wall| {
        let (normal, along) = (hall.normal(wall), hall.normal((wall + 1) % 4));
        let extent = [-reach[(wall + 3) % 4], reach[(wall + 1) % 4]];
        grid(extent, [0.0, top], HALL_STEP_M).map(move |at| (normal * reach[wall] + along * at.x).extend(at.y))
    });
    let ceiling = hall.ceiling_m.into_iter().flat_map(move |height| {
        let plane = grid([-reach[2], reach[0]], [-reach[3], reach[1]], HALL_STEP_M);
        plane.map(move |at| (hall.normal(0) * at.x + hall.normal(1) * at.y).extend(height))
    });
    let is_closed = hall.walls_m.iter().any(Option::is_some);
    let plane = grid([-reach[2], reach[0]], [-reach[3], reach[1]], HALL_STEP_M);
    let floor = plane.map(move |at| hall.normal(0) * at.x + hall.normal(1) * at.y);
    let floor = floor.filter(move |at| is_closed && at.abs().cmpgt(ground_half).any()).map(|at| at.extend(0.0));
    walls.chain(ceiling).chain(floor)
}

/// Points of a rectangle.
fn grid([left, right]: [f64; 2], [low, high]: [f64; 2], step: f64) -> impl Iterator<Item = DVec2> {
    let count = |from: f64, to: f64| libm::ceil((to - from) / step).max(0.0) as usize;
    let columns = count(left, right);
    (0..=count(low, high)).flat_map(move |row| {
        (0..=columns).map(move |column| DVec2::new(left + step * column as f64, low + step * row as f64))
    })
}
