//! What is seen: light, figures, worn lines.

use std::sync::OnceLock;

use glam::{DVec2, DVec3};
use proptest::prelude::*;
use realitysim::geometry::{Euler, Isometry, Lens};
use realitysim::scene::Renderer;

use super::common::{STRAIGHT, fisheye_640, image, plain, scene, straight_with as build, with_effects};

const WIDTH: usize = 640;

fn figures(list: &str) -> String {
    format!("kind = \"obstacles\"\nfigures = [{list}]")
}

/// The camera of the straight walk's first frame: at (-2.86, 0.1), 0.49 m high.
fn view() -> (Lens, Isometry) {
    let pose = build(&[]).truth(0.0).map_from_camera_link;
    (Lens::new(fisheye_640()).expect("good"), pose)
}

fn pixel(point: DVec3) -> DVec2 {
    let (lens, pose) = view();
    lens.project((pose * Isometry::link_from_optical()).inverse().transform_point(point)).expect("in view")
}

fn colour(image: &[u8], at: DVec2) -> [u8; 3] {
    let at = (at.y.round() as usize * WIDTH + at.x.round() as usize) * 3;
    [image[at], image[at + 1], image[at + 2]]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]
    #[test]
    fn even_light_multiplies_every_value(gain in 0.05..1.0f64, green in 0.3..1.0f64) {
        let light = format!("kind = \"light\"\ngain = {gain}\ncolour = [1.0, {green}, 0.8]");
        static DAY: OnceLock<Vec<u8>> = OnceLock::new();
        let (day, dusk) = (DAY.get_or_init(|| image(&build(&[]), 40)), image(&build(&[&light]), 40));
        for (at, (day, dusk)) in day.iter().zip(&dusk).enumerate() {
            let expected = f64::from(*day) * gain * [1.0, green, 0.8][at % 3];
            prop_assert!((expected - f64::from(*dusk)).abs() < 1.01, "{at}: {day} {dusk} {expected}");
        }
    }
}

#[test]
fn a_gradient_is_that_of_the_place_on_the_field() {
    let (day, slope) = (build(&[]), build(&["kind = \"light\"\ngain = 0.7\ngradient_per_m = [0.1, -0.2]"]));
    let (day, slope) = (image(&day, 0), image(&slope, 0));
    for (x, y) in [(-1.5, 0.3), (0.0, 0.0), (-1.0, 1.2), (0.5, -0.8)] {
        let at = pixel(DVec3::new(x, y, 0.0));
        let expected = 0.7 * (1.0 + 0.1 * x - 0.2 * y);
        for (before, after) in colour(&day, at).into_iter().zip(colour(&slope, at)) {
            let error = f64::from(after) - expected * f64::from(before);
            // Half a pixel is some centimetres, half a value comes from rounding twice.
            assert!(error.abs() < 1.6, "({x}, {y}): {before} {after} {expected}");
        }
    }
}

#[test]
fn a_camera_gain_shows_the_same_picture_with_more_noise() {
    let noise = "kind = \"sensor_noise\"\nread_noise_dn = 1.5\nshot_noise_factor = 0.15";
    let deviation = |light: &[&str]| {
        let (quiet, loud) = (image(&build(light), 3), image(&build(&[light, &[noise]].concat()), 3));
        let squares = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
        let seen: Vec<_> = quiet.iter().zip(&loud).filter(|(a, _)| (20..=200).contains(*a)).collect();
        (seen.iter().map(|pair| squares(*pair)).sum::<f64>() / seen.len() as f64).sqrt()
    };
    let amplifying = "kind = \"light\"\ngain = 0.125\ncamera_gain = 8.0";
    let (day, amplified) = (deviation(&[]), deviation(&[amplifying]));
    assert!(amplified > 4.0 * day, "{day} {amplified}");
    assert_eq!(image(&build(&[]), 3), image(&build(&[amplifying]), 3));
}

