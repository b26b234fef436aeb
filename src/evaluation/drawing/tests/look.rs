//! Pictures to look at: `cargo test --lib drawing -- --ignored` writes them to `target/drawing`.

use std::path::Path;

use image::imageops::FilterType;

use super::*;
use crate::scene::{Renderer, Scene, SceneFile};

const TRUTH: [u8; 3] = [255, 225, 90];
const TAGS: [u8; 3] = [200, 30, 50];
const ODOMETRY: [u8; 3] = [40, 70, 190];

fn save(name: &str, image: &RgbImage) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/drawing");
    std::fs::create_dir_all(&folder).expect("a folder");
    image.save(folder.join(name)).expect("a file");
}

/// Wobbles of a few centimetres around the way, with every tenth tag missing.
fn tagged(truth: &[DVec2]) -> Vec<DVec2> {
    let wobble = |i: f64| DVec2::new(libm::sin(i * 0.31) + libm::sin(i * 1.7), libm::cos(i * 0.23)) * 0.02;
    let tag = |(i, point): (usize, &DVec2)| if i % 40 > 35 { DVec2::NAN } else { *point + wobble(i as f64) };
    truth.iter().enumerate().map(tag).collect()
}

fn drifted(truth: &[DVec2]) -> Vec<DVec2> {
    truth.iter().enumerate().map(|(i, point)| *point + DVec2::new(0.002, -0.003) * i as f64).collect()
}

fn routes(truth: Vec<DVec2>) -> Vec<Route> {
    let (tags, odometry) = (tagged(&truth), drifted(&truth));
    let route = |label: &str, colour, style, points, dots| Route { label: label.into(), colour, points, style, dots };
    vec![
        route("true route", TRUTH, RouteStyle::Wide, truth, false),
        route("odometry alone", ODOMETRY, RouteStyle::Thin, odometry, false),
        route("tags", TAGS, RouteStyle::Thin, tags, true),
    ]
}

#[test]
#[ignore = "writes pictures for people"]
fn pictures_of_shipped_scenes() {
    let caption = ["mean 2.5 cm, p95 5.5 cm, 231 of 231 tagged".to_owned()];
    for (name, lens_name, frame) in [
        ("demo", "fisheye-640", 20),
        ("demo", "fisheye-1280", 55),
        ("demo", "wide-640", 0),
        ("loop", "fisheye-640", 60),
    ] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("replay/scenes/{name}.toml"));
        let file = SceneFile::from_toml(&std::fs::read_to_string(path).expect("shipped")).expect("good");
        let dimensions = load_field(&file.scene.field).expect("shipped");
        let lens = lens(lens_name);
        let scene = Scene::build(file, dimensions, lens.parameters().clone()).expect("good");
        let mut pixels = Vec::new();
        Renderer::new(&scene).render(frame, &mut pixels);
        let image = RgbImage::from_raw(lens.width(), lens.height(), pixels).expect("its size");
        let pose = scene.truth(scene.frame_time_s(frame)).map_from_camera_link;
        let drawn = overlay(&image, &lens, &pose, scene.field(), [255, 40, 120]);
        let at = |index| {
            let Pose2 { x, y, .. } = scene.truth(scene.frame_time_s(index)).map_from_base_footprint;
            DVec2::new(x, y)
        };
        let routes = routes((0..scene.frame_count()).map(at).collect());
        let map = field_map(scene.field(), &routes, 720, &caption);
        let both = side_by_side(
            &map,
            &drawn,
            "Left: the route as tagged. Right: one frame with the field's lines projected at its tag's pose.",
        );
        save(&format!("{name}-{lens_name}-overlay.png"), &drawn);
        let (w, h) = (lens.width(), lens.height());
        let part = image::imageops::crop_imm(&drawn, w * 5 / 8, h * 3 / 8, w / 4, h / 5).to_image();
        let zoomed = image::imageops::resize(&part, 1280, h / 5 * 4 * 1280 / w, FilterType::Nearest);
        save(&format!("{name}-{lens_name}-zoom.png"), &zoomed);
        save(&format!("{name}-{lens_name}-both.png"), &both);
        save(&format!("{name}-map.png"), &field_map(scene.field(), &routes, 1000, &caption));
    }
}

#[test]
#[ignore = "writes pictures for people"]
fn maps_of_all_fields() {
    for name in crate::config::field_names() {
        let field = Field::new(load_field(&name).expect("shipped")).expect("checked");
        let way = (0..200).map(|i| DVec2::from_angle(f64::from(i) * 0.025) * 1.6 + DVec2::new(0.5, 0.2)).collect();
        save(&format!("field-{name}.png"), &field_map(&field, &routes(way), 800, &[field.dimensions().title.clone()]));
    }
}
