//! Detection of what stands on the carpet in a recorded image: robots, people, balls, hands.
//!
//! The pose of an image tells which pixels look at the carpet and where lines are painted. A pixel that is neither of the
//! carpet's colour nor white on a line shows an obstacle. Obstacles are found on a thumbnail and marked [`UNSURE`] in the
//! image, so that views take other images there.

use glam::{DMat3, DVec2, DVec3};

use super::figures::{Figures, fill_gaps};
use super::moved_blocks::block_side;
use super::raster::{Raster, SURE, UNSURE};
use super::{Camera, TagError, World, optical};
use realitysim_geometry::{Field, Isometry};
use realitysim_vision::carpet::{Learning, Sample, Surface};

/// The pose of a recorded image and the scene that it shows.
#[derive(Clone, Copy, Debug)]
pub struct Scenery<'a> {
    /// Lens that took the image.
    pub camera: &'a Camera,
    /// Pose of `camera_link` in `map`.
    pub map_from_link: Isometry,
    /// Uncertainty of that pose.
    pub tag: TagError,
    /// The field with its lines.
    pub field: &'a Field,
    /// Known geometry, with the goals that stand there.
    pub world: &'a World,
    /// The blocks that [`super::moved_blocks`] has found, if it could: they tell what stands beyond the carpet.
    pub moved: Option<&'a [bool]>,
}

/// The carpet's colour is learnt from points within this distance, metres.
const LEARN_WITHIN_M: f64 = 2.5;
/// Every n-th of these points is used.
const LEARN_EVERY: usize = 3;
/// Tolerance for the places of paint and of the carpet's edge, in addition to the tag's error and the pixel's size.
const TOLERANCE_M: f64 = 0.03;
/// Softness of edges, in pixels of the thumbnail.
const SOFT_EDGE: f64 = 1.5;
/// At least this many of the 3 x 3 pixels around a place must show an obstacle; fewer are noise.
const MIN_NEIGHBOURS: usize = 5;
/// Obstacles are widened by this many pixels of the thumbnail, because their edges are soft.
const DILATION: usize = 2;
/// If a larger share of the carpet seems hidden, its colour was not learnt correctly and nothing is marked.
const HIDDEN_SHARE_LIMIT: f64 = 0.6;
/// An obstacle that reaches the visible end of the carpet is extended above it up to this height, metres: a robot's.
const HEIGHT_M: f64 = 1.0;
/// Largest height of a figure, metres: a person's, and what its place is off.
const BODY_M: f64 = 2.1;
/// Gaps of up to this many pixels of the thumbnail belong to the body around them: its colour is that of what is behind.
const GAP_BLOCKS: usize = 6;
/// Colours differ by more than this: four times the luma, and chroma. Noise and the gradient of a wall are less.
const DIFFERENCE: (u16, u8) = (48, 10);
/// What is beside a body is looked at this many pixels of the thumbnail beyond it.
const SIDE_GAP: usize = 3;
/// A figure whose feet seem to be farther away has no place: near the horizon, a pixel is metres of floor.
const FOOT_WITHIN_M: f64 = 12.0;
/// An obstacle reaches the end of the carpet if it comes within this many rows of the thumbnail.
const END_ROWS: f64 = 4.0;
/// Dark pixels count as obstacles if the carpet's median luma is above this.
const BRIGHT_CARPET: f32 = 32.0;

/// The part of the scene that a pixel of the thumbnail looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Place {
    /// The carpet, unless an obstacle stands before it. The point may be off by `tolerance_m` metres.
    Carpet { at: DVec2, tolerance_m: f64 },
    /// Beyond the carpet: its edge, the hall, the sky.
    Beyond,
    /// Nothing of the world: outside of the lens's circle, or the robot itself.
    Nothing,
}

