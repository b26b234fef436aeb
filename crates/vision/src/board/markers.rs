//! Markers: cells between four saddles, with a code inside.

use std::collections::BTreeMap;

use glam::DVec2;

use super::saddle_grid::SaddleGrid;
use super::saddles::Saddle;
use super::{BoardCorner, luma_at};
use crate::Picture;
use realitysim_geometry::Board;

/// Corners along each edge of a saddle that are tried as the cell's next one.
const MAX_NEXT: usize = 8;
/// Distance within which next corners are looked for first, pixels.
const FIRST_REACH_PX: f64 = 48.0;
/// Longest side of a cell, as a share of the picture's width.
const SIDE_SHARE_LIMIT: f64 = 0.4;
/// Shortest side of a cell for each of its bits, pixels.
const MIN_BIT_PX: f64 = 1.2;
/// Least cosine of the angle between an edge and the way to the next corner.
const MIN_ALIGNED: f64 = 0.96;
/// Distance of the fourth corner from where three of them put it, as a share of the shorter side.
const CLOSURE_SHARE: f64 = 0.5;
/// Least difference between the code's white and the border's black, gray levels.
const MIN_CONTRAST: f64 = 16.0;
/// Share of the border's bits that may look white.
const WHITE_BORDER_LIMIT: f64 = 0.08;
/// A code may have one wrong bit for so many bits.
const BITS_FOR_AN_ERROR: usize = 17;

/// The corners of all markers that can be read. A corner that two markers see at different saddles is left out.
pub(super) fn read(picture: &Picture, board: &Board, grid: &SaddleGrid) -> Vec<BoardCorner> {
    let saddles = grid.saddles();
    let mut found: BTreeMap<usize, Option<(usize, f64)>> = BTreeMap::new();
    let next = |from: usize, along: DVec2| next_corners(picture, board, grid, from, along);
    for first in 0..saddles.len() {
        let [one, other] = saddles[first].edges;
        // The edges in the order in which they are met clockwise on the picture, whose y points down.
        let [right, down] = if one.perp_dot(other) > 0.0 { [one, other] } else { [other, one] };
        for (along, across) in [(right, down), (down, -right)] {
            let (seconds, fourths) = (next(first, along), next(first, across));
            for second in &seconds {
                for fourth in &fourths {
                    let Some(third) = fourth_corner(grid, first, *second, *fourth) else { continue };
                    let quad = [first, *second, third, *fourth];
                    let Some(corners) = decode(picture, board, quad.map(|at| saddles[at].pixel)) else { continue };
                    let side = |i: usize| saddles[quad[i]].pixel.distance(saddles[quad[(i + 1) % 4]].pixel);
                    let side_px = (0..4).map(side).fold(f64::INFINITY, f64::min);
                    for (number, at) in corners.into_iter().zip(quad) {
                        let seen = found.entry(number).or_insert(Some((at, side_px)));
                        *seen = seen.filter(|(other, _)| *other == at).map(|(at, other)| (at, other.min(side_px)));
                    }
                }
            }
        }
    }
    let corner = |(number, seen): (usize, Option<(usize, f64)>)| {
        let (at, side_px) = seen?;
        Some(BoardCorner { number, pixel: saddles[at].pixel, side_px })
    };
    found.into_iter().filter_map(corner).collect()
}

/// The nearest saddles along an edge whose own edge leads back.
fn next_corners(picture: &Picture, board: &Board, grid: &SaddleGrid, from: usize, along: DVec2) -> Vec<usize> {
    let here = grid.saddles()[from].pixel;
    let cell_bits = (board.bits + 2 * board.border_bits) as f64 / (1.0 - 2.0 * board.inset);
    let sides = MIN_BIT_PX * cell_bits..=SIDE_SHARE_LIMIT * picture.width as f64;
    let leads = |(distance, number): &(f64, usize)| {
        let saddle = &grid.saddles()[*number];
        let way = saddle.pixel - here;
        let leads_back = || saddle.edges.iter().any(|edge| edge.dot(way).abs() > MIN_ALIGNED * distance);
        sides.contains(distance) && way.dot(along) > MIN_ALIGNED * distance && leads_back()
    };
    // Most next corners are near: farther ones are looked for only while too few are found.
    let mut reach = FIRST_REACH_PX;
    let mut near: Vec<(f64, usize)> = loop {
        let reached = reach.min(*sides.end());
        let near: Vec<(f64, usize)> = grid.within(here, reached).filter(leads).collect();
        if near.len() >= MAX_NEXT || reached >= *sides.end() {
            break near;
        }
        reach *= 2.0;
    };
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    near.into_iter().take(MAX_NEXT).map(|(_, number)| number).collect()
}

