//! A check, by what images show, whether goals stand where the field file has them.

use glam::{DVec2, DVec3};

use super::camera::Camera;
use super::optical;
use super::raster::{NOTHING, Raster};
use super::world::World;
use realitysim_geometry::Isometry;

/// Counts of points along posts and crossbars that images show large enough.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GoalBars {
    /// Points that were looked at.
    pub places: u64,
    /// Those brighter or darker than what is seen to both sides, as a bar is and wall, carpet and hall are not.
    pub detected: u64,
}

/// Bars farther away than this, in metres, are not looked at ...
const RANGE_LIMIT_M: f64 = 6.0;
/// ... nor those of a smaller radius in the image.
const MIN_RADIUS_PX: f64 = 1.2;
/// Distance from the bar's edge at which its surroundings are sampled.
const BESIDE_PX: f64 = 2.5;
/// A bar must differ from both sides by this share of their mean brightness ...
const MIN_CONTRAST: f64 = 0.08;
/// ... which is taken to be at least this many gray levels.
const MIN_BRIGHTNESS: f64 = 20.0;

impl GoalBars {
    /// Counts the points of the bars of `world` in an image that was taken from `map_from_link`.
    pub fn seen(camera: &Camera, map_from_link: &Isometry, image: &Raster, world: &World) -> Self {
        let optical_from_map = optical(map_from_link).inverse();
        let mut seen = Self::default();
        for bar in world.bars() {
            let places: Vec<DVec3> = bar.places().map(|place| optical_from_map.transform_point(place)).collect();
            for (place, next) in places.iter().zip(&places[1..]) {
                if let Some(differs) = stands_out(camera, image, place, next, bar.radius()) {
                    seen.places += 1;
                    seen.detected += u64::from(differs);
                }
            }
        }
        seen
    }
}

/// Whether a bar differs from its surroundings at `place`, in `camera_optical_frame`; `None` if it is not visible or too small.
fn stands_out(camera: &Camera, image: &Raster, place: &DVec3, next: &DVec3, radius_m: f64) -> Option<bool> {
    let distance = place.length();
    let radius_px = camera.lens().focal() * radius_m / distance;
    if distance > RANGE_LIMIT_M || radius_px < MIN_RADIUS_PX {
        return None;
    }
    let pixel = camera.projector().project_inside(*place)?;
    let along = (camera.projector().project(*next)? - pixel).try_normalize()?;
    let brightness = |off_px: f64| brightness(image, pixel + along.perp() * off_px);
    let aside = radius_px + BESIDE_PX;
    let [bar, one, other] = [brightness(0.0)?, brightness(-aside)?, brightness(aside)?];
    let least = MIN_CONTRAST * ((one + other) / 2.0).max(MIN_BRIGHTNESS);
    Some((bar - one).min(bar - other) > least || (one - bar).min(other - bar) > least)
}

/// Mean of red, green and blue at a pixel; `None` where the image shows nothing.
fn brightness(image: &Raster, at: DVec2) -> Option<f64> {
    let at = at.round();
    if at.x < 0.0 || at.y < 0.0 || at.x >= image.width as f64 || at.y >= image.height as f64 {
        return None;
    }
    let [r, g, b, sure] = image.pixels[at.y as usize * image.width + at.x as usize];
    (sure != NOTHING).then(|| f64::from(u32::from(r) + u32::from(g) + u32::from(b)) / 3.0)
}
