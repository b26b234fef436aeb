//! The hall is found in the images, what stands above the ground is seen at its distance, and no field lies outside of the field.

use glam::DVec3;
use realitysim::geometry::{Euler, Isometry};
use realitysim::scene::Renderer;
use realitysim::views::{
    Camera, Candidate, Hall, HallImage, NOTHING, Pyramid, Raster, Surface, Target, World, fit_hall, similarity, view,
};

use super::moving::{hall as rendered, picture};
use super::{candidate, field, lens, request};

/// Half extents of the rendered hall and its height, metres: 6 m beyond the carpet.
const TRUE_WALLS_M: [f64; 4] = [9.7, 8.7, 9.7, 8.7];
const TRUE_CEILING_M: f64 = 6.5;

fn at(x: f64, y: f64, z: f64, yaw_deg: f64, pitch_deg: f64) -> Isometry {
    let euler = Euler { yaw: yaw_deg.to_radians(), pitch: pitch_deg.to_radians(), roll: 0.0 };
    Isometry::from_euler(euler, DVec3::new(x, y, z))
}

/// A walk around the middle that looks everywhere.
fn walk() -> Vec<Isometry> {
    let pose = |step: usize| {
        let turn = step as f64 * core::f64::consts::TAU / 36.0;
        at(1.4 * turn.cos(), 1.1 * turn.sin(), 0.55, 30.0 * step as f64, 20.0)
    };
    (0..36).map(pose).collect()
}

fn fitted(hall: &Renderer, poses: &[Isometry]) -> Hall {
    let camera = Camera::new(&lens());
    let images: Vec<HallImage> =
        poses.iter().map(|pose| HallImage::new(&camera, pose, &picture(hall, &camera, pose, 0))).collect();
    fit_hall(&images, World::new(&field()).ground_half()).hall
}

fn made(hall: &Renderer, sources: &[Isometry], wanted: &Isometry, known: Hall) -> Raster {
    let (camera, world) = (Camera::new(&lens()), World::without_goals(&field()).with_hall(known));
    let images: Vec<Pyramid> = sources.iter().map(|pose| Pyramid::new(picture(hall, &camera, pose, 0))).collect();
    let candidates: Vec<Candidate> =
        sources.iter().zip(&images).map(|(pose, image)| candidate(&camera, *pose, image)).collect();
    view(&request(&camera, *wanted, &world), &candidates).expect("a view").image
}

#[test]
fn walls_and_ceiling_are_found_where_they_are() {
    let hall = rendered("");
    let found = fitted(&hall, &walk());
    assert!(found.yaw_rad.abs() < 0.02, "{found:?}");
    for (found, truth) in
        found.walls_m.iter().chain([&found.ceiling_m]).zip(TRUE_WALLS_M.iter().chain([&TRUE_CEILING_M]))
    {
        let found = found.expect("every plane is seen");
        assert!((found / truth - 1.0).abs() < 0.04, "{found} m: {truth} m");
    }
}

#[test]
fn what_images_do_not_determine_stays_unknown() {
    let hall = rendered("");
    let from_one_place: Vec<Isometry> = (0..36).map(|step| at(0.3, 0.2, 0.55, 10.0 * f64::from(step), 20.0)).collect();
    assert!(fitted(&hall, &from_one_place).is_unknown(), "without parallax");
    assert!(fitted(&hall, &walk()[..2]).is_unknown(), "two images");
    let camera = Camera::new(&lens());
    let noise = |seed: usize| {
        let value = |index: usize| (((index * 7919 + seed * 104_729) * 2_654_435_761) >> 13) as u8;
        let rgb: Vec<u8> = (0..3 * camera.width() * camera.height()).map(value).collect();
        Raster::from_rgb(camera.width(), camera.height(), &rgb, camera.shows()).expect("fits")
    };
    let images: Vec<HallImage> =
        walk().iter().enumerate().map(|(seed, pose)| HallImage::new(&camera, pose, &noise(seed))).collect();
    assert!(fit_hall(&images, World::new(&field()).ground_half()).hall.is_unknown(), "noise");
}

