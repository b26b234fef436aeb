//! Whether goals stand where the field file has them, by what images show there.

use glam::{DVec2, DVec3};

use super::camera::Camera;
use super::optical;
use super::raster::{NOTHING, Raster};
use super::world::World;
use realitysim_geometry::Isometry;

/// Places along posts and crossbars that images show large enough.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GoalBars {
    pub places: u64,
    /// Of these, brighter or darker than what is seen to either side: a bar is, and wall, carpet and hall are not.
    pub standing: u64,
}

/// Nearer and larger than that a bar is looked for.
const FARTHEST_M: f64 = 6.0;
const LEAST_RADIUS_PX: f64 = 1.2;
/// How far beside the bar's edge its surroundings are looked at.
const BESIDE_PX: f64 = 2.5;
/// Of the brightness there, by so much a bar differs on both sides.
const DIFFERS: f64 = 0.08;
const LEAST_LIGHT: f64 = 20.0;

impl GoalBars {
    /// Where an image from `map_from_link` shows those of `world`.
    pub fn seen(camera: &Camera, map_from_link: &Isometry, image: &Raster, world: &World) -> Self {
        let optical_from_map = optical(map_from_link).inverse();
        let mut seen = Self::default();
        for bar in world.bars() {
            let places: Vec<DVec3> = bar.places().map(|place| optical_from_map.transform_point(place)).collect();
            for (place, next) in places.iter().zip(&places[1..]) {
                if let Some(differs) = differs(camera, image, place, next, bar.radius()) {
                    seen.places += 1;
                    seen.standing += u64::from(differs);
                }
            }
        }
        seen
    }
}

/// `None` where it is not seen, or too small.
fn differs(camera: &Camera, image: &Raster, place: &DVec3, next: &DVec3, radius_m: f64) -> Option<bool> {
    let distance = place.length();
    let radius_px = camera.lens().focal() * radius_m / distance;
    if distance > FARTHEST_M || radius_px < LEAST_RADIUS_PX {
        return None;
    }
    let pixel = camera.projector().project_inside(*place)?;
    let along = (camera.projector().project(*next)? - pixel).try_normalize()?;
    let light = |off_px: f64| light(image, pixel + along.perp() * off_px);
    let aside = radius_px + BESIDE_PX;
    let [bar, one, other] = [light(0.0)?, light(-aside)?, light(aside)?];
    let least = DIFFERS * ((one + other) / 2.0).max(LEAST_LIGHT);
    Some((bar - one).min(bar - other) > least || (one - bar).min(other - bar) > least)
}

fn light(image: &Raster, at: DVec2) -> Option<f64> {
    let at = at.round();
    if at.x < 0.0 || at.y < 0.0 || at.x >= image.width as f64 || at.y >= image.height as f64 {
        return None;
    }
    let [r, g, b, sure] = image.pixels[at.y as usize * image.width + at.x as usize];
    (sure != NOTHING).then(|| f64::from(u32::from(r) + u32::from(g) + u32::from(b)) / 3.0)
}
