//! What stands on the carpet in a recorded image and was not painted there: robots, people, balls, hands.
//!
//! Nobody says where such things are, but the image does: its pose tells which pixels look at the carpet and where lines are
//! painted, and what is neither carpet-coloured nor white on a line stands in the way. Found on a small copy; what has been found is [`UNSURE`] from then on, and views take other images there.

use glam::{DMat3, DVec2, DVec3};

use super::raster::{Raster, SURE, UNSURE};
use super::{Camera, TagError, World, optical};
use realitysim_geometry::{Field, Isometry};
use realitysim_vision::carpet::{Learning, Sample, Surface};

/// Where an image was taken, and of what.
#[derive(Clone, Copy, Debug)]
pub struct Scenery<'a> {
    pub camera: &'a Camera,
    /// `camera_link` in `map`.
    pub map_from_link: Isometry,
    pub tag: TagError,
    pub field: &'a Field,
    pub world: &'a World,
}

/// Columns of the small copy: a degree each of a wide fisheye.
const COLUMNS: usize = 160;
/// Pixels of the image that one of the small copy stands for, each way, at least.
const LEAST_SIDE: usize = 2;
/// The carpet's colour is learnt within this range.
const LEARN_WITHIN_M: f64 = 2.5;
/// Every so many of its places are enough for that.
const LEARN_EVERY: usize = 3;
/// How far paint and carpet's end may be from where they should be, beside the tag's error and the pixel's size.
const PLAY_M: f64 = 0.03;
/// Of the size of a pixel of the small copy: how soft an edge is.
const SOFT_EDGE: f64 = 1.5;
/// Of the nine around it, so many make a place one of a thing's: specks are noise.
const ENOUGH_AROUND: usize = 5;
/// Pixels of the small copy by which a thing is taken to be wider than it was found: soft edges.
const WIDER: usize = 2;
/// With more of the carpet hidden than this its colour was not understood.
const MOST_HIDDEN: f64 = 0.6;
/// A thing that reaches the carpet's end in view goes on above it, up to this height: a robot's.
const HEIGHT_M: f64 = 1.0;
/// Rows of the small copy within which it reaches the end.
const NEAR_THE_END: f64 = 4.0;
/// Dark places are things on a carpet that is brighter than this.
const BRIGHT_CARPET: f32 = 32.0;

/// What a pixel of the small copy looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// The carpet, unless a thing stands before it; metres by which it may be misplaced.
    Carpet { at: DVec2, play_m: f64 },
    /// Carpet's end, hall, sky.
    Beyond,
    /// Lens's surround, the robot itself.
    Nothing,
}

/// Marks what stands in the way. Returns whether there is anything.
pub fn mark_moving(image: &mut Raster, scenery: &Scenery) -> bool {
    let small = Thumbnail::of(image, scenery);
    let Some(things) = small.things(scenery) else { return false };
    let things = small.with_what_reaches_higher(things);
    let mut any = false;
    for (index, _) in things.iter().enumerate().filter(|(_, thing)| **thing) {
        for pixel in small.pixels(index) {
            if image.pixels[pixel][3] == SURE {
                image.pixels[pixel][3] = UNSURE;
                any = true;
            }
        }
    }
    any
}

/// A small copy of the image: directions, places and colours.
struct Thumbnail {
    width: usize,
    height: usize,
    /// Of the image's pixels that one stands for.
    side: usize,
    full_width: usize,
    /// Of the camera.
    from: DVec3,
    /// Between neighbours, radians.
    step_rad: f64,
    rays: Vec<DVec3>,
    places: Vec<Place>,
    /// Sum of four luma, and chroma around 128.
    colours: Vec<(u16, [u8; 2])>,
}

