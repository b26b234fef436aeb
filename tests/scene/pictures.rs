//! The pictures of docs/reference/scenes.md, without and with each effect:
//! `cargo test --release scene::pictures -- --ignored`.

use std::fs::File;
use std::path::Path;

use glam::{DQuat, DVec2, DVec3};
use image::RgbImage;
use image::codecs::jpeg::JpegEncoder;
use realitysim::evaluation::drawing::{Route, RouteStyle, field_map, overlay};
use realitysim::geometry::{Euler, Isometry, Lens};
use realitysim::scene::{Imu, Renderer, Scene, SceneEventKind};

use super::common::{LOOP, STRAIGHT, plain, scene, with_effects};

const SWAY: &str =
    "kind = \"gait_sway\"\nroll_deg = 6\npitch_deg = 4\nlateral_m = 0.03\nvertical_m = 0.01\nstep_hz = 2.4";
const HEAD: &str =
    "kind = \"head_motion\"\npan_amplitude_deg = 60\npan_period_s = 2\ntilt_amplitude_deg = 0\ntilt_period_s = 3";
const FALL: &str = "kind = \"fall\"\nat_s = 3.0\ndirection = \"left\"";
const QUALITY: u8 = 82;
const LINES: [u8; 3] = [230, 30, 60];

fn build(base: &str, effects: &[&str]) -> Scene {
    scene(&with_effects(&plain(base), effects))
}

fn frame(scene: &Scene, index: u64) -> RgbImage {
    let (renderer, mut pixels) = (Renderer::new(scene), Vec::new());
    renderer.render(index, &mut pixels);
    if let Some(share) = scene.torn(index) {
        let whole = (pixels.len() as f64 * share) as usize;
        pixels[whole..].fill(128);
    }
    RgbImage::from_raw(renderer.width(), renderer.height(), pixels).expect("an image")
}

/// As the robot's odometry has it, where it starts in `map`.
fn odometry_route(scene: &Scene) -> RgbImage {
    let start = scene.truth(0.0).map_from_base_footprint;
    let point = |x: f64, y: f64| DVec2::new(x, y);
    let (mut told, mut truth) = (Vec::new(), Vec::new());
    for event in scene.events() {
        let time = (event.stamp_ns - realitysim::scene::START_STAMP_NS) as f64 * 1e-9;
        let SceneEventKind::Odometry(odometry) = event.kind else { continue };
        let pose = start.compose(&odometry.odom_from_base_footprint);
        let place = point(pose.x, pose.y);
        told.push(place);
        let true_pose = scene.truth(time).map_from_base_footprint;
        truth.push(point(true_pose.x, true_pose.y));
    }
    let route =
        |label: &str, colour, points, style| Route { label: label.to_owned(), colour, points, style, dots: false };
    let routes =
        [route("walked", [255, 235, 120], truth, RouteStyle::Wide), route("odometry", LINES, told, RouteStyle::Thin)];
    field_map(scene.field(), &routes, 560, &[])
}

/// The messages of odometry that arrive and those that arrive changed, as dots where the robot was; every tenth.
fn arriving(scene: &Scene) -> RgbImage {
    let (mut whole, mut corrupt) = (Vec::new(), Vec::new());
    for event in scene.events() {
        let stamp_ns = event.stamp_ns - realitysim::scene::START_STAMP_NS;
        if matches!(event.kind, SceneEventKind::Odometry(_)) && stamp_ns / 10_000_000 % 10 == 0 {
            let pose = scene.truth(stamp_ns as f64 * 1e-9).map_from_base_footprint;
            let dots = if event.corrupt.is_some() { &mut corrupt } else { &mut whole };
            dots.push(DVec2::new(pose.x, pose.y));
        }
    }
    // Apart from each other: no line between them.
    let dots = |label: &str, colour, points: Vec<DVec2>| {
        let points = points.into_iter().flat_map(|point| [point, DVec2::NAN]).collect();
        Route { label: label.to_owned(), colour, points, style: RouteStyle::Wide, dots: true }
    };
    field_map(scene.field(), &[dots("sound", [255, 235, 120], whole), dots("corrupt", LINES, corrupt)], 560, &[])
}

/// With the lines where lens, mount and IMU put them.
fn told_lines(scene: &Scene, index: u64) -> RgbImage {
    let time = scene.frame_time_s(index);
    let attitude = scene.events().find_map(|event| match event.kind {
        SceneEventKind::Imu(Imu { orientation, .. }) => {
            let at = (event.stamp_ns - realitysim::scene::START_STAMP_NS) as f64 * 1e-9;
            (at >= time).then(|| Isometry::new(orientation, DVec3::ZERO).euler())
        }
        _ => None,
    });
    let attitude = attitude.expect("an IMU");
    let mount = scene.announced_mount();
    let tilt = Euler { yaw: 0.0, ..attitude }.rotation();
    let base_link = Isometry::new(tilt, mount.base_footprint_from_base_link.translation);
    let pose = scene.truth(time).map_from_base_footprint.to_isometry()
        * Isometry::new(DQuat::IDENTITY, DVec3::ZERO)
        * base_link
        * mount.base_link_from_camera_link;
    let lens = Lens::new(scene.announced_lens().clone()).expect("a lens");
    overlay(&frame(scene, index), &lens, &pose, scene.field(), LINES)
}