/// Marks the pixels of `image` that show an obstacle as [`UNSURE`], and returns the figures that they belong to.
pub fn mark_moving(image: &mut Raster, scenery: &Scenery) -> Figures {
    let thumbnail = Thumbnail::of(image, scenery);
    let moved = scenery.moved.filter(|moved| moved.len() == thumbnail.places.len());
    let solid = match (thumbnail.find_obstacles(scenery), moved) {
        (Some(solid), _) => solid,
        (None, Some(_)) => vec![false; thumbnail.places.len()],
        (None, None) => return Figures::default(),
    };
    let widened = thumbnail.widened(&solid);
    let marked = match moved {
        Some(moved) => thumbnail.with_moved(widened, moved),
        None => thumbnail.extended_upwards(widened),
    };
    let figures = Figures::of_blocks(
        &marked,
        (thumbnail.side, thumbnail.width),
        thumbnail.from.truncate(),
        |index| thumbnail.foot(index, &solid),
        |index, distance_m| slope(thumbnail.rays[index]) <= (BODY_M - thumbnail.from.z) / distance_m,
    );
    for (index, _) in figures.marked().enumerate().filter(|(_, marked)| *marked) {
        for pixel in thumbnail.pixels(index) {
            if image.pixels[pixel][3] == SURE {
                image.pixels[pixel][3] = UNSURE;
            }
        }
    }
    figures
}

/// A small copy of an image: directions, what they look at, and colours.
struct Thumbnail {
    width: usize,
    height: usize,
    /// Side of the block of image pixels that one pixel stands for.
    side: usize,
    /// Width of the image, pixels.
    full_width: usize,
    /// Position of the camera in `map`, metres.
    from: DVec3,
    /// Angle between neighbouring pixels, radians.
    step_rad: f64,
    /// Unit rays in `map`; NaN where the lens draws nothing.
    rays: Vec<DVec3>,
    places: Vec<Place>,
    /// Four times the luma, and chroma around 128.
    colours: Vec<(u16, [u8; 2])>,
}

impl Thumbnail {
    /// Downscales `image`.
    fn of(image: &Raster, scenery: &Scenery) -> Self {
        let side = block_side(image.width);
        let (width, height) = (image.width / side, image.height / side);
        let pose = optical(&scenery.map_from_link);
        let (from, turn) = (pose.translation, DMat3::from_quat(pose.rotation));
        let step_rad = side as f64 / scenery.camera.lens().focal();
        let half = scenery.field.carpet_half_extent();
        let mut thumbnail = Self {
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
            let colour = thumbnail.colour(image, index);
            let place = match ray {
                Some(ray) if colour.is_some() => thumbnail.place(ray, half, &scenery.tag),
                _ => Place::Nothing,
            };
            thumbnail.rays.push(ray.unwrap_or(DVec3::NAN));
            thumbnail.places.push(place);
            thumbnail.colours.push(colour.unwrap_or_default());
        }
        thumbnail
    }

    /// The image pixels that a pixel of the thumbnail stands for.
    fn pixels(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let (side, width) = (self.side, self.full_width);
        let first = index / self.width * side * width + index % self.width * side;
        (0..side).flat_map(move |row| first + row * width..first + row * width + side)
    }

    /// Four times the mean luma, and the mean chroma (JFIF's conversion); `None` unless all of the block is sure.
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

    /// The part of the scene that a ray looks at; `half` are the half extents of the carpet.
    fn place(&self, ray: DVec3, half: DVec2, tag: &TagError) -> Place {
        let height = self.from.z;
        let distance = -height / ray.z;
        if !(distance > 0.0 && distance.is_finite()) {
            return Place::Beyond;
        }
        let at = (self.from + ray * distance).truncate();
        // A rotation by one radian moves the point by d^2 / z.
        let per_rad = distance * distance / height;
        let tolerance_m = TOLERANCE_M + tag.position_m + per_rad * (SOFT_EDGE * self.step_rad + tag.rotation_rad);
        if at.abs().cmple(half - DVec2::splat(tolerance_m)).all() {
            Place::Carpet { at, tolerance_m }
        } else {
            Place::Beyond
        }
    }