impl Thumbnail {
    fn of(image: &Raster, scenery: &Scenery) -> Self {
        let side = (image.width / COLUMNS).max(LEAST_SIDE);
        let (width, height) = (image.width / side, image.height / side);
        let pose = optical(&scenery.map_from_link);
        let (from, turn) = (pose.translation, DMat3::from_quat(pose.rotation));
        let step_rad = side as f64 / scenery.camera.lens().focal();
        let half = scenery.field.carpet_half_extent();
        let mut small = Self {
            width,
            height,
            side,
            full_width: image.width,
            from,
            step_rad,
            rays: Vec::with_capacity(width * height),
            places: Vec::with_capacity(width * height),
            colours: Vec::with_capacity(width * height),
        };
        for index in 0..width * height {
            let (left, top) = (index % width * side, index / width * side);
            let ray = scenery.camera.ray(left + side / 2, top + side / 2).map(|ray| turn * ray);
            let colour = small.colour(image, index);
            let place = match ray {
                Some(ray) if colour.is_some() => small.place(ray, half, &scenery.tag),
                _ => Place::Nothing,
            };
            small.rays.push(ray.unwrap_or(DVec3::NAN));
            small.places.push(place);
            small.colours.push(colour.unwrap_or_default());
        }
        small
    }

    /// Those of the image.
    fn pixels(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let (side, width) = (self.side, self.full_width);
        let first = index / self.width * side * width + index % self.width * side;
        (0..side).flat_map(move |row| first + row * width..first + row * width + side)
    }

    /// Four times the mean luma, and mean chroma (JFIF's conversion); `None` if not all of it is shown.
    fn colour(&self, image: &Raster, index: usize) -> Option<(u16, [u8; 2])> {
        let (mut sum, mut shown) = ([0u32; 3], true);
        for [r, g, b, sure] in self.pixels(index).map(|pixel| image.pixels[pixel]) {
            sum = [sum[0] + u32::from(r), sum[1] + u32::from(g), sum[2] + u32::from(b)];
            shown &= sure == SURE;
        }
        let count = (self.side * self.side) as u32;
        // Four times the means: 10 bits.
        let [r, g, b] = sum.map(|sum| (4 * sum / count) as i32);
        let luma = (19595 * r + 38470 * g + 7471 * b + (1 << 15)) >> 16;
        let chroma = |sum: i32| (128 + (sum >> 18)).clamp(0, 255) as u8;
        let chroma = [chroma(-11059 * r - 21709 * g + 32768 * b), chroma(32768 * r - 27439 * g - 5329 * b)];
        shown.then_some((luma as u16, chroma))
    }

    fn place(&self, ray: DVec3, half: DVec2, tag: &TagError) -> Place {
        let height = self.from.z;
        let distance = -height / ray.z;
        if !(distance > 0.0 && distance.is_finite()) {
            return Place::Beyond;
        }
        let at = (self.from + ray * distance).truncate();
        // A turn by one radian moves the place by d^2 / z.
        let per_rad = distance * distance / height;
        let play_m = PLAY_M + tag.position_m + per_rad * (SOFT_EDGE * self.step_rad + tag.rotation_rad);
        if at.abs().cmple(half - DVec2::splat(play_m)).all() { Place::Carpet { at, play_m } } else { Place::Beyond }
    }

    /// What stands before the carpet, specks left out; `None` if there is nothing, or nobody can tell.
    fn things(&self, scenery: &Scenery) -> Option<Vec<bool>> {
        let near = self.from.truncate();
        let samples = || {
            let on_carpet = self.places.iter().zip(&self.colours).filter(|(place, _)| {
                matches!(place, Place::Carpet { at, .. } if at.distance_squared(near) < LEARN_WITHIN_M * LEARN_WITHIN_M)
            });
            on_carpet.step_by(LEARN_EVERY).map(|(_, (four, chroma))| {
                Sample::new(f32::from(*four) / 4.0, chroma.map(|value| f32::from(value) - 128.0))
            })
        };
        let carpet = Learning::default().learn(samples())?;
        let mut lumas: Vec<f32> = samples().map(|sample| sample.luma).collect();
        let middle = lumas.len() / 2;
        let dark_is_a_thing = *lumas.select_nth_unstable_by(middle, f32::total_cmp).1 > BRIGHT_CARPET;
        let half_line = scenery.field.line_width() / 2.0;
        let goals = scenery.world.goals_from(self.from, SOFT_EDGE * self.step_rad + scenery.tag.rotation_rad);
        let is_thing = |index: usize| {
            let Place::Carpet { at, play_m } = self.places[index] else { return false };
            let (four, chroma) = self.colours[index];
            let thing = match carpet.classify(four, chroma) {
                Surface::Carpet => false,
                Surface::Other => true,
                Surface::Dark => dark_is_a_thing,
                Surface::White => scenery.field.distance_to_centre_line(at) > half_line + play_m,
            };
            thing && !goals.are_met_by(self.rays[index])
        };
        let found: Vec<bool> = (0..self.places.len()).map(is_thing).collect();
        let solid: Vec<bool> = (0..found.len()).map(|index| found[index] && self.is_solid(&found, index)).collect();
        let hidden = solid.iter().filter(|thing| **thing).count();
        let carpet = self.places.iter().filter(|place| matches!(place, Place::Carpet { .. })).count();
        let told = hidden > 0 && (hidden as f64) < MOST_HIDDEN * carpet as f64;
        told.then(|| self.widened(&solid))
    }

