//! Response of the line detector of the project to a picture whose camera pose is known.

use glam::DVec2;
use serde::Serialize;

use realitysim_geometry::{Field, Isometry, Lens, Pose2};
use realitysim_localization::SimdPath;
use realitysim_localization::kernel::{Points, sum_levels};
use realitysim_vision::{GroundTable, Picture, TableQuantity, Vision, VisionSettings};

/// The line contrast of [`Vision`], sampled where lines should be and where none should be.
#[derive(Clone, Debug)]
pub struct Detector {
    vision: Vision,
    on_lines: Vec<DVec2>,
    off_lines: Vec<DVec2>,
}

/// Response of the line detector, over the places within reach that the camera sees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Detection {
    /// Mean response on lines, 0 to 1.
    pub response: f64,
    /// Share of the places on lines that respond less than three tenths of the largest response.
    pub missed: f64,
    /// Share of the places away from lines that respond more than that.
    pub false_lines: f64,
    /// Number of places on lines.
    pub places: usize,
}

/// Smallest response of a detected line, as a share of the largest response.
const MIN_RESPONSE: f64 = 0.3;
/// Largest distance to the foot point of the camera, metres: farther lines are a pixel wide.
const WITHIN_M: f64 = 3.0;
/// Number of places on the lines of the field.
const POINTS: usize = 700;
/// Spacing of the grid of places without lines, metres.
const SPACING_M: f64 = 0.1;
/// Smallest distance from these places to the centre of a line, metres.
const CLEAR_M: f64 = 0.15;
/// Smallest value of the ground table at a visible place: outside of the picture or the carpet it is less.
const MIN_VISIBILITY: f64 = 0.5;

impl Detector {
    /// Makes a detector for pictures of a lens on a field.
    pub fn new(lens: &Lens, field: &Field) -> Self {
        let settings = VisionSettings {
            reading: TableQuantity::Contrast,
            line_width_m: field.line_width(),
            tilt_sigma_rad: 0.005,
            reduction: 0,
        };
        let half = field.carpet_half_extent();
        let count = 2.0 * half / SPACING_M;
        let grid = (0..count.x as usize).flat_map(|x| (0..count.y as usize).map(move |y| (x, y)));
        let place = |(x, y): (usize, usize)| (DVec2::new(x as f64, y as f64) + DVec2::splat(0.5)) * SPACING_M - half;
        let clear = |place: &DVec2| field.distance_to_centre_line(*place) > CLEAR_M;
        Self {
            vision: Vision::new(lens, settings),
            on_lines: field.points(POINTS).iter().map(|point| point.position).collect(),
            off_lines: grid.map(place).filter(clear).collect(),
        }
    }

    /// Detects lines in a picture from a pose of `camera_link` in `map`.
    pub fn look(&self, picture: &Picture, map_from_link: &Isometry) -> Detection {
        let foot = Pose2::from_isometry(map_from_link);
        let footprint_from_link = foot.to_isometry().inverse() * *map_from_link;
        let seen = self.vision.look(picture, &(footprint_from_link * Isometry::link_from_optical()), None);
        let on = responses(seen.lines(), &self.on_lines, &foot);
        let off = responses(seen.lines(), &self.off_lines, &foot);
        let share = |of: &[f64], which: fn(f64) -> bool| {
            of.iter().filter(|response| which(**response)).count() as f64 / of.len().max(1) as f64
        };
        Detection {
            response: on.iter().sum::<f64>() / on.len().max(1) as f64,
            missed: share(&on, |response| response < MIN_RESPONSE),
            false_lines: share(&off, |response| response > MIN_RESPONSE),
            places: on.len(),
        }
    }
}

/// Returns the responses at the places that the camera sees, 0 to 1. `places` are in `map`, metres.
fn responses(table: &GroundTable, places: &[DVec2], foot: &Pose2) -> Vec<f64> {
    let robot_from_map = foot.inverse().to_affine();
    let near = places.iter().filter(|place| place.distance(DVec2::new(foot.x, foot.y)) < WITHIN_M);
    let seen = near.filter(|place| table.seen(robot_from_map.transform_point2(**place)) > MIN_VISIBILITY);
    let response = |place: &DVec2| {
        let sum = sum_levels(SimdPath::Auto, table, &Points::new([*place]), foot);
        ((sum + f64::from(table.readings().zero)) / 255.0).clamp(0.0, 1.0)
    };
    seen.map(response).collect()
}