/// Rows of pixels that a cylinder changes, and the columns of its silhouette there.
#[test]
fn a_cylinder_stands_where_the_lens_says() {
    for (x, y, width, height) in [(-1.6, 0.3, 0.3, 0.8), (-0.5, -0.6, 0.25, 0.7), (1.5, 1.0, 0.5, 1.6)] {
        let list = format!(
            "{{ shape = \"cylinder\", position_m = [{x:?}, {y:?}], width_m = {width:?}, height_m = {height:?}, \
             colour = [255, 0, 255] }}"
        );
        let picture = image(&build(&[&figures(&list)]), 0);
        let (_, camera) = view();
        let centre = DVec2::new(x, y);
        let from = camera.translation.truncate();
        let away = centre - from;
        let (distance, radius) = (away.length(), width / 2.0);
        // Where rays touch the cylinder: nearer than its axis by r^2 / d, sideways by r sqrt(1 - (r/d)^2).
        let ahead = away / distance;
        let side = DVec2::new(-ahead.y, ahead.x);
        let touch = |sign: f64| {
            let share = radius / distance;
            centre - ahead * radius * share + side * (sign * radius * (1.0 - share * share).sqrt())
        };
        for z in [0.3 * height, 0.5 * height, 0.7 * height] {
            let [left, right] = [touch(1.0), touch(-1.0)].map(|point| pixel(point.extend(z)));
            // The silhouette is nearly upright at mid-height: cut along the row of its middle.
            let row = ((left.y + right.y) / 2.0).round() as usize;
            let violet = |column: usize| {
                let [r, g, b] = colour(&picture, DVec2::new(column as f64, row as f64));
                f64::from(r.min(b).saturating_sub(g)) / 160.0
            };
            let columns = (left.x - 6.0) as usize..(right.x + 6.0) as usize;
            let area: f64 = columns.clone().map(|column| violet(column).min(1.0)).sum();
            let solid = columns.filter(|column| violet(*column) > 0.5).collect::<Vec<_>>();
            let (first, last) = (solid[0] as f64, solid[solid.len() - 1] as f64);
            let tilt = (left.y - right.y).abs();
            assert!(
                (first - left.x).abs() < 1.5 + tilt && (last - right.x).abs() < 1.5 + tilt,
                "{left} {right} {solid:?}"
            );
            assert!((area - (right.x - left.x)).abs() < 0.2 * (right.x - left.x) + 1.0, "{area} {left} {right}");
        }
    }
}

#[test]
fn the_nearer_figure_hides_the_farther_one_in_any_order() {
    let [red, blue] = [(-1.8, "[255, 0, 0]"), (-1.0, "[0, 0, 255]")].map(|(x, colour)| {
        format!("{{ shape = \"box\", position_m = [{x:?}, 0.1], yaw_deg = 20, height_m = 0.7, colour = {colour} }}")
    });
    let [forth, back] =
        [format!("{red}, {blue}"), format!("{blue}, {red}")].map(|list| image(&build(&[&figures(&list)]), 0));
    assert_eq!(forth, back);
    let [r, g, b] = colour(&forth, pixel(DVec3::new(-1.8, 0.1, 0.4)));
    assert!(r > 100 && g < 30 && b < 30, "{r} {g} {b}");
    let alone = image(&build(&[&figures(&blue)]), 0);
    let [r, g, b] = colour(&alone, pixel(DVec3::new(-1.8, 0.1, 0.4)));
    assert!(r < 30 && g < 30 && b > 100, "{r} {g} {b}");
}

#[test]
fn what_nobody_stands_before_keeps_its_bits() {
    let base = image(&build(&[]), 0);
    let behind = figures("{ shape = \"person\", position_m = [-6.5, 0.1] }");
    assert_eq!(image(&build(&[&behind]), 0), base);
    let ahead = image(&build(&[&figures("{ shape = \"person\", position_m = [0.0, -1.0] }")]), 0);
    let body = [0.0, 0.9, 1.75].map(|z| pixel(DVec3::new(0.0, -1.0, z)));
    let (mut changed, mut kept) = (0, 0);
    for (at, (a, b)) in base.chunks_exact(3).zip(ahead.chunks_exact(3)).enumerate() {
        let here = DVec2::new((at % WIDTH) as f64, (at / WIDTH) as f64);
        let near = body.iter().any(|part| part.distance(here) < 60.0);
        assert!(near || a == b, "{here}");
        if a == b { kept += 1 } else { changed += 1 }
    }
    assert!(changed > 1000 && kept > 250_000, "{changed} {kept}");
}

