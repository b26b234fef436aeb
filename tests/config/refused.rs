//! Lens files that must not be guessed at.

use proptest::prelude::*;
use realitysim::config::{LensWanted, lens_from_camera_info, load_lens, parse_lens};

use super::other_formats::{KALIBR, LARGE, ROS, VISUAL_MESH};

fn refused(text: &str, wanted: LensWanted) -> String {
    let message = parse_lens(text, "lens.yaml", wanted).expect_err("refused").to_string();
    assert!(message.starts_with("lens.yaml: "), "{message}");
    message
}

fn check(text: &str, wanted: LensWanted, changes: &[(&str, &str, &str)]) {
    for (from, to, expected) in changes {
        assert!(text.contains(from), "{from}");
        let message = refused(&text.replace(from, to), wanted);
        assert!(message.contains(expected), "{from} -> {to}: {message}");
    }
}

#[test]
fn ros_files() {
    let changes = [
        ("plumb_bob", "magic", "distortion_model is \"magic\": it must be \"plumb_bob\""),
        (
            "plumb_bob",
            "thin_prism",
            "distortion_coefficients.data is [-0.361976, 0.11051, 0.001014, 0.000505, 0.0]: thin_prism",
        ),
        ("0.000505, 0.000000]", "0.000505, 0.0, 0.0]", "distortion_coefficients.data is [-0.361976"),
        ("438.783367, 0.000000", "0.0, 0.0", "camera_matrix.data[0] is 0: a focal length is above 0"),
        ("438.783367, 0.000000", "438.783367, 0.7", "camera_matrix.data[1] is 0.7: it must be 0"),
        ("438.783367, 0.000000", "438.783367", "camera_matrix.data is 8 numbers: it must have 9"),
        ("image_width: 640", "image_width: 0", "image size 0 x 480"),
        ("image_height: 480\n", "", "image_height"),
        ("438.783367", "much", "much"),
    ];
    check(ROS, LensWanted::default(), &changes);
    let rational =
        ROS.replace("plumb_bob", "rational_polynomial").replace("0.000000]\nrect", "0.0, 0.1, 0.0, 0.0]\nrect");
    assert!(parse_lens(&rational, "lens.yaml", LensWanted::default()).is_ok());
    let seven = rational.replace("0.0, 0.1, 0.0, 0.0]", "0.0, 0.1, 0.0]");
    assert!(refused(&seven, LensWanted::default()).contains("rational_polynomial takes 8"));
    let tilted = rational.replace("0.1, 0.0, 0.0]", "0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01, 0.0]");
    assert!(refused(&tilted, LensWanted::default()).contains("the tilt of the sensor, must be 0"));
}

#[test]
fn kalibr_files() {
    let cam1 = LensWanted { camera: Some("cam1"), image_size: None };
    let message = refused(&KALIBR.replace("pinhole", "omni"), cam1);
    assert!(message.contains("cam1.camera_model is \"omni\": supported are pinhole"), "{message}");
    for model in ["ds", "eucm"] {
        let message = refused(&KALIBR.replace("pinhole", model), cam1);
        assert!(message.contains("cam1.intrinsics is [") && message.contains("six numbers"), "{message}");
    }
    let changes = [
        ("radtan", "fov", "cam0.distortion_model is \"fov\": it must be \"radtan\""),
        ("1.76e-05]", "1.76e-05, 0.0]", "cam0.distortion_coeffs is"),
        (", 248.375]", "]", "cam0.intrinsics is [458.654, 457.296, 367.215]: a pinhole has four"),
        ("  resolution: [752, 480]\n", "", "resolution"),
    ];
    check(KALIBR, LensWanted::default(), &changes);
    let message = refused(KALIBR, LensWanted { camera: Some("cam7"), image_size: None });
    assert!(message.contains("cam7 is missing: the file has cam0, cam1"), "{message}");
    let message = refused(ROS, cam1);
    assert!(message.contains("only a Kalibr file has several cameras"), "{message}");
}

