//! Our own lens files, and what holds for every format.

use glam::{DVec2, DVec3};
use realitysim::config::{LensFormat, LensWanted, lens_names, load_lens, load_lens_for_image, parse_lens};
use realitysim::geometry::LensModel;

#[test]
fn every_shipped_camera_loads() {
    for name in lens_names() {
        let file = load_lens(&name).expect("a shipped camera");
        assert_eq!(file.format, LensFormat::Own);
        assert!(file.visual_mesh_pose.is_none());
        let centre = DVec2::new(f64::from(file.lens.width()), f64::from(file.lens.height())) / 2.0;
        assert!(file.lens.unproject(centre).is_some_and(|ray| ray.z > 0.99), "{name}");
    }
}

#[test]
fn the_fisheye_keeps_its_numbers() {
    let file = load_lens("fisheye-640").expect("a shipped camera");
    let p = file.lens.parameters();
    assert_eq!((p.width, p.height, p.fx, p.fy, p.cx, p.cy), (640, 480, 205.0, 205.0, 322.0, 236.0));
    assert_eq!(p.model, LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0] });
    assert_eq!(p.fov_deg, Some(200.0));
    assert!(file.lens.max_angle() > 95f64.to_radians());
}

#[test]
fn the_wide_camera_sees_a_hundred_degrees_across() {
    let lens = load_lens("wide-640").expect("a shipped camera").lens;
    let ray = |u| lens.unproject(DVec2::new(u, lens.parameters().cy)).expect("a ray for every column");
    let degrees = ray(0.0).angle_between(ray(639.0)).to_degrees();
    assert!((degrees - 100.0).abs() < 1.0, "{degrees}");
    for corner in [DVec2::ZERO, DVec2::new(639.0, 0.0), DVec2::new(0.0, 479.0), DVec2::new(639.0, 479.0)] {
        assert!(lens.unproject(corner).is_some(), "no ray at {corner}");
    }
}

#[test]
fn the_large_fisheye_covers_its_stated_view() {
    let lens = load_lens("fisheye-1280").expect("a shipped camera").lens;
    assert_eq!(lens.parameters().model, LensModel::Equisolid);
    let at = |degrees: f64| lens.project(DVec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos()));
    assert!(at(84.9).is_some() && at(85.1).is_none());
}

#[test]
fn an_image_of_another_aspect_ratio_is_refused() {
    assert!(load_lens_for_image("fisheye-640", 640, 480).is_ok());
    let message = load_lens_for_image("fisheye-640", 1280, 720).expect_err("refused").to_string();
    assert_eq!(message, "fisheye-640: the lens is for images of 640 x 480, but the image has 1280 x 720");
}

#[test]
fn a_wrong_file_of_ours_names_the_key() {
    let text = std::fs::read_to_string("config/cameras/fisheye-640.toml").expect("a shipped file");
    let refused = |from: &str, to: &str| {
        assert!(text.contains(from));
        let text = text.replace(from, to);
        parse_lens(&text, "ours.toml", LensWanted::default()).expect_err("refused").to_string()
    };
    for (from, to, message) in [
        ("\"kannala_brandt\"", "\"omni\"", "model is \"omni\": it must be \"kannala_brandt\", \"equisolid\""),
        ("-0.0008, 0.0]", "-0.0008]", "k is [-0.012, 0.003, -0.0008]: it must have four numbers, k1 to k4"),
        ("k = [", "d = [", "d is [-0.012, 0.003, -0.0008, 0.0]: kannala_brandt takes k: remove it"),
        ("\"kannala_brandt\"", "\"equisolid\"", "equisolid takes no coefficients: remove it"),
        ("\"kannala_brandt\"", "\"plumb_bob\"", "plumb_bob takes d: remove it"),
        ("k = [", "#", "k is missing: it must have four numbers"),
        ("fx = 205.0", "fx = -205.0", "fx is -205.0: a focal length must be a positive number of pixels"),
        ("fov_deg = 200.0", "fov = 200.0", "unknown field `fov`"),
        ("width = 640", "width = -640", "-640"),
        ("0.003", "-0.3", "the distortion turns back"),
    ] {
        let found = refused(from, to);
        assert!(found.starts_with("ours.toml: ") && found.contains(message), "{found}");
    }
}

#[test]
fn an_unknown_camera_lists_the_known_ones() {
    let message = load_lens("fisheye").expect_err("refused").to_string();
    assert!(message.contains("no camera is called \"fisheye\"") && message.contains("fisheye-640, "), "{message}");
}
