//! Finds the corners of a calibration board in a picture, to a fraction of a pixel.
//!
//! [`find_corners`] needs no lens. Corners are saddles of brightness; four of them around a code are a marker, and a homography
//! over one marker is good enough to read its code even at the rim of a fisheye. [`refine_corner`] locates a corner whose
//! place is known to a pixel or two.

mod markers;
mod saddle_grid;
mod saddles;

use glam::DVec2;

use crate::Picture;
use realitysim_geometry::Board;
use saddle_grid::SaddleGrid;
use saddles::saddles;

/// A corner of a board in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardCorner {
    /// Index in [`Board::corners_m`].
    pub number: usize,
    /// Its pixel.
    pub pixel: DVec2,
    /// Shortest side of its marker's cell, pixels.
    pub side_px: f64,
}

/// Half the side of the window around a corner, pixels.
const HALF_PX: core::ops::RangeInclusive<f64> = 2.0..=5.0;
/// Least width of what lies around a corner undisturbed, pixels: the window of a corner has two pixels on each side.
const MIN_CLEAR_PX: f64 = 2.8;
/// Most steps of the refinement of a corner.
const STEPS: usize = 20;
/// A corner is found when a step is shorter, pixels.
const MIN_STEP_PX: f64 = 1e-3;
/// Farthest that a corner is moved by its refinement, pixels.
const REACH_PX: f64 = 2.5;
/// Least ratio of the eigenvalues of a corner's gradients: along an edge it is 0.
const MIN_ISOTROPY: f64 = 0.03;

/// Finds the corners of a board that lie at markers whose code can be read, ordered by number.
pub fn find_corners(picture: &Picture, board: &Board) -> Vec<BoardCorner> {
    let saddles = saddles(picture);
    let grid = SaddleGrid::new(&saddles, picture.width, picture.height);
    let refined = markers::read(picture, board, &grid).into_iter().filter_map(|corner| {
        let pixel = refine_corner(picture, corner.pixel, window(board, corner.side_px)?)?;
        Some(BoardCorner { pixel, ..corner })
    });
    refined.collect()
}

/// Half the side of the window around a corner of a cell whose shortest side is `side_px`; `None` if what lies around the corner
/// is too near to locate it.
pub fn window(board: &Board, side_px: f64) -> Option<f64> {
    let clear_px = board.clear_share * side_px;
    (clear_px >= MIN_CLEAR_PX).then(|| (0.7 * clear_px).clamp(*HALF_PX.start(), *HALF_PX.end()))
}

/// Locates a corner near `start`: the point that all gradients around it are perpendicular to the way to.
///
/// This is the method of OpenCV's `cornerSubPix` (Foerstner and Guelch 1987). `None` if there is no corner.
pub fn refine_corner(picture: &Picture, start: DVec2, half_px: f64) -> Option<DVec2> {
    let mut corner = start;
    for _ in 0..STEPS {
        let next = perpendicular_point(picture, corner, half_px)?;
        let step = next.distance(corner);
        corner = next;
        if corner.distance(start) > REACH_PX {
            return None;
        }
        if step < MIN_STEP_PX {
            break;
        }
    }
    Some(corner)
}

fn perpendicular_point(picture: &Picture, around: DVec2, half_px: f64) -> Option<DVec2> {
    let reach = libm::ceil(half_px) as i32;
    let (mut xx, mut xy, mut yy, mut right) = (0.0, 0.0, 0.0, DVec2::ZERO);
    for row in -reach..=reach {
        for column in -reach..=reach {
            let off = DVec2::new(f64::from(column), f64::from(row));
            let at = around + off;
            let value = |x: f64, y: f64| luma_at(picture, at + DVec2::new(x, y));
            let gradient = 0.5 * DVec2::new(value(1.0, 0.0)? - value(-1.0, 0.0)?, value(0.0, 1.0)? - value(0.0, -1.0)?);
            let weight = libm::exp(-off.length_squared() / (half_px * half_px));
            let (gx, gy) = (gradient.x, gradient.y);
            xx += weight * gx * gx;
            xy += weight * gx * gy;
            yy += weight * gy * gy;
            right += gradient * (weight * gradient.dot(off));
        }
    }
    let determinant = xx * yy - xy * xy;
    let half_trace = 0.5 * (xx + yy);
    if half_trace <= 0.0 || determinant < MIN_ISOTROPY * half_trace * half_trace {
        return None;
    }
    Some(around + DVec2::new(yy * right.x - xy * right.y, xx * right.y - xy * right.x) / determinant)
}

/// Brightness between pixels; `None` outside of the picture.
fn luma_at(picture: &Picture, at: DVec2) -> Option<f64> {
    let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < (picture.width - 1) as f64 && at.y < (picture.height - 1) as f64;
    if !inside {
        return None;
    }
    let (column, row) = (at.x as usize, at.y as usize);
    let (x, y) = (at.x - column as f64, at.y - row as f64);
    let first = row * picture.width + column;
    let value = |index: usize| f64::from(picture.luma[index]);
    let upper = value(first) * (1.0 - x) + value(first + 1) * x;
    let lower = value(first + picture.width) * (1.0 - x) + value(first + picture.width + 1) * x;
    Some(upper * (1.0 - y) + lower * y)
}

#[cfg(test)]
mod tests;