#[test]
fn figures_walk_to_and_fro() {
    let walker = figures(
        "{ shape = \"cylinder\", path = [[-1.0, -1.0], [-1.0, 1.0]], speed_m_s = 0.5, colour = [255, 0, 255] }",
    );
    let renderer = Renderer::new(&build(&[&walker]));
    let (_, pose) = view();
    let mut pixels = Vec::new();
    // The path takes 4 s in each direction; the camera stands.
    for (index, y) in [(0, -1.0), (10, -0.5), (30, 0.5), (40, 1.0), (60, 0.0), (80, -1.0), (90, -0.5)] {
        renderer.render_from(&pose, index, &mut pixels);
        let [r, g, b] = colour(&pixels, pixel(DVec3::new(-1.0, y, 0.3)));
        assert!(r > 100 && g < 30 && b > 100, "frame {index}: {r} {g} {b}");
    }
}

#[test]
fn whoever_is_drawn_from_the_seed_keeps_out_of_the_way() {
    for seed in 1..5 {
        let toml = plain(STRAIGHT).replace("seed = 20130601", &format!("seed = {seed}"));
        let crowd = scene(&with_effects(&toml, &["kind = \"obstacles\"\nrandom = 12"]));
        let empty = scene(&toml);
        let [crowd, empty] = [&crowd, &empty].map(Renderer::new);
        let (mut with, mut without) = (Vec::new(), Vec::new());
        let scene = scene(&toml);
        for index in (0..230).step_by(23) {
            // Straight down onto the robot's own place: nobody stands there.
            let truth = scene.truth(scene.frame_time_s(index)).map_from_base_footprint;
            let down =
                Isometry::from_euler(Euler { pitch: 1.57, ..Euler::default() }, DVec3::new(truth.x, truth.y, 0.3));
            crowd.render_from(&down, index, &mut with);
            empty.render_from(&down, index, &mut without);
            let middle = (236 * WIDTH + 322) * 3;
            let near = |row: i32, column: i32| (middle as i32 + (row * WIDTH as i32 + column) * 3) as usize;
            for (row, column) in [(0, 0), (100, 0), (-100, 0), (0, 100), (0, -100)] {
                let at = near(row, column);
                assert_eq!(with[at..at + 3], without[at..at + 3], "seed {seed}, frame {index}");
            }
        }
    }
}

#[test]
fn worn_lines_are_fainter_and_nothing_else_changes() {
    let (new, worn) = (build(&[]), build(&["kind = \"worn_lines\"\nshare = 0.5\npatch_m = 0.3"]));
    let (new, worn) = (image(&new, 60), image(&worn, 60));
    let light = |pixel: &[u8]| i32::from(pixel[0]) + i32::from(pixel[2]);
    let (mut gone, mut paint) = (0.0, 0.0);
    for (new, worn) in new.chunks_exact(3).zip(worn.chunks_exact(3)) {
        if new != worn {
            assert!(light(worn) <= light(new), "{new:?} {worn:?}");
            gone += f64::from(light(new) - light(worn));
            paint += f64::from(light(new) - 128);
        }
    }
    assert!(paint > 1e5 && (0.35..0.65).contains(&(gone / paint)), "{gone} of {paint}");
}

#[test]
fn no_camera_among_figures_is_harmed() {
    let scene = build(&[&figures(
        "{ shape = \"person\", position_m = [-1.0, 0.0] }, { shape = \"robot\", position_m = [-0.7, 0.0] }, \
         { shape = \"box\", position_m = [0.0, 0.0], width_m = 1.5 }, { shape = \"cylinder\", position_m = [1.0, 0.0] }",
    )]);
    let renderer = Renderer::new(&scene);
    let mut pixels = Vec::new();
    for place in [DVec3::new(-1.0, 0.0, 1.2), DVec3::new(-0.7, 0.0, 0.3), DVec3::ZERO, DVec3::splat(1e9), DVec3::NAN] {
        for angle in [0.0, 1.57, -3.0, f64::NAN] {
            let pose = Isometry::from_euler(Euler { yaw: angle, pitch: angle, roll: -angle }, place);
            renderer.render_from(&pose, 5, &mut pixels);
            assert_eq!(pixels.len(), WIDTH * 480 * 3);
        }
    }
}