/// Above the ground, against the rendered truth, from four images 0.25 m and farther away.
#[test]
fn a_known_hall_makes_views_above_the_ground_right() {
    let hall = rendered("");
    let (camera, width) = (Camera::new(&lens()), 320);
    let known = fitted(&hall, &walk());
    for (x, y, yaw_deg) in [(0.2, 0.1, 15.0), (-0.8, 0.4, 130.0), (0.9, -0.6, -80.0)] {
        let wanted = at(x, y, 0.55, yaw_deg, 20.0);
        let around = [(0.25, 0.0, 6.0), (-0.2, 0.2, -6.0), (0.0, -0.35, 10.0), (-0.3, -0.2, 0.0)];
        let sources = around.map(|(dx, dy, turned)| at(x + dx, y + dy, 0.55, yaw_deg + turned, 20.0));
        let truth = picture(&hall, &camera, &wanted, 0);
        let world = World::without_goals(&field());
        let target = Target::new(&camera, &wanted, &world);
        let above: Vec<bool> =
            (0..width * 240).map(|i| target.surface(i % width, i / width) == Some(Surface::Far)).collect();
        let psnr_db = |known| {
            let made = made(&hall, &sources, &wanted, known);
            let shown: Vec<bool> = made.pixels.iter().map(|pixel| pixel[3] != NOTHING).collect();
            similarity(&truth.pixels, &made.pixels, width, &above, &shown).psnr_db
        };
        let (far_db, known_db) = (psnr_db(Hall::default()), psnr_db(known));
        println!("({x}, {y}) {yaw_deg} deg: {far_db:.1} dB far, {known_db:.1} dB in its hall");
        assert!(known_db > far_db + 3.0, "{far_db} dB far, {known_db} dB in its hall");
    }
}

/// Share of the pixels that are as green as the carpet, on the ground and beyond.
fn green_shares(image: &Raster, camera: &Camera, wanted: &Isometry) -> [f64; 2] {
    let world = World::without_goals(&field());
    let target = Target::new(camera, wanted, &world);
    let mut counts = [[0, 0]; 2];
    for (index, [red, green_level, blue, known]) in image.pixels.iter().enumerate() {
        let Some(surface) = target.surface(index % image.width, index / image.width) else { continue };
        if *known == NOTHING {
            continue;
        }
        let [green, count] = &mut counts[usize::from(surface == Surface::Far)];
        let [red, green_level, blue] = [red, green_level, blue].map(|value| f64::from(*value));
        *count += 1;
        *green += i32::from(green_level > 1.25 * red && green_level > 1.25 * blue);
    }
    counts.map(|[green, count]| f64::from(green) / f64::from(count.max(1)))
}

#[test]
fn no_carpet_is_shown_outside_of_the_carpet_from_any_height() {
    let hall = rendered("");
    let camera = Camera::new(&lens());
    let sources = [at(0.4, 0.5, 0.55, 200.0, 20.0), at(0.6, 0.3, 0.55, 190.0, 20.0), at(0.2, 0.8, 0.55, 215.0, 20.0)];
    for z in [0.3, 0.55, 0.8, 1.2, 1.5] {
        for (known, pitch_deg) in [(Hall::default(), 30.0), (Hall::default(), 10.0), (fitted(&hall, &walk()), 30.0)] {
            let wanted = at(0.5, 0.5, z, 200.0, pitch_deg);
            let [carpet, truth] = green_shares(&picture(&hall, &camera, &wanted, 0), &camera, &wanted);
            let [_, share] = green_shares(&made(&hall, &sources, &wanted, known), &camera, &wanted);
            assert!(carpet > 0.5, "{carpet}: the carpet is green");
            println!("{z} m, {pitch_deg} deg: {:.2} %, truly {:.2} %", 100.0 * share, 100.0 * truth);
            assert!(share < truth + 0.01, "{z} m: {share}, truly {truth}");
        }
    }
}
