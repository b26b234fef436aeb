use super::overlay::outline;
use super::plot::Plot;
use super::*;
use glam::DVec3;
use image::{Rgb, RgbImage};
use realitysim_config::{load_field, load_lens};
use realitysim_geometry::{Euler, Field, FieldDimensions, Isometry, Lens, LensModel, LensParameters};

mod robust;

const BLACK: [u8; 3] = [0; 3];
const RED: [u8; 3] = [230, 20, 60];

fn field() -> Field {
    Field::new(load_field("kid-2009").expect("shipped")).expect("checked")
}

fn lens(name: &str) -> Lens {
    load_lens(name).expect("shipped").lens
}

/// Returns a pose half a metre above the ground, looking down by `pitch_deg`.
fn camera(x: f64, y: f64, yaw_deg: f64, pitch_deg: f64) -> Isometry {
    let euler = Euler { yaw: yaw_deg.to_radians(), pitch: pitch_deg.to_radians(), roll: 0.05 };
    Isometry::from_euler(euler, DVec3::new(x, y, 0.5))
}

fn route(style: RouteStyle, points: Vec<DVec2>) -> Route {
    Route { label: "tags".into(), colour: RED, points, style, dots: false }
}

fn project(lens: &Lens, pose: &Isometry, ground: DVec2) -> Option<DVec2> {
    lens.project((*pose * Isometry::link_from_optical()).inverse().transform_point(ground.extend(0.0)))
}

/// A pose half a metre above the ground in a corner of a field with corner arcs.
fn in_a_corner_with_an_arc() -> (Field, Isometry) {
    let field = Field::new(load_field("hsl-middle-2026").expect("shipped")).expect("checked");
    (field, camera(5.9, 3.4, 50.0, 20.0))
}

#[test]
fn the_overlay_lies_on_the_projected_borders_of_the_paint() {
    let (with_arcs, in_corner) = in_a_corner_with_an_arc();
    let cases = [(field(), camera(-1.0, -0.7, 20.0, 20.0), 400), (with_arcs, in_corner, 3200)];
    for (field, pose, points) in cases {
        for lens in ["fisheye-640", "fisheye-1280", "wide-640"].map(lens) {
            let drawn = overlay(&RgbImage::new(lens.width(), lens.height()), &lens, &pose, &field, RED);
            let mut seen = 0;
            for point in field.points(points) {
                for side in [-0.5, 0.5] {
                    let border = point.position + point.normal * (side * field.line_width());
                    // There is no border inside of a crossing line.
                    if field.distance_to_centre_line(border) < 0.499 * field.line_width() {
                        continue;
                    }
                    let Some(pixel) = project(&lens, &pose, border).filter(|pixel| lens.contains(*pixel)) else {
                        continue;
                    };
                    // The strongest of the four pixels around counts: an antialiased line spreads over them.
                    let (u, v) = (pixel.x as u32, pixel.y as u32);
                    let around = [(u, v), (u + 1, v), (u, v + 1), (u + 1, v + 1)];
                    let around = around.iter().filter_map(|(u, v)| drawn.get_pixel_checked(*u, *v));
                    let red = around.map(|pixel| pixel.0[0]).max().unwrap_or(0);
                    assert!(red > 80, "{border} at {pixel}: {red}");
                    seen += 1;
                }
            }
            assert!(seen > 150, "only {seen}");
        }
    }
}

#[test]
fn nothing_is_drawn_elsewhere() {
    let lens = lens("fisheye-640");
    for (field, pose) in [(field(), camera(-1.0, -0.7, 20.0, 20.0)), in_a_corner_with_an_arc()] {
        let drawn = overlay(&RgbImage::new(640, 480), &lens, &pose, &field, RED);
        let map_from_optical = pose * Isometry::link_from_optical();
        for (u, v, pixel) in drawn.enumerate_pixels().filter(|(_, _, pixel)| pixel.0 != BLACK) {
            // Half the width of a line may lie beyond the rim of the view.
            let Some(ray) = lens.unproject(DVec2::new(f64::from(u), f64::from(v))) else { continue };
            let ray = map_from_optical.transform_vector(ray);
            // Towards the horizon a pixel covers too much ground to judge.
            if ray.z < -0.15 {
                let ground = pose.translation - ray * (pose.translation.z / ray.z);
                let off = field.distance_to_centre_line(ground.truncate()) - field.line_width() / 2.0;
                let pixel_size = pose.translation.z / (ray.z * ray.z) / lens.focal();
                assert!(off.abs() < 2.0 * pixel_size + 0.011, "{u} {v} {pixel:?}: {off} m off");
            }
        }
    }
}