    /// The pixels that show an obstacle before the carpet, without specks. `None` if there are none or the carpet's colour is unclear.
    fn find_obstacles(&self, scenery: &Scenery) -> Option<Vec<bool>> {
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
        let dark_is_obstacle = *lumas.select_nth_unstable_by(middle, f32::total_cmp).1 > BRIGHT_CARPET;
        let half_line = scenery.field.line_width() / 2.0;
        let goals = scenery.world.goals_from(self.from, SOFT_EDGE * self.step_rad + scenery.tag.rotation_rad);
        let is_obstacle = |index: usize| {
            let Place::Carpet { at, tolerance_m } = self.places[index] else { return false };
            let (four, chroma) = self.colours[index];
            let obstacle = match carpet.classify(four, chroma) {
                Surface::Carpet => false,
                Surface::Other => true,
                Surface::Dark => dark_is_obstacle,
                Surface::White => scenery.field.distance_to_centre_line(at) > half_line + tolerance_m,
            };
            obstacle && !goals.intersects(self.rays[index])
        };
        let found: Vec<bool> = (0..self.places.len()).map(is_obstacle).collect();
        let solid: Vec<bool> = (0..found.len()).map(|index| found[index] && self.is_solid(&found, index)).collect();
        let hidden = solid.iter().filter(|obstacle| **obstacle).count();
        let carpet = self.places.iter().filter(|place| matches!(place, Place::Carpet { .. })).count();
        let is_plausible = hidden > 0 && (hidden as f64) < HIDDEN_SHARE_LIMIT * carpet as f64;
        is_plausible.then_some(solid)
    }

    /// Whether enough of the pixels around this one show an obstacle.
    fn is_solid(&self, found: &[bool], index: usize) -> bool {
        let (column, row) = (index % self.width, index / self.width);
        let near = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
        let around = near(row, self.height).flat_map(|r| near(column, self.width).map(move |c| r * self.width + c));
        around.filter(|at| found[*at]).count() >= MIN_NEIGHBOURS
    }

    /// The obstacles, dilated.
    fn widened(&self, obstacles: &[bool]) -> Vec<bool> {
        let near = |at: usize, end: usize| at.saturating_sub(DILATION)..(at + DILATION + 1).min(end);
        let (width, height) = (self.width, self.height);
        let rows: Vec<bool> = (0..obstacles.len())
            .map(|i| obstacles[i / width * width..][near(i % width, width)].contains(&true))
            .collect();
        (0..obstacles.len()).map(|i| near(i / width, height).any(|v| rows[v * width + i % width])).collect()
    }

    /// Adds what was found to stand before the world beyond the carpet: the upper part of bodies, and those who stand around.
    fn with_moved(&self, mut obstacles: Vec<bool>, moved: &[bool]) -> Vec<bool> {
        for (index, obstacle) in obstacles.iter_mut().enumerate() {
            *obstacle |= moved[index] && self.places[index] == Place::Beyond;
        }
        fill_gaps(&mut obstacles, self.width, GAP_BLOCKS);
        self.grow_downwards(&mut obstacles);
        obstacles
    }

    /// Adds the legs of bodies beyond the carpet. Near the floor, legs are where the floor is, so that other images show them there too.
    ///
    /// A pixel belongs to a body if one above it does and if it differs from what is seen to both sides of the body.
    fn grow_downwards(&self, obstacles: &mut [bool]) {
        for row in 1..self.height {
            let (start, above) = (row * self.width, (row - 1) * self.width);
            let stands = |column: usize| {
                let near = column.saturating_sub(1)..(column + 2).min(self.width);
                self.places[start + column] == Place::Beyond
                    && !obstacles[start + column]
                    && obstacles[above..][near].contains(&true)
            };
            let candidates: Vec<bool> = (0..self.width).map(stands).collect();
            let mut column = 0;
            while let Some(first) = (column..self.width).find(|column| candidates[*column]) {
                let end = (first..self.width).find(|column| !candidates[*column]).unwrap_or(self.width);
                let sides = [first.checked_sub(SIDE_GAP), Some(end - 1 + SIDE_GAP).filter(|side| *side < self.width)];
                let run = obstacles[start + first..start + end].iter_mut();
                for (index, obstacle) in (start + first..).zip(run) {
                    *obstacle = sides.iter().flatten().all(|side| self.differ(index, start + side));
                }
                column = end;
            }
        }
    }

