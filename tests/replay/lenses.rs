//! Lenses of parts of images, of scaled images, and of which only the angle of view is known.

use std::fs;

use realitysim::ros2::messages::{CameraInfo, CompressedImage};
use serde_json::Value;

use super::support::{CAMERA_INFO, IMAGE, LENS, Replayed, Room, assert_same, changed, decode_all, walk};

fn scaled_warnings(replayed: &Replayed) -> Vec<&str> {
    let warnings = replayed.report["warnings"].as_array().expect("warnings");
    warnings.iter().filter_map(Value::as_str).filter(|said| said.contains("was scaled")).collect()
}

fn with_info(change: impl FnMut(&mut CameraInfo)) -> Room {
    Room::with_log(&changed::<CameraInfo>(&walk().messages, CAMERA_INFO, change))
}

/// The calibration of the whole sensor, of which the walk's images are the mean of two by two pixels.
fn doubled(info: &mut CameraInfo) {
    (info.width, info.height) = (2 * info.width, 2 * info.height);
    let [fx, _, cx, _, fy, cy, ..] = info.k;
    (info.k[0], info.k[2]) = (2.0 * fx, 2.0 * cx + 0.5);
    (info.k[4], info.k[5]) = (2.0 * fy, 2.0 * cy + 0.5);
}

#[test]
fn binned_images_have_the_lens_of_their_pixels() {
    let room = with_info(|info| {
        doubled(info);
        (info.binning_x, info.binning_y) = (2, 2);
    });
    let replayed = room.replay("log.mcap");
    assert_same(&replayed.tags, &walk().tags, "binned");
    assert!(scaled_warnings(&replayed).is_empty());
}

#[test]
fn cropped_images_have_the_lens_of_the_part() {
    let room = with_info(|info| {
        info.roi.x_offset = 40;
        info.roi.y_offset = 16;
        (info.roi.width, info.roi.height) = (info.width, info.height);
        (info.width, info.height) = (info.width + 64, info.height + 32);
        info.k[2] += 40.0;
        info.k[5] += 16.0;
    });
    assert_same(&room.replay("log.mcap").tags, &walk().tags, "cropped");
    let both = with_info(|info| {
        doubled(info);
        info.roi.x_offset = 40;
        info.roi.y_offset = 16;
        // A column and a row that fill no pixel.
        (info.roi.width, info.roi.height) = (info.width + 1, info.height + 1);
        (info.width, info.height) = (info.width + 64, info.height + 32);
        info.k[2] += 40.0;
        info.k[5] += 16.0;
        (info.binning_x, info.binning_y) = (2, 2);
    });
    assert_same(&both.replay("log.mcap").tags, &walk().tags, "cropped, then binned");
}

#[test]
fn images_scaled_from_the_calibrated_size_are_tagged_with_a_warning() {
    let replayed = with_info(doubled).replay("log.mcap");
    assert_same(&replayed.tags, &walk().tags, "scaled");
    let warnings = scaled_warnings(&replayed);
    let expected =
        "/camera/camera_info: the lens is for images of 640 x 480, but these have 320 x 240: it was scaled to them";
    assert!(matches!(warnings[..], [said] if said.starts_with(expected)), "{}", replayed.report);

    let room = Room::with_walk();
    let whole = fs::read_to_string(format!("{}/config/cameras/fisheye-640.toml", env!("CARGO_MANIFEST_DIR"))).unwrap();
    room.write("lens.toml", whole.replace("fov_deg = 200.0", ""));
    let replayed = room.replay("log.mcap --lens lens.toml");
    assert_same(&replayed.tags, &walk().tags, "scaled, by a file");
    assert!(matches!(scaled_warnings(&replayed)[..], [said] if said.starts_with("lens.toml: ")), "{}", replayed.report);
}

#[test]
fn images_of_another_aspect_ratio_are_rejected_by_their_size() {
    let replayed = with_info(|info| info.height = 180).replay("log.mcap");
    assert!(replayed.tags.iter().all(|tag| tag.reason == "image_size"), "{}", replayed.report);
    assert!(scaled_warnings(&replayed).is_empty());
}