#[test]
fn the_map_shows_corner_arcs() {
    let (field, _) = in_a_corner_with_an_arc();
    let plot = Plot::new(&field, 1400);
    let map = field_map(&field, &[], 1400, &[]);
    let white = |at: DVec2| {
        let at = plot.pixel(at);
        map.get_pixel(at.x as u32, at.y as u32).0.iter().all(|value| *value > 240)
    };
    let corner = DVec2::new(6.975, 4.475);
    for signs in [DVec2::new(1.0, 1.0), DVec2::new(-1.0, 1.0), DVec2::new(-1.0, -1.0), DVec2::new(1.0, -1.0)] {
        for angle in [0.3, 0.8, 1.3] {
            let inwards = -DVec2::from_angle(angle);
            assert!(white((corner + inwards * 0.45) * signs), "{signs} {angle}");
            assert!(!white((corner + inwards * 0.37) * signs) && !white((corner + inwards * 0.53) * signs));
            assert!(!white((corner - inwards * 0.45) * signs), "outside of the field");
        }
    }
}

#[test]
fn curves_stay_curves_and_breaks_are_breaks() {
    let (lens, pose) = (lens("fisheye-640"), camera(0.3, 0.1, 0.0, 0.0));
    let lines = outline(DVec2::new(640.0, 480.0), &lens, &pose, &field());
    for line in &lines {
        for pair in line.windows(2) {
            assert!(pair[0].distance(pair[1]) <= 4.6, "{pair:?}");
        }
    }
    // Some visible parts of the field are more than 90 degrees off the optical axis.
    let behind = DVec2::new(0.0, 1.9);
    let pixel = project(&lens, &pose, behind + DVec2::X * 0.025).expect("in view") + 0.5;
    assert!(pose.inverse().transform_point(behind.extend(0.0)).x < 0.0);
    let nearest = lines.iter().flatten().map(|point| point.distance(pixel)).fold(f64::INFINITY, f64::min);
    assert!(nearest < 4.0, "{nearest} px");
}

#[test]
fn the_map_is_to_scale() {
    let field = field();
    let plot = Plot::new(&field, 1000);
    let map = field_map(&field, &[], 1000, &[]);
    assert_eq!(map.width(), 1000);
    let white = |x: f64, y: f64| {
        let at = plot.pixel(DVec2::new(x, y));
        map.get_pixel(at.x as u32, at.y as u32).0.iter().all(|value| *value > 240)
    };
    for (x, y) in [(0.0, 1.0), (2.99, 1.5), (-3.01, -1.5), (1.0, 1.99), (0.6, 0.0), (1.2, 0.04), (-2.4, 1.0)] {
        assert!(white(x, y) && !white(x + 0.06, y + 0.06), "{x} {y}");
    }
    // The corner is filled, and the halfway line is as wide as painted.
    assert!(white(3.015, 2.015) && white(-3.015, -2.015) && !white(3.04, 2.04));
    let across = (0..1000).filter(|step| white(-0.5 + f64::from(*step) / 1000.0, 1.0)).count() as f64 / 1000.0;
    assert!((across - 0.05).abs() < 1.5 / plot.pixels_per_metre, "{across} m");
    // x points to the right, y up, and the centre of the field is in the middle.
    let tag = field_map(&field, &[route(RouteStyle::Thin, vec![DVec2::new(2.0, 1.0)])], 1000, &[]);
    let at = plot.pixel(DVec2::new(2.0, 1.0)) + DVec2::new(routes::START_RADIUS * plot.text_size, 0.0);
    assert_eq!(tag.get_pixel(at.x as u32, at.y as u32).0, RED);
    assert!(at.x > 500.0 && at.y < plot.pixel(DVec2::ZERO).y);
}

#[test]
fn the_tagged_route_lies_on_top_of_the_true_one() {
    let line = |x: f64| vec![DVec2::new(x, -1.0), DVec2::new(x, 1.0)];
    let truth = Route { colour: [0, 0, 255], ..route(RouteStyle::Wide, line(1.0)) };
    let field = field();
    let at = Plot::new(&field, 800).pixel(DVec2::new(1.0, 0.5));
    for routes in [[truth.clone(), route(RouteStyle::Thin, line(1.0))], [route(RouteStyle::Thin, line(1.0)), truth]] {
        let map = field_map(&field, &routes, 800, &[]);
        assert_eq!(map.get_pixel(at.x as u32, at.y as u32).0, RED);
        let Rgb([r, g, b]) = *map.get_pixel(at.x as u32 + 3, at.y as u32);
        assert!(b > g && b > r, "the wide one shows beside it: {r} {g} {b}");
    }
}
