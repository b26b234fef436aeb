//! Calibration boards: AprilGrid (Kalibr) and ChArUco (OpenCV).
//!
//! Both have corners at which two black and two white areas meet, and markers with a code that tell which corner is which. The
//! codes are those of the AprilTag family 36h11 (AprilRobotics, BSD-2-Clause) and of OpenCV's predefined dictionaries
//! (Apache-2.0), one in each line: bits row by row from the top left, 1 is white.

use core::f64::consts::SQRT_2;

use glam::DVec2;
use thiserror::Error;

/// A flat calibration board. Coordinates are metres: x right, y up, the origin at the lower left corner.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    /// The corners, metres.
    pub corners_m: Vec<DVec2>,
    /// The markers that tell the corners apart.
    pub markers: Vec<BoardMarker>,
    /// Number of a code's bits in a row.
    pub bits: usize,
    /// Width of the black border around a code, bits.
    pub border_bits: usize,
    /// Distance of the marker's edge from that of its cell, as a share of the cell.
    pub inset: f64,
    /// Width of what lies around a corner undisturbed, as a share of the cell.
    pub clear_share: f64,
}

/// A cell with a marker between four corners.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BoardMarker {
    /// Indices of the cell's corners in [`Board::corners_m`]: top left, top right, bottom right, bottom left as printed.
    pub corners: [usize; 4],
    /// The marker's bits, row by row from the top left; the first is the most significant.
    pub code: u64,
}

/// A dictionary of ChArUco markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoardDictionary {
    /// OpenCV's `DICT_4X4_50` to `DICT_4X4_250`.
    Aruco4x4,
    /// OpenCV's `DICT_5X5_50` to `DICT_5X5_250`.
    Aruco5x5,
    /// OpenCV's `DICT_6X6_50` to `DICT_6X6_250`.
    Aruco6x6,
    /// AprilTag 36h11, OpenCV's `DICT_APRILTAG_36h11`.
    AprilTag36h11,
}

/// Why a board is impossible.
#[derive(Debug, Error, PartialEq)]
pub enum BoardError {
    /// The number of columns or rows is out of range.
    #[error("{columns} x {rows}: a board has {min} to {MAX_CELLS} columns and rows")]
    Cells {
        /// Number of columns.
        columns: usize,
        /// Number of rows.
        rows: usize,
        /// Least number of either.
        min: usize,
    },
    /// A size is out of range.
    #[error("{name} is {value}: it must be {expected}")]
    Size {
        /// Name of the size.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
    /// The dictionary has too few markers.
    #[error("the board needs {needed} markers, and the dictionary has {known}")]
    Markers {
        /// Markers of the board.
        needed: usize,
        /// Markers of the dictionary.
        known: usize,
    },
}

/// Most columns or rows of a board.
pub const MAX_CELLS: usize = 40;
/// Range of the side of a cell, metres.
const SIDE_M: core::ops::RangeInclusive<f64> = 0.001..=5.0;
/// Width of the border of an AprilGrid's tags, bits, as Kalibr prints them.
const APRILGRID_BORDER: usize = 2;

impl BoardDictionary {
    fn bits(self) -> usize {
        match self {
            Self::Aruco4x4 => 4,
            Self::Aruco5x5 => 5,
            Self::Aruco6x6 | Self::AprilTag36h11 => 6,
        }
    }

    fn codes(self) -> Vec<u64> {
        let text = match self {
            Self::Aruco4x4 => include_str!("aruco_4x4.txt"),
            Self::Aruco5x5 => include_str!("aruco_5x5.txt"),
            Self::Aruco6x6 => include_str!("aruco_6x6.txt"),
            Self::AprilTag36h11 => include_str!("apriltag_36h11.txt"),
        };
        text.lines().filter_map(|line| u64::from_str_radix(line, 16).ok()).collect()
    }

    /// The first `needed` codes.
    fn first(self, needed: usize) -> Result<Vec<u64>, BoardError> {
        let mut codes = self.codes();
        if codes.len() < needed {
            return Err(BoardError::Markers { needed, known: codes.len() });
        }
        codes.truncate(needed);
        Ok(codes)
    }
}

impl Board {
    /// Makes Kalibr's AprilGrid: tags of side `tag_m`, `spacing` tag sides apart, numbered by rows from the lower left.
    ///
    /// # Errors
    ///
    /// A [`BoardError`] if a size is impossible or the family has too few tags.
    pub fn aprilgrid(columns: usize, rows: usize, tag_m: f64, spacing: f64) -> Result<Self, BoardError> {
        check_cells(columns, rows, 1)?;
        check("tagSize", tag_m, SIDE_M, "0.001 to 5 m")?;
        check("tagSpacing", spacing, 0.05..=1.0, "0.05 to 1: the gap between two tags divided by the side of a tag")?;
        let step_m = tag_m * (1.0 + spacing);
        let codes = BoardDictionary::AprilTag36h11.first(columns * rows)?;
        let (mut corners_m, mut markers) = (Vec::new(), Vec::new());
        for (number, code) in codes.into_iter().enumerate() {
            let low = DVec2::new((number % columns) as f64, (number / columns) as f64) * step_m;
            let first = corners_m.len();
            let corner = |x: f64, y: f64| low + DVec2::new(x, y) * tag_m;
            corners_m.extend([corner(0.0, 1.0), corner(1.0, 1.0), corner(1.0, 0.0), corner(0.0, 0.0)]);
            markers.push(BoardMarker { corners: [first, first + 1, first + 2, first + 3], code });
        }
        let border = APRILGRID_BORDER as f64 / (6 + 2 * APRILGRID_BORDER) as f64;
        let clear_share = border.min(spacing);
        Ok(Self { corners_m, markers, bits: 6, border_bits: APRILGRID_BORDER, inset: 0.0, clear_share })
    }

