//! A lens that darkens its images towards their border is noticed when they are added to a database.

use std::fs;

use glam::DVec3;
use realitysim::config::load_field;
use realitysim::database::{Contents, ImageDatabase, ViewQuery};
use realitysim::evaluation::views::TruthRenderer;
use realitysim::geometry::{Euler, Field, Isometry, Lens, LensModel, LensParameters};
use realitysim::views::{Camera, Method, SURE, Vignetting, similarity};

use super::database::{CAMERA_INFO, POSES, open, walked};
use super::support::Room;

/// As in the camera's file.
fn lens() -> Lens {
    let model = LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] };
    let parameters =
        LensParameters { width: 320, height: 240, fx: 102.5, fy: 102.5, cx: 160.75, cy: 117.75, model, fov_deg: None };
    Lens::new(parameters).expect("a lens")
}

fn pose([x, y, yaw_deg]: [f64; 3]) -> Isometry {
    let euler = Euler { yaw: yaw_deg.to_radians(), pitch: 0.5, roll: 0.0 };
    Isometry::from_euler(euler, DVec3::new(x, y, 0.55))
}

/// A lawn as a lens with this darkening shows it.
fn picture(lawn: &TruthRenderer, camera: &Camera, place: [f64; 3], dark: &Vignetting) -> (image::RgbImage, Vec<bool>) {
    let (raster, ground) = lawn.render(&pose(place));
    let picture = image::RgbImage::from_fn(320, 240, |u, v| {
        let light = dark.at(camera.lens(), f64::from(u), f64::from(v));
        let [r, g, b, _] = raster.pixels[(v * 320 + u) as usize];
        image::Rgb([r, g, b].map(|value| (f64::from(value) * light).round() as u8))
    });
    (picture, ground)
}

#[test]
fn a_lens_that_darkens_is_measured_and_its_views_are_the_better_for_it() {
    let (room, lens) = (Room::new(), lens());
    let field = Field::new(load_field("kid-2009").expect("shipped")).expect("a field");
    let (lawn, camera, dark) =
        (TruthRenderer::new(&field, &lens, false), Camera::new(&lens), Vignetting { k: [-0.45, 0.08, 0.0] });
    let places: Vec<[f64; 3]> = (0..14)
        .map(|i| {
            let part = |step: f64| ((f64::from(i) + 0.5) * step).fract();
            [0.9 * (part(0.618_034) - 0.5), 0.9 * (part(0.754_878) - 0.5), 35.0 * f64::from(i % 4) - 50.0]
        })
        .collect();
    fs::create_dir(room.path("images")).expect("a folder");
    room.write("images/camera_info.yaml", CAMERA_INFO);
    let mut table = POSES.to_owned();
    for (number, place) in places.iter().enumerate() {
        let (picture, _) = picture(&lawn, &camera, *place, &dark);
        picture.save(room.path(&format!("images/{number}.png"))).expect("saved");
        let [x, y, yaw] = *place;
        table.push_str(&format!("{number}.png,{x},{y},0.55,{yaw},{},0\n", 0.5f64.to_degrees()));
    }
    room.write("images/poses.csv", table);
    room.run("db add images --db db --field kid-2009").succeeds();
    let contents = Contents::read(&room.path("db")).expect("written");
    let found = Vignetting { k: contents.sources[0].darkening.expect("it shows") };
    for (u, v) in [(160.0, 120.0), (230.0, 160.0), (60.0, 200.0), (300.0, 200.0)] {
        let [found, wanted] = [found, dark].map(|vignetting| vignetting.at(&lens, u, v));
        assert!((found - wanted).abs() < 0.03, "at {u}, {v}: {found} for {wanted}");
    }

    let wanted = [0.05, 0.1, -5.0];
    let (truth, ground) = picture(&lawn, &camera, wanted, &dark);
    let truth: Vec<[u8; 4]> = truth.pixels().map(|pixel| [pixel.0[0], pixel.0[1], pixel.0[2], SURE]).collect();
    let psnr = |database: &ImageDatabase, width: Option<u32>| {
        let camera = width.map(|_| std::sync::Arc::new(Camera::new(&lens)));
        let (method, max_distance_m, without) = (Method::Exact, f64::INFINITY, Vec::new());
        let asked =
            ViewQuery { map_from_link: pose(wanted), method, camera, max_distance_m, may_be_stored: true, without };
        let shown = database.view(&asked).expect("a view").answer.image;
        let both: Vec<bool> = shown.pixels.iter().map(|pixel| pixel[3] == SURE).collect();
        similarity(&truth, &shown.pixels, 320, &ground, &both).psnr_db
    };
    let with = psnr(&open(&room), None);
    let ignored = Contents { sources: vec![], ..contents.clone() };
    let source = realitysim::database::Source { darkening: None, ..contents.sources[0].clone() };
    Contents { sources: vec![source], ..ignored }.write(&room.path("db")).expect("written");
    let without = psnr(&open(&room), None);
    println!("darkening taken out {with:.2} dB, not {without:.2} dB");
    assert!(with > without + 1.0, "{with} against {without}");
    assert_eq!(psnr(&open(&room), Some(320)), without, "the same lens asked for by its size");
}

#[test]
fn a_rendered_capture_whose_lens_darkens_nothing_is_left_as_it_is() {
    let (room, _) = walked();
    assert_eq!(open(&room).contents().sources[0].darkening, None);
    // Contents of before, which do not speak of it.
    let path = room.path("db/database.json");
    let text = fs::read_to_string(&path).expect("written");
    let older = text.replace("\"darkening\": null,", "");
    assert!(older.len() < text.len());
    fs::write(&path, older).expect("written");
    assert_eq!(open(&room).contents().sources[0].darkening, None);
}
