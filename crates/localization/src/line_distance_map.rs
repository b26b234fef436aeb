//! Of the lines that a frame shows, how much is painted where the pose puts them?
//!
//! This is the reverse of the observation model, which asks whether the field's lines are seen. On the wrong field, or at a pose that
//! only looks like the right one, many are, but the frame also shows lines that the field does not have.

use glam::{DVec2, DVec3};

use realitysim_geometry::{Field, Isometry, Lens};
use realitysim_vision::{GroundTable, Observations, Ridge, WorkingScale};

/// A map of the carpet that holds the distance from each cell to the nearest painted line.
#[derive(Clone, Debug)]
pub struct LineDistanceMap {
    /// Distances to the nearest line's centre in centimetres, row by row from the corner of smallest x and y.
    distances: Vec<u8>,
    columns: usize,
    /// Position of the first cell's centre in `map`.
    corner: DVec2,
    line_width_m: f64,
    /// Axes of the bars of the goals, from one end to the other, in `map`.
    goal_bars: Vec<[DVec3; 2]>,
    bar_diameter_m: f64,
}

/// How much of the clearly seen line a pose explains.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExplainedLines {
    /// Area of the floor that shows a line clearly, each part counted by its certainty, square metres.
    pub shown_m2: f64,
    /// Share of that area which lies on or beside a painted line, 0 to 1.
    ///
    /// A metre of explained line is added to both, since one spot on the carpet says little where few lines are in view.
    pub share: f64,
}

impl Default for ExplainedLines {
    /// No line is seen.
    fn default() -> Self {
        Self { shown_m2: 0.0, share: 1.0 }
    }
}

/// Side of a cell, metres.
const CELL_M: f64 = 0.04;
/// The map covers this much beyond the carpet's edge, where there are no lines, metres.
const MARGIN_M: f64 = 0.5;
/// Larger distances are stored as this one, metres.
const DISTANCE_LIMIT_M: f64 = 2.5;
/// Stored units per metre.
const PER_METRE: f64 = 100.0;
/// Length of line that is taken as explained beforehand, metres.
const PRIOR_M: f64 = 1.0;
/// Distance from a line's centre within which it explains a place, in line widths: half the paint's width and its blur.
const BESIDE_WIDTHS: f64 = 1.2;
/// Addition to that distance for the remaining error of the pose, metres for each metre from the camera.
const BESIDE_PER_M: f64 = 0.03;
/// Addition to that distance in a picture, where blur and the error of the pose move a line, pixels.
const BESIDE_PX: f64 = 1.5;
/// Length of line in a picture that is taken as explained beforehand, pixels.
const PRIOR_PX: f64 = 10.0;

