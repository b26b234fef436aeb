//! The other way round: of the line that a frame shows, how much is painted where the pose puts it?
//!
//! The observation asks whether the field's lines are seen; on the wrong field, or in a place that only looks like the
//! right one, many are, and beside them lines that the field does not have.

use glam::{DVec2, DVec3};

use crate::geometry::{Field, Isometry};
use crate::vision::GroundTable;

/// Distance from any place of the carpet to the nearest painted line.
#[derive(Clone, Debug)]
pub struct PaintedMap {
    /// Millimetres over ten, row by row from the corner of least x and y.
    distances: Vec<u8>,
    columns: usize,
    corner: DVec2,
    line_width_m: f64,
}

/// Of the places that show a line clearly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Explained {
    /// Square metres, each counted by its certainty.
    pub shown_m2: f64,
    /// Share of these that lie on or beside a painted line, 0 to 1, as if a metre of line more had been explained: one
    /// spot on the carpet says little where few lines are in view.
    pub share: f64,
}

impl Default for Explained {
    /// Nothing is seen.
    fn default() -> Self {
        Self { shown_m2: 0.0, share: 1.0 }
    }
}

const CELL_M: f64 = 0.04;
/// Lines are looked for beyond the carpet's edge as well: there are none.
const MARGIN_M: f64 = 0.5;
/// Farther is all the same.
const FARTHEST_M: f64 = 2.5;
const PER_METRE: f64 = 100.0;
/// A metre of line.
const BELIEVED_M2: f64 = 0.05;
/// A place shows a line as long as it lies so close to one: half the paint's width and its blur, ...
const BESIDE_WIDTHS: f64 = 1.2;
/// ... and what the rest of the pose's error does to far places: metres for each metre of distance.
const BESIDE_PER_M: f64 = 0.03;

impl PaintedMap {
    pub fn new(field: &Field) -> Self {
        let corner = -field.carpet_half_extent() - DVec2::splat(MARGIN_M);
        let cells = |half: f64| libm::ceil(-2.0 * half / CELL_M) as usize + 1;
        let (columns, rows) = (cells(corner.x), cells(corner.y));
        let mut distances = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let at = corner + DVec2::new(column as f64, row as f64) * CELL_M;
                let distance = field.distance_to_centre_line(at).min(FARTHEST_M);
                distances.push(libm::round(distance * PER_METRE) as u8);
            }
        }
        Self { distances, columns, corner, line_width_m: field.line_width() }
    }

    /// Metres to the nearest line's centre, to 3 cm.
    fn distance(&self, at: DVec2) -> f64 {
        let (u, v) = ((at.x - self.corner.x) / CELL_M + 0.5, (at.y - self.corner.y) / CELL_M + 0.5);
        // NaN fails.
        if !(u >= 0.0 && v >= 0.0) || u as usize >= self.columns {
            return FARTHEST_M;
        }
        let index = v as usize * self.columns + u as usize;
        self.distances.get(index).map_or(FARTHEST_M, |distance| f64::from(*distance) / PER_METRE)
    }

    /// `lines` was made with the camera at `footprint_from_optical`, while its pose is `map_from_optical`.
    pub fn explained(
        &self,
        lines: &GroundTable,
        footprint_from_optical: &Isometry,
        map_from_optical: &Isometry,
    ) -> Explained {
        let (mut shown, mut explained) = (0.0, 0.0);
        self.each_shown(lines, footprint_from_optical, map_from_optical, |_, weight, is_painted| {
            shown += weight;
            explained += if is_painted { weight } else { 0.0 };
        });
        let m2 = lines.clear_line_m2();
        Explained { shown_m2: shown * m2, share: (explained * m2 + BELIEVED_M2) / (shown * m2 + BELIEVED_M2) }
    }

    /// Of each place that shows a line clearly: its ray from the camera, along the axes of `map`, how certain it is, and whether a
    /// line is painted there.
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
            // The ray through that place of the table, to where it meets the floor from the refined pose.
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
