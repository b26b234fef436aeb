//! Files that describe a calibration board, in the YAML that Kalibr reads.

use std::path::Path;

use serde::Deserialize;

use super::ConfigError;
use super::plain_file;
use realitysim_geometry::{Board, BoardDictionary};

/// Largest board file, bytes.
const MAX_BOARD_FILE_BYTES: u64 = 64 * 1024;

/// The keys of a board file. ChArUco is not known to Kalibr; its keys are named alike.
#[derive(Deserialize)]
#[serde(tag = "target_type")]
enum BoardFile {
    #[serde(rename = "aprilgrid")]
    AprilGrid {
        #[serde(rename = "tagCols")]
        columns: usize,
        #[serde(rename = "tagRows")]
        rows: usize,
        #[serde(rename = "tagSize")]
        tag_m: f64,
        #[serde(rename = "tagSpacing")]
        spacing: f64,
    },
    #[serde(rename = "charuco")]
    Charuco {
        #[serde(rename = "squareCols")]
        columns: usize,
        #[serde(rename = "squareRows")]
        rows: usize,
        #[serde(rename = "squareSize")]
        square_m: f64,
        #[serde(rename = "markerSize")]
        marker_m: f64,
        dictionary: Dictionary,
    },
}

#[derive(Deserialize)]
enum Dictionary {
    #[serde(rename = "4x4", alias = "DICT_4X4_50", alias = "DICT_4X4_100", alias = "DICT_4X4_250")]
    Aruco4x4,
    #[serde(rename = "5x5", alias = "DICT_5X5_50", alias = "DICT_5X5_100", alias = "DICT_5X5_250")]
    Aruco5x5,
    #[serde(rename = "6x6", alias = "DICT_6X6_50", alias = "DICT_6X6_100", alias = "DICT_6X6_250")]
    Aruco6x6,
    #[serde(rename = "36h11", alias = "DICT_APRILTAG_36h11")]
    AprilTag36h11,
}

/// Loads the board of a file.
///
/// # Errors
///
/// A [`ConfigError`] that names the file and the key.
pub fn load_board(path: &Path) -> Result<Board, ConfigError> {
    let file = path.display().to_string();
    let text = plain_file::read_text(path, MAX_BOARD_FILE_BYTES)
        .map_err(|source| ConfigError::Read { file: file.clone(), source })?;
    parse_board(&text, &file)
}

/// Parses and checks the text of a board file. Error messages show `name`.
///
/// # Errors
///
/// A [`ConfigError`] that names the key.
pub fn parse_board(text: &str, name: &str) -> Result<Board, ConfigError> {
    let file = name.to_owned();
    let read: BoardFile = serde_saphyr::from_str(text).map_err(|error| ConfigError::Syntax {
        file: file.clone(),
        message: error.to_string().trim_end().to_owned(),
    })?;
    let board = match read {
        BoardFile::AprilGrid { columns, rows, tag_m, spacing } => Board::aprilgrid(columns, rows, tag_m, spacing),
        BoardFile::Charuco { columns, rows, square_m, marker_m, dictionary } => {
            let dictionary = match dictionary {
                Dictionary::Aruco4x4 => BoardDictionary::Aruco4x4,
                Dictionary::Aruco5x5 => BoardDictionary::Aruco5x5,
                Dictionary::Aruco6x6 => BoardDictionary::Aruco6x6,
                Dictionary::AprilTag36h11 => BoardDictionary::AprilTag36h11,
            };
            Board::charuco(columns, rows, square_m, marker_m, dictionary)
        }
    };
    board.map_err(|error| ConfigError::Value { file, message: error.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_file_of_kalibr_is_read() {
        let text = "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 6\ntagSize: 0.088 #m\ntagSpacing: 0.3\n";
        let board = parse_board(text, "april.yaml").expect("a board");
        assert_eq!(board, Board::aprilgrid(6, 6, 0.088, 0.3).expect("a board"));
    }

    #[test]
    fn a_charuco_board_is_read() {
        let text = "target_type: charuco\nsquareCols: 9\nsquareRows: 7\nsquareSize: 0.06\nmarkerSize: 0.045\ndictionary: DICT_4X4_50\n";
        let board = parse_board(text, "charuco.yaml").expect("a board");
        assert_eq!(board, Board::charuco(9, 7, 0.06, 0.045, BoardDictionary::Aruco4x4).expect("a board"));
    }

    #[test]
    fn an_error_of_a_board_file_names_the_file_and_the_key() {
        let refused = |text: &str| parse_board(text, "b.yaml").expect_err("refused").to_string();
        let wrong_size = refused("target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 88\ntagSpacing: 0.3\n");
        assert!(wrong_size.starts_with("b.yaml: tagSize is 88"), "{wrong_size}");
        let missing = refused("target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSpacing: 0.3\n");
        assert!(missing.starts_with("b.yaml: ") && missing.contains("tagSize"), "{missing}");
        assert!(refused("target_type: checkerboard\n").contains("checkerboard"));
    }
}
