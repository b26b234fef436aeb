use super::*;
use realitysim_geometry::{BoardDictionary, Isometry, Lens, LensModel, LensParameters};
use realitysim_test_support::board_picture::{PrintedBoard, board_poses};

fn fisheye() -> Lens {
    let model = LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] };
    let parameters =
        LensParameters { width: 640, height: 480, fx: 205.0, fy: 205.0, cx: 322.0, cy: 236.0, model, fov_deg: None };
    Lens::new(parameters).expect("a lens")
}

fn aprilgrid() -> PrintedBoard {
    let board = Board::aprilgrid(6, 6, 0.08, 0.3).expect("a board");
    PrintedBoard { board, cells: [6, 6], step_m: 0.104 }
}

fn charuco() -> PrintedBoard {
    let board = Board::charuco(9, 9, 0.06, 0.045, BoardDictionary::Aruco4x4).expect("a board");
    PrintedBoard { board, cells: [9, 9], step_m: 0.06 }
}

/// Pixels between the corners found and the true ones, and the share of the corners in view that were found.
fn found(printed: &PrintedBoard, pose: &Isometry, seed: u64) -> (Vec<f64>, f64) {
    let lens = fisheye();
    let picture = Picture::from_gray(640, 480, printed.draw(&lens, pose, seed)).expect("a picture");
    let truth = printed.corners(&lens, pose);
    let off = |corner: &BoardCorner| corner.pixel.distance(truth[corner.number].unwrap_or(DVec2::INFINITY));
    let offs: Vec<f64> = find_corners(&picture, &printed.board).iter().map(off).collect();
    let share = offs.len() as f64 / truth.iter().flatten().count() as f64;
    (offs, share)
}

/// Checks the root mean square and the largest error, pixels, and the share of the corners that are found.
fn check(printed: &PrintedBoard, size_m: f64, [most_rms, most, least_share]: [f64; 3]) {
    let (mut all, mut shares) = (Vec::new(), Vec::new());
    for (seed, pose) in board_poses(DVec2::splat(size_m), 6, 1.2).iter().enumerate() {
        let (offs, share) = found(printed, pose, seed as u64 + 1);
        all.extend(offs);
        shares.push(share);
    }
    let rms = (all.iter().map(|off| off * off).sum::<f64>() / all.len() as f64).sqrt();
    let share = shares.iter().sum::<f64>() / shares.len() as f64;
    let worst = all.iter().copied().fold(0.0, f64::max);
    let is_good = rms < most_rms && worst < most && share > least_share;
    assert!(is_good, "rms {rms}, worst {worst}, share {share}: {shares:?}");
}

#[test]
fn the_corners_of_an_aprilgrid_are_found_all_over_a_fisheye() {
    check(&aprilgrid(), 0.624, [0.1, 0.5, 0.8]);
}

#[test]
fn the_corners_of_a_charuco_board_are_found_all_over_a_fisheye() {
    check(&charuco(), 0.54, [0.2, 1.5, 0.5]);
}

#[test]
fn noise_and_plain_pictures_have_no_board() {
    let mut noise = 1u32;
    let random = (0..640 * 480).map(|_| {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (noise >> 24) as u8
    });
    let random = Picture::from_gray(640, 480, random.collect()).expect("a picture");
    let plain = Picture::from_gray(640, 480, vec![90; 640 * 480]).expect("a picture");
    let tiny = Picture::from_gray(3, 3, vec![90; 9]).expect("a picture");
    for picture in [random, plain, tiny] {
        assert_eq!(find_corners(&picture, &aprilgrid().board), []);
    }
}