#[test]
fn an_angle_of_view_is_a_lens_for_the_log_s_first_image() {
    let room = Room::with_walk();
    let replayed = room.replay("log.mcap --lens equidistant:180deg");
    let session: Value = serde_json::from_slice(&fs::read(replayed.session.join("session.json")).unwrap()).unwrap();
    let lens = &session["lens"];
    assert_eq!((&lens["width"], &lens["height"]), (&320.into(), &240.into()), "{lens}");
    let focal = 160.0 / core::f64::consts::FRAC_PI_2;
    assert!((lens["fx"].as_f64().unwrap() - focal).abs() < 1e-9 && lens["cx"] == 159.5, "{lens}");
    assert_eq!(replayed.tags.len(), walk().frames());
    room.run("replay log.mcap -o captures --lens equidistant:400deg")
        .fails(2, &["equidistant:400deg", "full horizontal field of view"]);
    room.run("replay log.mcap -o captures --lens pinhole:90").fails(2, &["pinhole:90", "as in 120deg"]);
}

#[test]
fn a_photo_scaled_from_the_lens_s_size_is_tagged_with_a_warning() {
    let room = Room::new();
    room.write("lens.toml", LENS);
    let images: Vec<CompressedImage> = decode_all(&walk().messages, IMAGE);
    room.write("frame.jpg", &images[0].data);
    let known = "tag frame.jpg --attitude 0,17 --height 0.49 --field kid-2009 --initial -1.9,0.2,10 --json --lens";
    let [own, scaled] = ["lens.toml", "fisheye-640"].map(|lens| room.run(&format!("{known} {lens}")).succeeds());
    assert_eq!(own.json()["best"], scaled.json()["best"]);
    assert!(!own.stderr.contains("warning"), "{own:?}");
    let expected = "realitysim: warning: fisheye-640: the lens is for images of 640 x 480, but these have 320 x 240";
    assert!(scaled.stderr.contains(expected), "{scaled:?}");
    room.write("wide.toml", LENS.replace("height = 240", "height = 180"));
    room.run(&format!("{known} wide.toml"))
        .fails(2, &["the lens is for images of 320 x 180, but the image has 320 x 240"]);
    room.run(&format!("{known} pinhole:100deg"));
}

/// From the rendered scene over its calibration message to the tags, on the scalar path too.
#[test]
fn walks_through_every_other_model_are_tagged_with_the_same_bits() {
    let rational = "fx = 180.0\nfy = 180.0\nmodel = \"rational_polynomial\"\nd = [4.1, -2.3, 0.0011, -0.0007, 0.31, 4.3, -0.7, -0.2]";
    let sphere = "fx = 82.0\nfy = 82.0\nmodel = \"double_sphere\"\nxi = -0.2\nalpha = 0.6";
    let unified = "fx = 102.5\nfy = 102.5\nmodel = \"eucm\"\nalpha = 0.6\nbeta = 1.1";
    let scaramuzza =
        "fx = 102.5\nfy = 102.5\nmodel = \"scaramuzza\"\nc = [-0.31, 0.05, -0.06, 0.01, 0.0]\nskew = 0.003";
    for model in [rational, sphere, unified, scaramuzza] {
        let room = Room::new();
        room.write_scene("scene.toml", |text| text.replace("rate_hz = 10.0", "rate_hz = 3.0"));
        let size = "title = \"x\"\nwidth = 320\nheight = 240\ncx = 160.75\ncy = 117.75\n";
        room.write("lens.toml", format!("{size}{model}\n"));
        room.run("scene render scene.toml -o log.mcap").succeeds();
        let replayed = room.replay("log.mcap");
        assert_same(&room.replay("scene.toml").tags, &replayed.tags, model);
        assert_same(&room.replay("log.mcap --simd scalar").tags, &replayed.tags, model);
        let (valid, all) = (replayed.count("valid"), replayed.tags.len());
        assert!(all >= 5 && 2 * valid > all, "{model}: {valid} of {all} valid: {}", replayed.report);
        assert!(scaled_warnings(&replayed).is_empty(), "{model}");
    }
}