    /// Makes OpenCV's ChArUco board (as of 4.6, not the legacy pattern) of `columns` x `rows` squares of side `square_m`, with
    /// markers of side `marker_m` in its white squares, numbered by rows from the top left.
    ///
    /// # Errors
    ///
    /// A [`BoardError`] if a size is impossible or the dictionary has too few markers.
    pub fn charuco(
        columns: usize,
        rows: usize,
        square_m: f64,
        marker_m: f64,
        dictionary: BoardDictionary,
    ) -> Result<Self, BoardError> {
        check_cells(columns, rows, 4)?;
        check("squareSize", square_m, SIDE_M, "0.001 to 5 m")?;
        check("markerSize", marker_m / square_m, 0.3..=0.95, "0.3 to 0.95 of squareSize")?;
        let codes = dictionary.first(columns * rows / 2)?;
        let inner = |column: usize, row: usize| (row - 1) * (columns - 1) + column - 1;
        let mut corners_m = Vec::new();
        for row in 1..rows {
            corners_m.extend((1..columns).map(|column| DVec2::new(column as f64, (rows - row) as f64) * square_m));
        }
        let white = (0..rows).flat_map(|row| (0..columns).map(move |column| (column, row)));
        let white = white.filter(|(column, row)| (column + row) % 2 == 1);
        // A square at the rim has outer corners, at which only two areas meet: its marker is not used.
        let is_inside = |column: usize, row: usize| (1..columns - 1).contains(&column) && (1..rows - 1).contains(&row);
        let markers = white.zip(codes).filter(|((column, row), _)| is_inside(*column, *row));
        let markers = markers.map(|((column, row), code)| BoardMarker {
            corners: [inner(column, row), inner(column + 1, row), inner(column + 1, row + 1), inner(column, row + 1)],
            code,
        });
        let inset = 0.5 * (1.0 - marker_m / square_m);
        Ok(Self {
            corners_m,
            markers: markers.collect(),
            bits: dictionary.bits(),
            border_bits: 1,
            inset,
            clear_share: SQRT_2 * inset,
        })
    }
}

fn check_cells(columns: usize, rows: usize, min: usize) -> Result<(), BoardError> {
    let range = min..=MAX_CELLS;
    if range.contains(&columns) && range.contains(&rows) {
        return Ok(());
    }
    Err(BoardError::Cells { columns, rows, min })
}

fn check(
    name: &'static str,
    value: f64,
    range: core::ops::RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), BoardError> {
    if range.contains(&value) { Ok(()) } else { Err(BoardError::Size { name, value, expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_aprilgrid_has_kalibr_s_corners_and_codes() {
        let board = Board::aprilgrid(6, 5, 0.08, 0.3).expect("a board");
        assert_eq!((board.corners_m.len(), board.markers.len()), (120, 30));
        let second_row = board.markers[6];
        assert!(board.corners_m[second_row.corners[3]].distance(DVec2::new(0.0, 0.104)) < 1e-12);
        assert_eq!(board.markers[0].code, 0xd5d6_28584);
    }

    #[test]
    fn the_markers_of_a_charuco_board_lie_in_white_squares_inside() {
        let board = Board::charuco(6, 5, 0.04, 0.03, BoardDictionary::Aruco4x4).expect("a board");
        assert_eq!((board.corners_m.len(), board.markers.len()), (20, 6));
        let side = |[a, b, ..]: [usize; 4]| board.corners_m[a].distance(board.corners_m[b]);
        assert!(board.markers.iter().all(|marker| (side(marker.corners) - 0.04).abs() < 1e-12));
    }

    #[test]
    fn impossible_boards_are_refused() {
        assert!(Board::aprilgrid(0, 5, 0.08, 0.3).is_err() && Board::aprilgrid(6, 6, 80.0, 0.3).is_err());
        assert!(matches!(Board::aprilgrid(30, 30, 0.08, 0.3), Err(BoardError::Markers { needed: 900, known: 587 })));
        assert!(Board::charuco(6, 5, 0.04, 0.05, BoardDictionary::Aruco4x4).is_err());
        assert!(Board::aprilgrid(6, 6, f64::NAN, 0.3).is_err());
    }
}