/// Side by side, each half as large.
fn save(name: &str, without: &RgbImage, with: &RgbImage) {
    let half = |picture: &RgbImage| {
        let size = (picture.width() / 2, picture.height() / 2);
        image::imageops::resize(picture, size.0, size.1, image::imageops::FilterType::Triangle)
    };
    let (left, right) = (half(without), half(with));
    let mut both =
        RgbImage::from_pixel(left.width() + right.width() + 6, left.height().max(right.height()), image::Rgb([255; 3]));
    image::imageops::replace(&mut both, &left, 0, 0);
    image::imageops::replace(&mut both, &right, i64::from(left.width()) + 6, 0);
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let file = File::create(root.join(format!("docs/reference/scenes/{name}.jpg"))).expect("docs/scenes");
    JpegEncoder::new_with_quality(file, QUALITY).encode_image(&both).expect("written");
    both.save(root.join(format!("target/scene-look/{name}.png"))).expect("written");
}

#[test]
#[ignore = "for eyes, not for machines"]
fn of_each_effect() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for folder in ["docs/reference/scenes", "target/scene-look"] {
        std::fs::create_dir_all(root.join(folder)).expect("a folder");
    }
    let still = build(STRAIGHT, &[]);
    let window = "kind = \"bright_window\"\nwall = \"+x\"\ncentre_m = 0.6\nwidth_m = 3.2\nsill_m = 1\nheight_m = 2.5\n\
                  brightness = 8\nglare = 0.4\nsun_elevation_deg = 20\nsun_gain = 1.7";
    for (name, effects, before, index) in [
        ("gait_sway", vec![SWAY], vec![], 33),
        ("head_motion", vec![HEAD], vec![], 34),
        ("kidnapping", vec!["kind = \"kidnapping\"\nat_s = 3.0\nto_m = [0.5, -1.2]\nto_yaw_deg = 60"], vec![], 34),
        ("fall", vec![SWAY, FALL], vec![SWAY], 42),
        (
            "light",
            vec!["kind = \"light\"\ngain = 0.35\ncolour = [1.0, 0.85, 0.65]\ngradient_per_m = [0.2, 0.1]"],
            vec![],
            40,
        ),
        ("bright_window", vec![window], vec![], 60),
        ("obstacles", vec!["kind = \"obstacles\"\nrandom = 10"], vec![], 60),
        ("turf", vec!["kind = \"turf\"\nblades = 0.14\nglint_share = 0.003\npaint = 0.4\nragged_mm = 3.5"], vec![], 60),
        (
            "sun_patches",
            vec!["kind = \"sun_patches\"\ngain = 2\nshare = 0.5\nlength_m = 1.5\nedge_m = 0.2"],
            vec![],
            60,
        ),
        ("optics", vec!["kind = \"optics\"\nstray_light = 0.35\nlateral_colour_px = 5"], vec![], 60),
        ("exposure_hunting", vec!["kind = \"exposure_hunting\"\namplitude = 0.4\nperiod_s = 2"], vec![], 65),
        ("image_processing", vec!["kind = \"image_processing\"\ncolour_filter = true\nsharpening = 3"], vec![], 60),
        ("worn_lines", vec!["kind = \"worn_lines\"\nshare = 0.6\npatch_m = 0.3"], vec![], 60),
        ("shutter", vec![HEAD, "kind = \"shutter\"\nexposure_ms = 12\nreadout_ms = 25"], vec![HEAD], 40),
        ("sensor_noise", vec!["kind = \"sensor_noise\"\nread_noise_dn = 8\nshot_noise_factor = 0.6"], vec![], 60),
        ("camera_fault", vec!["kind = \"camera_fault\"\nunplugged = { from_s = 6.05, for_s = 1 }"], vec![], 60),
    ] {
        save(name, &frame(&build(STRAIGHT, &before), index), &frame(&build(STRAIGHT, &effects), index));
    }
    let walk = odometry_route(&build(LOOP, &[]));
    let odometry = "kind = \"odometry_error\"\nscale_percent = 15\nyaw_drift_deg_per_m = 3\nnoise_m_per_m = 0.2";
    save("odometry_error", &walk, &odometry_route(&build(LOOP, &[odometry])));
    let serial = "kind = \"serial_noise\"\nlost_share = 0.8\ncorrupt_share = 0.3";
    save("serial_noise", &arriving(&build(LOOP, &[])), &arriving(&build(LOOP, &[serial])));
    let imu = "kind = \"imu_error\"\nroll_bias_deg = 3\npitch_bias_deg = 2\nnoise_deg = 0.5\ngyro_noise_deg_s = 1";
    let calibration = "kind = \"calibration_error\"\nfocal_percent = 4\ncentre_px = [8, -6]\nmount_pitch_deg = 2";
    for (name, effect) in [("imu_error", imu), ("calibration_error", calibration)] {
        save(name, &told_lines(&still, 60), &told_lines(&build(STRAIGHT, &[effect]), 60));
    }
}
