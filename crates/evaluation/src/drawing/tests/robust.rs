//! Odd input to the drawing functions: none of it may end in a panic.

use super::*;

fn odd_points() -> Vec<DVec2> {
    let odd = [f64::NAN, f64::INFINITY, -1e300, 1e300, 0.0, 1e-300, 3.0];
    odd.into_iter().flat_map(|x| odd.map(|y| DVec2::new(x, y))).collect()
}

fn odd_poses() -> Vec<Isometry> {
    let mut poses: Vec<Isometry> = [f64::NAN, f64::INFINITY, 1e300, 1e9].map(|x| camera(x, 0.0, 30.0, 10.0)).to_vec();
    // These poses lie below, on and above the ground on the border of a line, and look straight down and up, too.
    for z in [-1.0, 0.0, 1e-300, 1e-6, 1e3] {
        for pitch in [-90.0, 0.0, 90.0, f64::NAN] {
            let pose = camera(0.025, 0.5, 10.0, pitch);
            poses.push(Isometry { translation: DVec3::new(0.025, 0.5, z), ..pose });
        }
    }
    poses
}

#[test]
fn odd_routes_make_a_map() {
    let field = field();
    let empty = field_map(&field, &[], 0, &[]);
    assert_eq!(empty.width(), 64);
    for style in [RouteStyle::Wide, RouteStyle::Thin] {
        for points in [vec![], vec![DVec2::NAN; 3], vec![DVec2::ONE], odd_points()] {
            let routes = [Route { dots: true, label: "\u{7}\u{1f916} x".repeat(500), ..route(style, points) }];
            for size in [1, 64, 333] {
                field_map(&field, &routes, size, &[String::new(), "w".repeat(5000), "a b ".repeat(2000)]);
            }
        }
    }
}

#[test]
fn a_gap_is_not_bridged() {
    let points =
        vec![DVec2::new(-1.0, 1.5), DVec2::new(-0.5, 1.5), DVec2::NAN, DVec2::new(1.5, 1.5), DVec2::splat(1.5)];
    let field = field();
    let map = field_map(&field, &[route(RouteStyle::Thin, points)], 800, &[]);
    let colour = |x: f64| {
        let at = Plot::new(&field, 800).pixel(DVec2::new(x, 1.5));
        map.get_pixel(at.x as u32, at.y as u32).0
    };
    assert_eq!(colour(-0.75), RED);
    assert_ne!(colour(0.75), RED);
}

#[test]
fn every_field_has_a_map() {
    let extreme = |length_m, width_m, line_width_m| FieldDimensions {
        length_m,
        width_m,
        line_width_m,
        border_strip_m: 0.0,
        centre_circle_diameter_m: 0.0,
        corner_arc_radius_m: None,
        goal_area: None,
        penalty_mark_from_goal_line_m: None,
        goal: None,
        ..field().dimensions().clone()
    };
    for dimensions in [extreme(1.0, 200.0, 0.005), extreme(200.0, 1.0, 0.5), extreme(200.0, 200.0, 0.005)] {
        let field = Field::new(dimensions).expect("allowed");
        let map = field_map(&field, &[route(RouteStyle::Thin, vec![DVec2::ZERO])], 300, &["caption".into()]);
        assert!(map.height() < 800);
        overlay(&RgbImage::new(640, 480), &lens("fisheye-640"), &camera(0.0, 0.0, 0.0, 20.0), &field, RED);
    }
}

#[test]
fn odd_poses_leave_a_picture() {
    let equidistant = LensModel::KannalaBrandt { k: [0.0; 4] };
    let all_around = LensParameters {
        width: 640,
        height: 480,
        fx: 60.0,
        fy: 60.0,
        cx: 320.0,
        cy: 240.0,
        model: equidistant,
        fov_deg: Some(360.0),
    };
    let field = field();
    for lens in [lens("fisheye-640"), lens("wide-640"), Lens::new(all_around).expect("good")] {
        for pose in odd_poses() {
            for (width, height) in [(640, 480), (1, 1), (0, 0), (3, 200)] {
                let drawn = overlay(&RgbImage::new(width, height), &lens, &pose, &field, RED);
                assert_eq!(drawn.dimensions(), (width, height));
            }
        }
    }
}

#[test]
fn pictures_of_all_shapes_fit_side_by_side() {
    let shapes = [(0, 0), (1, 1), (1, 5000), (5000, 1), (640, 480)];
    for a in shapes {
        for b in shapes {
            let both = side_by_side(&RgbImage::new(a.0, a.1), &RgbImage::new(b.0, b.1), &"caption ".repeat(300));
            assert!(both.width() <= 1_602 && both.height() <= 622, "{a:?} {b:?}: {:?}", both.dimensions());
        }
    }
    let both = side_by_side(&RgbImage::new(720, 590), &RgbImage::new(640, 480), "one line");
    assert!(both.width() > 1_350 && both.height() > 550, "{:?}", both.dimensions());
}