#[test]
fn visual_mesh_files() {
    let changes = [
        ("EQUISOLID", "STEREOGRAPHIC", "projection is \"STEREOGRAPHIC\": it must be RECTILINEAR, EQUISOLID"),
        ("k: [0, 0]", "k: [1e-7, 0]", "k is [1e-7, 0.0]: only lenses with k = [0, 0]"),
        ("0.346036, 0]", "0.546036, 0]", "its upper left 3 x 3 must be a rotation"),
        ("-0.244225", ".nan", "non-finite"),
        ("[0, 0, 0, 1]", "[0, 0, 0, 2]", "its last row must be [0, 0, 0, 1]"),
        ("0.8]", ".inf]", "non-finite"),
        ("focal_length: 420", "focal_length: 0", "fx is 0"),
        ("fov: 1.80248", "fov: 180", "field of view"),
        ("centre: [3, -2]", "centre: [3]", "centre"),
    ];
    check(VISUAL_MESH, LARGE, &changes);
    assert!(refused(VISUAL_MESH, LensWanted::default()).contains("does not say how large its image is"));
}

#[test]
fn camera_info() {
    let k = [410.0, 0.0, 320.5, 0.0, 411.0, 240.5, 0.0, 0.0, 1.0];
    let refused = |model: &str, d: &[f64], k: &[f64; 9]| {
        lens_from_camera_info(640, 480, model, d, k).expect_err("refused").to_string()
    };
    assert!(refused("plumb_bob", &[], &[0.0; 9]).contains("k[0] is 0"));
    assert!(refused("plumb_bob", &[], &[0.0; 9]).contains("has not been calibrated"));
    assert!(refused("plumb_bob", &[0.1], &k).contains("d is [0.1]: plumb_bob takes 4"));
    assert!(refused("equidistant", &[0.1; 5], &k).contains("equidistant takes 4"));
    assert!(refused("rational_polynomial", &[0.1; 7], &k).contains("d is [0.1, 0.1"));
    assert!(refused("rational_polynomial", &[0.1; 14], &k).contains("the tilt of the sensor, must be 0"));
    assert!(refused("thin_prism", &[0.1; 8], &k).contains("thin_prism takes 12"));
    assert!(refused("", &[0.1; 4], &k).contains("distortion_model is \"\""));
}

#[test]
fn what_is_no_lens_file_at_all() {
    for (text, expected) in [
        ("", "not a lens file of a known format"),
        ("# nothing", "not a lens file of a known format"),
        ("a: 1\nb: 2\n", "not a lens file of a known format"),
        ("just words", "line 1 column 1: expected mapping start"),
        ("- 1\n- 2\n", "line 1 column 1: expected mapping start"),
        ("{", "unclosed bracket"),
        ("[table]\n", "unknown field `table`"),
        ("title = \"x\"\n", "missing field `width`"),
    ] {
        let message = refused(text, LensWanted::default());
        assert!(message.contains(expected), "{text:?}: {message}");
    }
}

#[test]
fn what_is_no_text() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("a plain path").to_owned();
    std::fs::write(path("photo"), [0xff, 0xd8, 0xff, 0xe0]).expect("a file");
    std::fs::write(path("recording"), vec![b' '; (1 << 20) + 1]).expect("a file");
    assert!(load_lens(&path("photo")).expect_err("refused").to_string().contains("not UTF-8 text"));
    assert!(load_lens(&path("recording")).expect_err("refused").to_string().contains("larger than 1024 KiB"));
    assert!(load_lens(&path("")).expect_err("refused").to_string().contains("cannot be read"));
}

proptest! {
    /// Whatever a file is cut or changed to, the answer is a lens or a message.
    #[test]
    fn damaged_files_never_panic(which in 0usize..3, at in 0usize..700, byte in 0u8..128, cut in any::<bool>()) {
        let mut text = [ROS, KALIBR, VISUAL_MESH][which].as_bytes().to_vec();
        let at = at % text.len();
        if cut { text.truncate(at) } else { text[at] = byte }
        let text = String::from_utf8(text).expect("ASCII");
        let _ = parse_lens(&text, "damaged.yaml", LARGE);
    }
}