    fn is_solid(&self, found: &[bool], index: usize) -> bool {
        let (column, row) = (index % self.width, index / self.width);
        let near = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let around = near(row, self.height).flat_map(|r| near(column, self.width).map(move |c| r * self.width + c));
        around.filter(|at| found[*at]).count() >= ENOUGH_AROUND
    }

    fn widened(&self, things: &[bool]) -> Vec<bool> {
        let near = |at: usize, end: usize| at.saturating_sub(WIDER)..(at + WIDER + 1).min(end);
        let (width, height) = (self.width, self.height);
        let rows: Vec<bool> =
            (0..things.len()).map(|i| things[i / width * width..][near(i % width, width)].contains(&true)).collect();
        (0..things.len()).map(|i| near(i / width, height).any(|v| rows[v * width + i % width])).collect()
    }

    /// Heads and shoulders stand before what is far: above a thing that reaches the carpet's end in view.
    fn with_what_reaches_higher(&self, mut things: Vec<bool>) -> Vec<bool> {
        let mut towards = vec![Towards::default(); HEADINGS];
        for (index, place) in self.places.iter().enumerate() {
            let Place::Carpet { at, .. } = place else { continue };
            let towards = &mut towards[heading(self.rays[index])];
            let slope = slope(self.rays[index]);
            towards.carpet_until = towards.carpet_until.max(slope);
            if things[index] {
                towards.thing_until = towards.thing_until.max(slope);
                towards.foot_m = towards.foot_m.min(at.distance(self.from.truncate()));
            }
        }
        for (index, place) in self.places.iter().enumerate().filter(|(_, place)| **place == Place::Beyond) {
            let towards = &towards[heading(self.rays[index])];
            let reaches = towards.thing_until >= towards.carpet_until - NEAR_THE_END * self.step_rad;
            let top = (HEIGHT_M - self.from.z) / towards.foot_m;
            things[index] |= *place == Place::Beyond && reaches && slope(self.rays[index]) <= top;
        }
        things
    }
}

/// What is known of one heading from the camera: slopes are height over distance, downwards below 0.
#[derive(Clone, Copy, Debug)]
struct Towards {
    carpet_until: f64,
    thing_until: f64,
    foot_m: f64,
}

impl Default for Towards {
    fn default() -> Self {
        Self { carpet_until: f64::NEG_INFINITY, thing_until: f64::NEG_INFINITY, foot_m: f64::INFINITY }
    }
}

const HEADINGS: usize = 480;

/// Which of [`HEADINGS`]: by the angle on a square instead of a circle, which needs no arc tangent.
fn heading(ray: DVec3) -> usize {
    let length = ray.x.abs() + ray.y.abs();
    if length == 0.0 {
        return 0;
    }
    let along = ray.x / length;
    let around = if ray.y >= 0.0 { 1.0 - along } else { 3.0 + along };
    ((around / 4.0 * HEADINGS as f64) as usize).min(HEADINGS - 1)
}

fn slope(ray: DVec3) -> f64 {
    ray.z / ray.truncate().length().max(1e-9)
}