impl LineDistanceMap {
    /// Computes the map of a field.
    pub fn new(field: &Field) -> Self {
        let corner = -field.carpet_half_extent() - DVec2::splat(MARGIN_M);
        let cells = |half: f64| libm::ceil(-2.0 * half / CELL_M) as usize + 1;
        let (columns, rows) = (cells(corner.x), cells(corner.y));
        let mut distances = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let at = corner + DVec2::new(column as f64, row as f64) * CELL_M;
                let distance = field.distance_to_centre_line(at).min(DISTANCE_LIMIT_M);
                distances.push(libm::round(distance * PER_METRE) as u8);
            }
        }
        let mut goal_bars = field.goal_bars();
        goal_bars.extend(ground_bars(field));
        let bar_diameter_m = field.dimensions().goal.map_or(0.0, |goal| goal.post_diameter_m);
        Self { distances, columns, corner, line_width_m: field.line_width(), goal_bars, bar_diameter_m }
    }

    /// Distance to the nearest line's centre, to 3 cm, metres.
    fn distance(&self, at: DVec2) -> f64 {
        let (u, v) = ((at.x - self.corner.x) / CELL_M + 0.5, (at.y - self.corner.y) / CELL_M + 0.5);
        // NaN fails.
        if !(u >= 0.0 && v >= 0.0) || u as usize >= self.columns {
            return DISTANCE_LIMIT_M;
        }
        let index = v as usize * self.columns + u as usize;
        self.distances.get(index).map_or(DISTANCE_LIMIT_M, |distance| f64::from(*distance) / PER_METRE)
    }

    /// How much of the line that the ground table `lines` shows is explained by the pose `map_from_optical`.
    ///
    /// `footprint_from_optical` is the camera's place that `lines` was made with.
    pub fn explained(
        &self,
        lines: &GroundTable,
        footprint_from_optical: &Isometry,
        map_from_optical: &Isometry,
    ) -> ExplainedLines {
        let (mut shown, mut explained) = (0.0, 0.0);
        self.each_shown(lines, footprint_from_optical, map_from_optical, |_, weight, is_on_line| {
            shown += weight;
            explained += if is_on_line { weight } else { 0.0 };
        });
        let (m2, prior_m2) = (lines.clear_line_m2(), PRIOR_M * self.line_width_m);
        ExplainedLines { shown_m2: shown * m2, share: (explained * m2 + prior_m2) / (shown * m2 + prior_m2) }
    }

    /// Share of the lines in a picture, at any distance, that are painted where the pose `map_from_optical` puts them.
    ///
    /// Each counts by its length in the picture, and 10 pixels of explained line are added. Lines that may be the frame of a goal are left
    /// out. The picture was taken through `lens` at `footprint_from_optical`.
    pub fn explained_in_view(
        &self,
        seen: &Observations,
        lens: &Lens,
        footprint_from_optical: &Isometry,
        map_from_optical: &Isometry,
    ) -> f64 {
        let ridges = seen.ridges(footprint_from_optical, lens.focal(), self.line_width_m);
        self.share_of(&ridges, lens, seen.image.scale(), map_from_optical)
    }

    /// [`Self::explained_in_view`] of given ridges.
    fn share_of(&self, ridges: &[Ridge], lens: &Lens, scale: WorkingScale, map_from_optical: &Isometry) -> f64 {
        let camera = map_from_optical.translation;
        let pixels_per_radian = lens.focal() * scale.factor();
        let (mut shown, mut explained) = (PRIOR_PX, PRIOR_PX);
        for Ridge { pixel, length_px } in ridges {
            let Some(ray) = lens.unproject(*pixel) else { continue };
            let ray = map_from_optical.transform_vector(ray);
            if ray.z >= 0.0 {
                shown += length_px;
                continue;
            }
            let reach = -camera.z / ray.z;
            let ground = camera + ray * reach;
            // Length of a pixel on the ground, along the line of sight.
            let slant = camera.distance(ground);
            let per_px = slant * slant / (camera.z.max(0.01) * pixels_per_radian);
            let beside = BESIDE_WIDTHS * self.line_width_m + BESIDE_PX * per_px;
            if self.distance(ground.truncate()) <= beside {
                shown += length_px;
                explained += length_px;
            } else if !self.may_be_goal(camera, ground, beside) {
                shown += length_px;
            }
        }
        explained / shown
    }

    /// Whether the ray from the camera to the ground passes a bar of a goal, to within its radius and `within_m` metres.
    fn may_be_goal(&self, camera: DVec3, ground: DVec3, within_m: f64) -> bool {
        let reach_m = self.bar_diameter_m / 2.0 + within_m;
        self.goal_bars.iter().any(|bar| distance_between([camera, ground], *bar) <= reach_m)
    }

    /// Calls `visit` for each place that shows a line clearly: with its ray from the camera along the axes of `map`, its certainty from
    /// 0 to 1, and whether a line is painted there.
    pub fn each_shown(
        &self,
        lines: &GroundTable,
        footprint_from_optical: &Isometry,
        map_from_optical: &Isometry,
        mut visit: impl FnMut(DVec3, f64, bool),
    ) {
        let map_from_table = *map_from_optical * footprint_from_optical.inverse();
        let camera = map_from_optical.translation;
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| map_from_table.transform_vector(axis));
        let seen_from = footprint_from_optical.translation;
        for (at, weight) in lines.clear_lines() {
            // The ray through that place of the table, which from the refined pose meets the floor at `ground`.
            let (dx, dy) = (at.x - seen_from.x, at.y - seen_from.y);
            let ray = x * dx + y * dy - z * seen_from.z;
            if ray.z >= 0.0 {
                visit(ray, weight, false);
                continue;
            }
            let reach = -camera.z / ray.z;
            let ground = (camera + ray * reach).truncate();
            let beside = BESIDE_WIDTHS * self.line_width_m + BESIDE_PER_M * libm::hypot(dx, dy);
            visit(ray, weight, self.distance(ground) <= beside);
        }
    }
}

