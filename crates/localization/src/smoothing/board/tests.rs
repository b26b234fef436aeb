use super::*;
use realitysim_geometry::Board;
use realitysim_test_support::board_picture::{PrintedBoard, board_poses};

fn truth() -> LensParameters {
    let model = LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] };
    LensParameters { width: 640, height: 480, fx: 205.0, fy: 205.0, cx: 322.0, cy: 236.0, model, fov_deg: None }
}

/// A lens of which only a rough angle of view is known.
fn rough(fx: f64) -> LensParameters {
    let model = LensModel::KannalaBrandt { k: [0.0; 4] };
    LensParameters { fx, fy: fx, cx: 319.5, cy: 239.5, model, ..truth() }
}

/// Views of a board through the true lens, with corners that lie off by up to `noise_px` along each axis.
fn views(count: usize, noise_px: f64) -> Vec<BoardView> {
    let board = Board::aprilgrid(6, 6, 0.08, 0.3).expect("a board");
    let lens = Lens::new(truth()).expect("a lens");
    let printed = PrintedBoard { board, cells: [6, 6], step_m: 0.104 };
    let mut state = 1u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        noise_px * (2.0 * (state >> 11) as f64 / (1u64 << 53) as f64 - 1.0)
    };
    let view = |pose: &Isometry| {
        let seen = printed.board.corners_m.iter().zip(printed.corners(&lens, pose));
        let corners = seen.filter_map(|(point, pixel)| Some((*point, pixel? + DVec2::new(noise(), noise()))));
        BoardView { corners: corners.collect() }
    };
    let all = board_poses(DVec2::splat(0.624), count, 1.2).iter().map(view).collect::<Vec<_>>();
    all.into_iter().filter(|view| view.corners.len() >= MIN_CORNERS).collect()
}

/// Largest distance between where two lenses draw a direction, pixels, apart from a rotation.
fn largest_difference_px(lens: &LensParameters) -> f64 {
    let grid = super::super::projection::ImageGrid::new(&truth());
    let off = super::super::projection::difference_px(&truth(), lens, &grid).expect("lenses");
    off.into_iter().flatten().fold(0.0, f64::max)
}

#[test]
fn exact_corners_give_the_exact_lens_from_a_start_far_off() {
    for fx in [150.0, 205.0, 260.0] {
        let found = fit_board(&views(20, 0.0), &rough(fx)).expect("a fit");
        assert!(found.rms_px < 1e-6 && (found.lens.fx - 205.0).abs() < 1e-4, "{fx}: {:?}", found.lens);
        assert!(largest_difference_px(&found.lens) < 1e-3);
    }
}

#[test]
fn noise_moves_the_lens_by_what_its_uncertainty_says() {
    let found = fit_board(&views(30, 0.3), &rough(190.0)).expect("a fit");
    let focal = found.lens.fx / 205.0 - 1.0;
    assert!(focal.abs() < 4.0 * found.known[0] && found.known[0] < 1e-3, "{focal} {:?}", found.known);
    assert!((found.rms_px - 0.3 * (2.0f64 / 3.0).sqrt()).abs() < 0.02, "{}", found.rms_px);
    assert!(largest_difference_px(&found.lens) < 0.2);
}

#[test]
fn corners_that_were_mistaken_do_not_move_the_lens() {
    let mut views = views(20, 0.2);
    for view in &mut views {
        let count = view.corners.len();
        view.corners.iter_mut().step_by(15).for_each(|corner| corner.1 += DVec2::new(14.0, -9.0));
        assert!(count >= MIN_CORNERS);
    }
    let found = fit_board(&views, &rough(190.0)).expect("a fit");
    assert!(found.corners[1] * 16 > found.corners[0], "{:?}", found.corners);
    assert!(largest_difference_px(&found.lens) < 0.3 && found.rms_px < 0.25, "{}", found.rms_px);
}

#[test]
fn corners_on_a_line_give_no_pose() {
    let view = views(1, 0.0).remove(0);
    let corners = view.corners.into_iter().filter(|(point, _)| point.y == 0.0).cycle().take(20).collect();
    let found = fit_board(&[BoardView { corners }], &rough(190.0));
    assert!(found.is_err(), "{found:?}");
}