    /// Whether two pixels are of different colours; nothing differs from what shows nothing.
    fn differ(&self, a: usize, b: usize) -> bool {
        let ((luma_a, chroma_a), (luma_b, chroma_b)) = (self.colours[a], self.colours[b]);
        let chroma = chroma_a.iter().zip(chroma_b).map(|(a, b)| a.abs_diff(b)).max();
        self.places[b] != Place::Nothing && (luma_a.abs_diff(luma_b) > DIFFERENCE.0 || chroma > Some(DIFFERENCE.1))
    }

    /// Where a pixel's obstacle stands if it touches the floor there: an obstacle on the carpet, or anything beyond it.
    fn foot(&self, index: usize, solid: &[bool]) -> Option<DVec2> {
        match self.places[index] {
            Place::Carpet { at, .. } => solid[index].then_some(at),
            Place::Beyond => {
                let ray = self.rays[index];
                let distance = -self.from.z / ray.z;
                (distance > 0.0 && distance < FOOT_WITHIN_M).then(|| (self.from + ray * distance).truncate())
            }
            Place::Nothing => None,
        }
    }

    /// Adds what is above an obstacle that reaches the visible end of the carpet: heads and shoulders stand before what is far.
    fn extended_upwards(&self, mut obstacles: Vec<bool>) -> Vec<bool> {
        let mut profile = vec![HeadingProfile::default(); HEADINGS];
        for (index, place) in self.places.iter().enumerate() {
            let Place::Carpet { at, .. } = place else { continue };
            let profile = &mut profile[heading(self.rays[index])];
            let slope = slope(self.rays[index]);
            profile.max_carpet_slope = profile.max_carpet_slope.max(slope);
            if obstacles[index] {
                profile.max_obstacle_slope = profile.max_obstacle_slope.max(slope);
                profile.nearest_foot_m = profile.nearest_foot_m.min(at.distance(self.from.truncate()));
            }
        }
        for (index, place) in self.places.iter().enumerate().filter(|(_, place)| **place == Place::Beyond) {
            let profile = &profile[heading(self.rays[index])];
            let reaches = profile.max_obstacle_slope >= profile.max_carpet_slope - END_ROWS * self.step_rad;
            let top = (HEIGHT_M - self.from.z) / profile.nearest_foot_m;
            obstacles[index] |= *place == Place::Beyond && reaches && slope(self.rays[index]) <= top;
        }
        obstacles
    }
}

/// Extents of carpet and obstacles in one heading from the camera. A slope is height over distance, negative downwards.
#[derive(Clone, Copy, Debug)]
struct HeadingProfile {
    /// Largest slope at which the carpet is seen.
    max_carpet_slope: f64,
    /// Largest slope at which an obstacle is seen before the carpet.
    max_obstacle_slope: f64,
    /// Distance to the nearest foot of an obstacle, metres.
    nearest_foot_m: f64,
}

impl Default for HeadingProfile {
    fn default() -> Self {
        Self {
            max_carpet_slope: f64::NEG_INFINITY,
            max_obstacle_slope: f64::NEG_INFINITY,
            nearest_foot_m: f64::INFINITY,
        }
    }
}

/// Number of headings that are told apart.
const HEADINGS: usize = 480;

/// The index of a ray's heading, by the angle on a square instead of a circle, which needs no arc tangent.
fn heading(ray: DVec3) -> usize {
    let length = ray.x.abs() + ray.y.abs();
    if length == 0.0 {
        return 0;
    }
    let along = ray.x / length;
    let around = if ray.y >= 0.0 { 1.0 - along } else { 3.0 + along };
    ((around / 4.0 * HEADINGS as f64) as usize).min(HEADINGS - 1)
}

/// Height over distance along a ray.
fn slope(ray: DVec3) -> f64 {
    ray.z / ray.truncate().length().max(1e-9)
}