/// The saddle that closes the parallelogram best.
fn fourth_corner(grid: &SaddleGrid, first: usize, second: usize, fourth: usize) -> Option<usize> {
    let saddles = grid.saddles();
    let [a, b, d] = [first, second, fourth].map(|at| saddles[at].pixel);
    let shorter = a.distance(b).min(a.distance(d));
    let leads = |saddle: &Saddle, to: DVec2| {
        let way = (to - saddle.pixel).normalize_or_zero();
        saddle.edges.iter().any(|edge| edge.dot(way).abs() > MIN_ALIGNED)
    };
    let near = grid.within(b + d - a, CLOSURE_SHARE * shorter).filter(|(_, number)| {
        let saddle = &saddles[*number];
        ![first, second, fourth].contains(number) && leads(saddle, b) && leads(saddle, d)
    });
    near.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map(|(_, number)| number)
}

/// Reads the code between four corners in clockwise order; returns their numbers on the board.
fn decode(picture: &Picture, board: &Board, quad: [DVec2; 4]) -> Option<[usize; 4]> {
    let side = board.bits + 2 * board.border_bits;
    let place = |bit: usize| board.inset + (1.0 - 2.0 * board.inset) * (bit as f64 + 0.5) / side as f64;
    let plane = Homography::onto(quad)?;
    let (mut border, mut inside) = (Vec::with_capacity(side * side), Vec::with_capacity(board.bits * board.bits));
    for row in 0..side {
        for column in 0..side {
            let value = luma_at(picture, plane.at(place(column), place(row)))?;
            let is_inside = |at: usize| (board.border_bits..board.border_bits + board.bits).contains(&at);
            if is_inside(row) && is_inside(column) { inside.push(value) } else { border.push(value) }
        }
    }
    let black = border.iter().sum::<f64>() / border.len() as f64;
    let white = inside.iter().copied().fold(0.0, f64::max);
    let limit = 0.5 * (black + white);
    let white_border = border.iter().filter(|value| **value > limit).count() as f64;
    if white - black < MIN_CONTRAST || white_border > WHITE_BORDER_LIMIT * border.len() as f64 {
        return None;
    }
    let bits: Vec<bool> = inside.iter().map(|value| *value > limit).collect();
    look_up(board, bits)
}

/// The board's marker with these bits in any of four orientations.
fn look_up(board: &Board, mut bits: Vec<bool>) -> Option<[usize; 4]> {
    let side = board.bits;
    let allowed = (side * side / BITS_FOR_AN_ERROR) as u32;
    for turn in 0..4 {
        let code = bits.iter().fold(0u64, |code, bit| code << 1 | u64::from(*bit));
        if let Some(marker) = board.markers.iter().find(|marker| (marker.code ^ code).count_ones() <= allowed) {
            // The corner `turn` places on is the top left one of the marker.
            return Some(core::array::from_fn(|corner| marker.corners[(corner + 4 - turn) % 4]));
        }
        // A quarter turn anticlockwise: the right column becomes the top row.
        bits = (0..side * side).map(|at| bits[at % side * side + side - 1 - at / side]).collect();
    }
    None
}

/// A projection of the unit square onto four points.
struct Homography {
    x: [f64; 3],
    y: [f64; 3],
    z: [f64; 2],
}

impl Homography {
    /// From (0, 0), (1, 0), (1, 1), (0, 1) to the points (Heckbert 1989); `None` if they do not make a convex quadrilateral.
    fn onto([a, b, c, d]: [DVec2; 4]) -> Option<Self> {
        let turns = [(a, b, c), (b, c, d), (c, d, a), (d, a, b)].map(|(p, q, r)| (q - p).perp_dot(r - q));
        if turns.iter().any(|turn| *turn <= 0.0) {
            return None;
        }
        let (sum, right, low) = (a - b + c - d, b - c, d - c);
        let determinant = right.perp_dot(low);
        let (g, h) = (sum.perp_dot(low) / determinant, right.perp_dot(sum) / determinant);
        let (across, along) = (b - a + g * b, d - a + h * d);
        Some(Self { x: [across.x, along.x, a.x], y: [across.y, along.y, a.y], z: [g, h] })
    }

    fn at(&self, u: f64, v: f64) -> DVec2 {
        let scale = 1.0 / (self.z[0] * u + self.z[1] * v + 1.0);
        DVec2::new(self.x[0] * u + self.x[1] * v + self.x[2], self.y[0] * u + self.y[1] * v + self.y[2]) * scale
    }
}