/// The bars that hold the goals' nets on the ground: one from each post to the back, and one along the back.
fn ground_bars(field: &Field) -> Vec<[DVec3; 2]> {
    let dimensions = field.dimensions();
    let Some(goal) = dimensions.goal else { return Vec::new() };
    let (line_x, half_m) = (dimensions.length_m / 2.0, goal.width_m / 2.0);
    let bars = |side: f64| {
        let [front, back] = [line_x, line_x + goal.depth_m].map(|x| move |y: f64| DVec3::new(side * x, y, 0.0));
        [[front(half_m), back(half_m)], [front(-half_m), back(-half_m)], [back(-half_m), back(half_m)]]
    };
    [1.0, -1.0].into_iter().flat_map(bars).collect()
}

/// The shortest distance between two segments (C. Ericson, Real-Time Collision Detection, 2005, section 5.1.9).
fn distance_between([one_from, one_to]: [DVec3; 2], [other_from, other_to]: [DVec3; 2]) -> f64 {
    let (one, other, between) = (one_to - one_from, other_to - other_from, one_from - other_from);
    let (one_squared, other_squared) = (one.length_squared(), other.length_squared());
    let (along_one, along_other, both) = (one.dot(between), other.dot(between), one.dot(other));
    // Positions on both segments, 0 to 1. Segments without length or parallel ones divide by 0: the clamp takes NaN as 0.
    let clamped = |share: f64| if share >= 0.0 { share.min(1.0) } else { 0.0 };
    let on_one = (both * along_other - along_one * other_squared) / (one_squared * other_squared - both * both);
    let on_other = (both * clamped(on_one) + along_other) / other_squared;
    let on_one = (both * clamped(on_other) - along_one) / one_squared;
    (between + one * clamped(on_one) - other * clamped(on_other)).length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use realitysim_config::load_field;
    use realitysim_geometry::{Euler, LensModel, LensParameters};

    fn field() -> Field {
        Field::new(load_field("kid-2014").expect("shipped")).expect("checked")
    }

    fn lens() -> Lens {
        let model = LensModel::KannalaBrandt { k: [0.0; 4] };
        let (fx, fy, fov_deg) = (200.0, 200.0, Some(200.0));
        Lens::new(LensParameters { width: 640, height: 480, fx, fy, cx: 319.5, cy: 239.5, model, fov_deg })
            .expect("a lens")
    }

    /// Half a metre above the carpet, looking 30 degrees down.
    fn camera(x: f64, y: f64, yaw: f64) -> Isometry {
        Isometry::from_euler(Euler { yaw, pitch: 0.5, roll: 0.0 }, DVec3::new(x, y, 0.5))
            * Isometry::link_from_optical()
    }

    /// The lines within 4 m, as the camera sees them.
    fn seen_from(map_from_optical: &Isometry) -> Vec<Ridge> {
        let optical_from_map = map_from_optical.inverse();
        let near = |at: &DVec3| at.distance(map_from_optical.translation) < 4.0;
        let places = field().points(2000).into_iter().map(|point| point.position.extend(0.0)).filter(near);
        let rays = places.map(|at| optical_from_map.transform_point(at)).filter(|ray| ray.z > 0.0);
        rays.filter_map(|ray| lens().project(ray)).map(|pixel| Ridge { pixel, length_px: 1.0 }).collect()
    }

    #[test]
    fn the_right_pose_explains_every_line_in_view_and_a_wrong_one_few() {
        let line_distances = LineDistanceMap::new(&field());
        let share = |ridges: &[Ridge], at| line_distances.share_of(ridges, &lens(), WorkingScale::new(1), &at);
        for (x, y, yaw) in [(0.5, 0.3, 0.2), (-2.0, 1.0, 2.5), (3.0, -1.5, 0.4)] {
            let ridges = seen_from(&camera(x, y, yaw));
            assert!(ridges.len() > 60, "{}", ridges.len());
            assert_eq!(share(&ridges, camera(x, y, yaw)), 1.0, "{x} {y} {yaw}");
            assert!(share(&ridges, camera(x + 0.01, y - 0.01, yaw + 0.003)) > 0.97, "{x} {y} {yaw}: a centimetre");
            for wrong in [camera(x + 0.5, y + 0.4, yaw), camera(x, y, yaw + 0.5), camera(x, y, yaw + 1.5)] {
                assert!(share(&ridges, wrong) < 0.75, "{x} {y} {yaw}: {}", share(&ridges, wrong));
            }
        }
    }

    #[test]
    fn lines_above_the_horizon_are_unexplained_and_no_lines_are_no_evidence() {
        let line_distances = LineDistanceMap::new(&field());
        let share =
            |ridges: &[Ridge]| line_distances.share_of(ridges, &lens(), WorkingScale::new(1), &camera(0.0, 0.0, 0.0));
        assert_eq!(share(&[]), 1.0);
        let sky = Ridge { pixel: DVec2::new(320.0, 10.0), length_px: PRIOR_PX };
        assert_eq!(share(&[sky]), 0.5);
        let outside = Ridge { pixel: DVec2::new(-5000.0, f64::NAN), ..sky };
        assert!(share(&[outside]).is_finite());
    }

    #[test]
    fn the_distance_of_two_segments_is_that_of_a_search() {
        let point = |seed: u64| {
            let part =
                |axis: u64| (seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(17 * axis as u32) % 1000) as f64;
            DVec3::new(part(0), part(1), part(2)) / 500.0 - DVec3::ONE
        };
        for seed in 0..200_u64 {
            let [a, b, c, d] = [0, 1, 2, 3].map(|index| point(4 * seed + index + 1));
            let shares = || (0..=200).map(|step| f64::from(step) / 200.0);
            let least = shares()
                .flat_map(|one| shares().map(move |other| a.lerp(b, one).distance(c.lerp(d, other))))
                .fold(f64::INFINITY, f64::min);
            let found = distance_between([a, b], [c, d]);
            assert!(found <= least + 1e-12 && found > least - 0.02, "{seed}: {found} instead of {least}");
            let of_a = shares().map(|share| a.distance(c.lerp(d, share))).fold(f64::INFINITY, f64::min);
            assert!((distance_between([a, a], [c, d]) - of_a).abs() < 0.01, "{seed}: of a point");
        }
    }

    #[test]
    fn the_bars_of_a_goal_are_left_out() {
        let field = Field::new(load_field("kid-2020").expect("shipped")).expect("checked");
        let line_distances = LineDistanceMap::new(&field);
        let goal = field.dimensions().goal.expect("kid-2020 has goals");
        let (line_x, half_m) = (field.dimensions().length_m / 2.0, goal.width_m / 2.0);
        for side in [1.0, -1.0] {
            let camera = DVec3::new(2.5 * side, 0.3, 0.5);
            let beyond = |at: DVec3| camera + (at - camera) * (camera.z / (camera.z - at.z));
            let post = DVec3::new(line_x * side, half_m, 0.2);
            let back = DVec3::new((line_x + goal.depth_m) * side, 0.4, 0.0);
            assert!(
                line_distances.may_be_goal(camera, beyond(post), 0.02)
                    && line_distances.may_be_goal(camera, back, 0.02)
            );
            assert!(!line_distances.may_be_goal(camera, DVec3::new(3.5 * side, 0.4, 0.0), 0.02), "before the goal");
            assert!(!line_distances.may_be_goal(camera, beyond(post + DVec3::Y * 0.5), 0.02), "beside it");
            assert!(!line_distances.may_be_goal(camera, DVec3::new((line_x + 0.3) * side, 0.4, 0.0), 0.02), "in it");
        }
    }
}
