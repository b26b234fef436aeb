//! A lens calibrated by pictures of a board, drawn through a lens that is known.

use std::process::Command;

use glam::DVec2;
use realitysim::config::load_lens;
use realitysim::geometry::{Board, BoardDictionary, Isometry, Lens, LensModel, LensParameters};
use realitysim::localization::smoothing::projection::{ImageGrid, difference_px};
use realitysim::vision::Picture;
use realitysim::vision::board::find_corners;
use realitysim_test_support::board_picture::{PrintedBoard, board_poses};

use super::support::Room;

const INTERPRETER: &str = "REALITYSIM_PYTHON";
const APRILGRID: &str = "target_type: aprilgrid\ntagCols: 6\ntagRows: 6\ntagSize: 0.08\ntagSpacing: 0.3\n";

fn truth() -> LensParameters {
    let model = LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] };
    LensParameters { width: 640, height: 480, fx: 205.0, fy: 205.0, cx: 322.0, cy: 236.0, model, fov_deg: None }
}

fn aprilgrid() -> PrintedBoard {
    let board = Board::aprilgrid(6, 6, 0.08, 0.3).expect("a board");
    PrintedBoard { board, cells: [6, 6], step_m: 0.104 }
}

/// Writes pictures of a board into the folder `pictures`.
fn draw(room: &Room, printed: &PrintedBoard, poses: &[Isometry]) {
    let lens = Lens::new(truth()).expect("a lens");
    std::fs::create_dir(room.path("pictures")).expect("a folder");
    for (number, pose) in poses.iter().enumerate() {
        let picture =
            image::GrayImage::from_raw(640, 480, printed.draw(&lens, pose, number as u64 + 1)).expect("pixels");
        picture.save(room.path(&format!("pictures/{number:02}.png"))).expect("saved");
    }
}

#[test]
fn pictures_of_an_aprilgrid_give_the_lens_from_its_angle_of_view() {
    let room = Room::new();
    draw(&room, &aprilgrid(), &board_poses(DVec2::splat(0.624), 14, 1.3));
    room.write("april.yaml", APRILGRID);
    let run = room.run("calibrate --board april.yaml pictures --lens equidistant:170deg -o found --json").succeeds();
    let report = run.json();
    let number = |path: &str| report.pointer(path).and_then(serde_json::Value::as_f64).expect("a number");
    assert!(number("/rms_px") < 0.25 && number("/cross_validation/p95_px") < 0.3, "{report:#}");
    assert!(
        number("/pictures/2") > 10.0 && report["not_determined"].as_array().is_some_and(Vec::is_empty),
        "{report:#}"
    );
    let lens = load_lens(&room.path("found/lens.toml").display().to_string()).expect("a lens file").lens;
    let off = difference_px(&truth(), lens.parameters(), &ImageGrid::new(&truth())).expect("lenses");
    let mut off: Vec<f64> = off.into_iter().flatten().collect();
    off.sort_by(f64::total_cmp);
    assert!(off[off.len() * 95 / 100] < 0.3, "{off:?}");
    let words = std::fs::read_to_string(room.path("found/report.txt")).expect("a report");
    assert!(words.contains("larger or smaller than its file says"), "{words}");
}

#[test]
fn a_board_that_is_nowhere_or_has_another_spacing_is_refused() {
    let room = Room::new();
    draw(&room, &aprilgrid(), &board_poses(DVec2::splat(0.624), 8, 0.9));
    room.write("april.yaml", APRILGRID.replace("0.3", "0.36"));
    room.run("calibrate --board april.yaml pictures --lens equidistant:180deg -o found").fails(1, &["tagSpacing"]);
    room.write(
        "other.yaml",
        "target_type: charuco\nsquareCols: 9\nsquareRows: 9\nsquareSize: 0.06\nmarkerSize: 0.045\ndictionary: 4x4\n",
    );
    let refused = ["the board was found in 0 of 8 pictures"];
    room.run("calibrate --board other.yaml pictures --lens equidistant:180deg -o found").fails(1, &refused);
    room.run("calibrate --board other.yaml pictures -o found").fails(2, &["--lens is missing"]);
    assert!(!room.path("found").exists());
}

/// OpenCV draws and reads the same markers. Skipped without `REALITYSIM_PYTHON`, a Python with OpenCV.
#[test]
fn opencv_reads_the_tags_that_are_drawn_where_the_corners_are_found() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let room = Room::new();
    let (printed, lens) = (aprilgrid(), Lens::new(truth()).expect("a lens"));
    let poses = board_poses(DVec2::splat(0.624), 3, 0.5);
    draw(&room, &printed, &poses);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/detect_with_opencv.py");
    let output = Command::new(python).arg(script).arg(room.path("pictures")).output().expect("started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let theirs: Vec<Vec<(usize, [[f64; 2]; 4])>> = serde_json::from_slice(&output.stdout).expect("JSON");
    let (mut beside_truth, mut beside_ours) = (Vec::new(), Vec::new());
    for ((number, pose), theirs) in poses.iter().enumerate().zip(theirs) {
        let truth = printed.corners(&lens, pose);
        let pixels = printed.draw(&lens, pose, number as u64 + 1);
        let ours = find_corners(&Picture::from_gray(640, 480, pixels).expect("a picture"), &printed.board);
        for (id, found) in theirs {
            // OpenCV's first corner is the one that Kalibr prints at the lower right.
            for (corner, found) in found.into_iter().enumerate() {
                let (number, found) = (printed.board.markers[id].corners[(corner + 2) % 4], DVec2::from_array(found));
                beside_truth.push(truth[number].expect("in view").distance(found));
                beside_ours
                    .extend(ours.iter().find(|ours| ours.number == number).map(|ours| ours.pixel.distance(found)));
            }
        }
    }
    for off in [&mut beside_truth, &mut beside_ours] {
        off.sort_by(f64::total_cmp);
        assert!(off.len() > 150 && off[off.len() * 9 / 10] < 0.3, "{} corners: {off:?}", off.len());
    }
}

/// The codes of ChArUco boards are those of OpenCV. Skipped without `REALITYSIM_PYTHON`.
#[test]
fn the_codes_of_charuco_boards_are_those_of_opencv() {
    let Some(python) = std::env::var_os(INTERPRETER) else {
        println!("skipped: {INTERPRETER} names no interpreter");
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/replay/detect_with_opencv.py");
    let output = Command::new(python).arg(script).output().expect("started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let theirs: Vec<Vec<(usize, u64)>> = serde_json::from_slice(&output.stdout).expect("JSON");
    let dictionaries = [BoardDictionary::Aruco4x4, BoardDictionary::Aruco5x5, BoardDictionary::Aruco6x6];
    for (dictionary, theirs) in dictionaries.into_iter().zip(theirs) {
        let board = Board::charuco(9, 7, 0.06, 0.045, dictionary).expect("a board");
        let ours: Vec<u64> = board.markers.iter().map(|marker| marker.code).collect();
        let theirs: Vec<u64> = theirs.into_iter().map(|(_, code)| code).collect();
        assert_eq!(ours, theirs, "{dictionary:?}");
    }
}
