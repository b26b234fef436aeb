//! Pictures of calibration boards through a lens, for tests that know every corner exactly.

use glam::{DVec2, DVec3};
use realitysim_geometry::{Board, BoardMarker, Isometry, Lens};

/// A printed board: the corners and codes, and what lies between them.
#[derive(Clone, Debug)]
pub struct PrintedBoard {
    /// Corners and markers.
    pub board: Board,
    /// Number of columns and rows of tags or squares.
    pub cells: [usize; 2],
    /// Distance between the same corners of neighbouring cells, metres.
    pub step_m: f64,
}

/// Rays for each side of a pixel: edges are averaged over the pixel.
const RAYS: usize = 3;
const BLACK: f64 = 25.0;
const WHITE: f64 = 215.0;
const BACKGROUND: f64 = 110.0;

impl PrintedBoard {
    /// Whether the board is black at a point, metres; `None` beside it.
    fn is_black(&self, at: DVec2) -> Option<bool> {
        let Self { board, cells: [columns, rows], step_m } = self;
        let is_aprilgrid = board.inset == 0.0;
        let margin = if is_aprilgrid { step_m - self.tag_m() } else { 0.0 };
        let size = DVec2::new(*columns as f64, *rows as f64) * *step_m + margin;
        let from_edge = at + margin;
        if from_edge.min_element() < 0.0 || (size - from_edge).min_element() < 0.0 {
            return None;
        }
        let marker = self.nearest_marker(at);
        let [top_left, _, bottom_right, _] = marker.corners.map(|corner| board.corners_m[corner]);
        let share = (at - top_left) / (bottom_right - top_left);
        if share.min_element() >= 0.0 && share.max_element() < 1.0 {
            return Some(self.marker_is_black(marker.code, share));
        }
        if is_aprilgrid {
            // Between the tags only the squares at their corners are black.
            let is_gap = |at: f64| at.rem_euclid(*step_m) >= self.tag_m();
            return Some(is_gap(at.x) && is_gap(at.y));
        }
        let [column, row] = [at.x / step_m, *rows as f64 - at.y / step_m].map(|at| at as usize);
        Some((column + row).is_multiple_of(2))
    }

    /// The marker whose cell's lower left corner is nearest.
    fn nearest_marker(&self, at: DVec2) -> BoardMarker {
        let low = (at / self.step_m).floor() * self.step_m;
        let off = |marker: &&BoardMarker| self.board.corners_m[marker.corners[3]].distance_squared(low);
        let nearest = self.board.markers.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        *nearest.expect("a board has markers")
    }

    fn tag_m(&self) -> f64 {
        let [left, right, ..] = self.board.markers[0].corners;
        self.board.corners_m[left].distance(self.board.corners_m[right])
    }

    /// Whether a marker's cell is black at a share of its width and height from the top left.
    fn marker_is_black(&self, code: u64, share: DVec2) -> bool {
        let Board { bits, border_bits, inset, .. } = self.board;
        let side = (bits + 2 * border_bits) as f64;
        let bit = (share - inset) / (1.0 - 2.0 * inset) * side;
        if bit.min_element() < 0.0 || bit.max_element() >= side {
            return false;
        }
        let inside = bit - border_bits as f64;
        if inside.min_element() < 0.0 || inside.max_element() >= bits as f64 {
            return true;
        }
        let number = inside.y as usize * bits + inside.x as usize;
        code >> (bits * bits - 1 - number) & 1 == 0
    }

    /// The board at a pose through a lens, row by row, with noise of a standard deviation of two gray levels.
    pub fn draw(&self, lens: &Lens, optical_from_board: &Isometry, seed: u64) -> Vec<u8> {
        let board_from_optical = optical_from_board.inverse();
        let origin = board_from_optical.translation;
        let point = |pixel: DVec2| {
            let ray = board_from_optical.transform_vector(lens.unproject(pixel)?);
            let distance = -origin.z / ray.z;
            (distance > 0.0).then(|| (origin + ray * distance).truncate())
        };
        let size_m = DVec2::new(self.cells[0] as f64, self.cells[1] as f64) * self.step_m;
        let is_near = |at: DVec2| (at - 0.5 * size_m).abs().max_element() < size_m.max_element();
        let mut noise = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
        let (width, height) = (lens.width() as usize, lens.height() as usize);
        let pixel = |at: usize| {
            let middle = DVec2::new((at % width) as f64, (at / width) as f64);
            if !point(middle).is_some_and(is_near) {
                return BACKGROUND as u8;
            }
            let rays = (0..RAYS * RAYS).map(|ray| {
                let off = |step: usize| (step as f64 + 0.5) / RAYS as f64 - 0.5;
                self.is_black(point(middle + DVec2::new(off(ray % RAYS), off(ray / RAYS)))?)
            });
            let sum: f64 = rays.map(|black| black.map_or(BACKGROUND, |black| if black { BLACK } else { WHITE })).sum();
            let mut noisy = sum / (RAYS * RAYS) as f64;
            for _ in 0..4 {
                noise ^= noise << 13;
                noise ^= noise >> 7;
                noise ^= noise << 17;
                noisy += 3.46 * ((noise >> 11) as f64 / (1u64 << 53) as f64 - 0.5);
            }
            noisy.round().clamp(0.0, 255.0) as u8
        };
        (0..width * height).map(pixel).collect()
    }

    /// Pixels of all corners in view, by number.
    pub fn corners(&self, lens: &Lens, optical_from_board: &Isometry) -> Vec<Option<DVec2>> {
        let corners = self.board.corners_m.iter();
        corners
            .map(|corner| lens.project(optical_from_board.transform_point(corner.extend(0.0))))
            .map(|pixel| pixel.filter(|pixel| lens.contains(*pixel)))
            .collect()
    }
}

/// Poses of a board (`optical_from_board`) of this size that together fill the view of a fisheye: turned to the camera, tilted
/// by up to half a radian, at half to one and a half sizes.
pub fn board_poses(size_m: DVec2, count: usize, reach_rad: f64) -> Vec<Isometry> {
    use glam::DQuat;
    let pose = |number: usize| {
        // Points of a golden spiral cover the view evenly.
        let share = (number as f64 + 0.5) / count as f64;
        let (off, around) = (reach_rad * share.sqrt(), 2.399_963 * number as f64);
        let turned = DQuat::from_axis_angle(DVec3::new(around.cos(), around.sin(), 0.0), off);
        let wave = |rate: f64| (rate * number as f64).sin();
        let tilted = DQuat::from_scaled_axis(DVec3::new(0.55 * wave(1.7), 0.55 * wave(2.9), 0.6 * wave(0.7)));
        // A board's y points up, that of the camera down; its z points to the camera.
        let facing = DQuat::from_rotation_x(std::f64::consts::PI);
        let rotation = turned * tilted * facing;
        let distance = size_m.max_element() * (0.85 + 0.3 * wave(1.1));
        let middle = turned * DVec3::new(0.0, 0.0, distance);
        Isometry::new(rotation, middle - rotation * (0.5 * size_m).extend(0.0))
    };
    (0..count).map(pose).collect()
}
