use super::*;
use glam::{DVec2, DVec3};
use proptest::prelude::*;
use realitysim_geometry::LensModel;

/// A file of tests/data/lenses.
fn example(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/lenses").join(name);
    let bytes = crate::plain_file::read(&path, 1 << 20).expect("an example");
    String::from_utf8(bytes).expect("text")
}

fn read(text: &str) -> Result<LensFile, String> {
    parse_lens(text, "lens", LensWanted::default()).map_err(|error| error.to_string())
}

fn refused(text: &str) -> String {
    let message = read(text).expect_err("refused");
    assert!(message.starts_with("lens: "), "{message}");
    message
}

const RATIONAL: [f64; 8] = [4.1, -2.3, 0.0011, -0.0007, 0.31, 4.3, -0.7, -0.2];

#[test]
fn every_example_loads_with_its_model() {
    use LensFormat::*;
    let prism = [-0.31, 0.11, 0.0012, -0.0008, -0.014, 0.02, -0.003, 0.0004, 0.0021, -0.0003, -0.0013, 0.0002];
    for (name, format, model, focal) in [
        ("opencv-5.yml", OpenCv, LensModel::PlumbBob { d: [-0.29, 0.085, 0.0011, -0.0006, -0.011] }, [412.5, 413.75]),
        ("opencv-8.yml", OpenCv, LensModel::RationalPolynomial { d: RATIONAL }, [412.5, 413.75]),
        ("opencv-12.xml", OpenCv, LensModel::ThinPrism { d: prism }, [412.5, 413.75]),
        (
            "opencv-fisheye.xml",
            OpenCv,
            LensModel::KannalaBrandt { k: [-0.012, 0.003, -0.0008, 0.0001] },
            [205.5, 205.25],
        ),
        ("kalibr-ds.yaml", Kalibr, LensModel::DoubleSphere { xi: -0.21, alpha: 0.59 }, [158.4, 158.1]),
        ("camera.cameramodel", Mrcal, LensModel::RationalPolynomial { d: RATIONAL }, [412.5, 413.75]),
        ("ros-rational.yaml", Ros, LensModel::RationalPolynomial { d: RATIONAL }, [412.5, 413.75]),
    ] {
        let file = read(&example(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        let p = file.lens.parameters();
        assert_eq!((file.format, p.model, [p.fx, p.fy]), (format, model, focal), "{name}");
        assert_eq!((p.width, p.height, file.scaled_from), (640, 480, None), "{name}");
    }
    let wanted = LensWanted { camera: Some("cam1"), image_size: None };
    let eucm = parse_lens(&example("kalibr-ds.yaml"), "lens", wanted).expect("cam1").lens;
    assert_eq!(eucm.parameters().model, LensModel::Eucm { alpha: 0.62, beta: 1.09 });
}

/// `cam2world` of OCamCalib: the angle off the axis at which a pixel sees, and the direction around it.
fn cam2world(row: f64, column: f64) -> [f64; 2] {
    let (down, right) = (row - 236.4, column - 321.8);
    let determinant = 0.9987 - 0.0041 * -0.0039;
    let x = (down - 0.0041 * right) / determinant;
    let y = (0.0039 * down + 0.9987 * right) / determinant;
    let rho = (x * x + y * y).sqrt();
    let z = -206.1 + 1.51e-3 * rho.powi(2) - 1.15e-6 * rho.powi(3) + 6.3e-9 * rho.powi(4);
    [rho.atan2(-z), x.atan2(y)]
}

#[test]
fn an_ocamcalib_lens_sees_where_ocamcalib_does() {
    let file = read(&example("calib_results.txt")).expect("a good file");
    assert_eq!(file.format, LensFormat::OCamCalib);
    let (mut turns, mut seen): (Vec<f64>, u32) = Default::default();
    for row in (0..480).step_by(13) {
        for column in (0..640).step_by(13) {
            let ray = file.lens.unproject(DVec2::new(column.into(), row.into())).expect("the whole image is drawn");
            let [angle, around] = cam2world(row.into(), column.into());
            assert!((ray.x.hypot(ray.y).atan2(ray.z) - angle).abs() < 1e-12, "{row} {column}");
            let turn = (ray.y.atan2(ray.x) - around).rem_euclid(core::f64::consts::TAU);
            turns.push(if turn > 3.0 { turn - core::f64::consts::TAU } else { turn });
            seen += 1;
        }
    }
    // Only the turn of the sensor about the axis differs, by the same angle everywhere.
    assert!(seen > 1500 && turns.iter().all(|turn| (turn - turns[0]).abs() < 1e-11), "{:?}", &turns[..9]);
    assert!((turns[0] - (0.0041f64 / 0.9987).atan()).abs() < 1e-11, "{}", turns[0]);
}

#[test]
fn an_opencv_file_that_is_ambiguous_names_the_choice() {
    let five = example("opencv-5.yml");
    let four = five
        .replace("cols: 5", "cols: 4")
        .replace(", -0.010999999999999999 ]", " ]")
        .replace(",\n       -0.010999999999999999 ]", " ]");
    let count = |text: &str| text.matches("-0.01099").count();
    assert_eq!((count(&five), count(&four)), (1, 0), "{five}");
    let pinhole = read(&four).expect("fisheye_model: 0").lens;
    assert_eq!(pinhole.parameters().model, LensModel::PlumbBob { d: [-0.29, 0.085, 0.0011, -0.0006, 0.0] });
    let fisheye = read(&four.replace("fisheye_model: 0", "fisheye_model: 1")).expect("fisheye_model: 1").lens;
    assert_eq!(fisheye.parameters().model, LensModel::KannalaBrandt { k: [-0.29, 0.085, 0.0011, -0.0006] });
    let message = refused(&four.replace("fisheye_model: 0\n", ""));
    assert!(message.contains("add `fisheye_model: 1` or `fisheye_model: 0`"), "{message}");
    assert!(refused(&four.replace("fisheye_model: 0", "fisheye_model: maybe")).contains("fisheye_model is maybe"));
    assert!(refused(&five.replace("fisheye_model: 0", "fisheye_model: 1")).contains("it must have 4, k1 to k4"));
}

#[test]
fn an_opencv_file_without_a_size_takes_that_of_the_image() {
    for (name, from) in [
        ("opencv-8.yml", ["image_width: 640\n", "image_height: 480\n"]),
        ("opencv-12.xml", ["<image_width>640</image_width>\n", "<image_height>480</image_height>\n"]),
    ] {
        let one_left = example(name).replace(from[0], "");
        assert!(refused(&one_left).contains("image_width is missing"), "{name}");
        let bare = one_left.replace(from[1], "");
        assert!(refused(&bare).contains("does not say how large its image is"), "{name}");
        let wanted = LensWanted { camera: None, image_size: Some([800, 600]) };
        let p = parse_lens(&bare, "lens", wanted).expect("with a size").lens.parameters().clone();
        assert_eq!((p.width, p.height, p.fx), (800, 600, 412.5));
    }
}

#[test]
fn opencv_files_that_cannot_be_right_name_the_key() {
    let xml = example("opencv-12.xml");
    for (text, expected) in [
        (xml.replace("412.5 0. 318.25", "412.5 0. many"), "camera_matrix/data is \"many\""),
        (xml.replace("</opencv_storage>", ""), "the file ends inside <opencv_storage>"),
        (xml.replace("opencv_storage", "robot"), "not a lens file of a known format"),
        (
            xml.replace("<image_width>640", "<image_width>-640"),
            "image_width is \"-640\": it must be a number of pixels",
        ),
        (xml.replace("distortion_coefficients", "other"), "distortion_coefficients is missing"),
        ("<a>".repeat(10_000), "not a lens file of a known format"),
        (format!("<opencv_storage>{}", "<a>".repeat(100_000)), "nested more than 16 deep"),
        (example("opencv-8.yml").replace("412.5, 0., 318.25", "412.5, 0.3, 318.25"), "camera_matrix.data[1] is 0.3"),
        (example("opencv-8.yml").replace(", -0.20000000000000001 ]", " ]"), "it must have 5 (k1, k2, p1, p2, k3), 8"),
    ] {
        let message = refused(&text);
        assert!(message.contains(expected), "{expected}: {message}");
    }
    let tilted = example("opencv-8.yml").replace("-0.20000000000000001 ]", "-0.2, 0., 0., 0., 0., 0.01, 0. ]");
    assert!(refused(&tilted).contains("the tilt of the sensor, must be 0"));
}

#[test]
fn mrcal_models_that_are_not_supported_say_what_would_be() {
    let text = example("camera.cameramodel");
    for model in ["LENSMODEL_CAHVOR", "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=18_fov_x_deg=150"] {
        let message = refused(&text.replace("'LENSMODEL_OPENCV8'", &format!("'{model}'")));
        assert!(message.contains(model) && message.contains("mrcal-convert-lensmodel"), "{message}");
    }
    let message = refused(&text.replace("'LENSMODEL_OPENCV8'", "'LENSMODEL_OPENCV5'"));
    assert!(message.contains("LENSMODEL_OPENCV5 has 9 numbers"), "{message}");
    let stereographic = text.replace("'LENSMODEL_OPENCV8'", "'LENSMODEL_STEREOGRAPHIC'");
    let stereographic = stereographic.replace(", 4.1, -2.3, 0.0011, -0.0007, 0.31, 4.3, -0.7, -0.2,]", "]");
    let lens = read(&stereographic).expect("a good file").lens;
    let angle = 0.6f64;
    let found = lens.project(DVec3::new(angle.sin(), 0.0, angle.cos())).expect("in view").x - 318.25;
    assert!((found - 412.5 * 2.0 * (angle / 2.0).tan()).abs() < 1e-10, "{found}");
}

#[test]
fn ocamcalib_files_that_cannot_be_right_name_the_line() {
    let text = example("calib_results.txt");
    for (from, to, expected) in [
        ("5 -2.06", "4 -2.06", "the DIRECT mapping function is 4 and 5 coefficients"),
        ("-2.061000e+02 0.0", "2.061000e+02 0.0", "the first coefficient of the DIRECT mapping function is 206.1"),
        (" 0.000000e+00 1.51", " 1.0 1.51", "the second coefficient of the DIRECT mapping function is 1"),
        ("236.400000 321.8", "236.400000", "center is [236.4"),
        ("480 640", "480.5 640", "image size is [480.5, 640.0]: it must have two whole numbers"),
        ("480 640", "480 1e300", "it must have two whole numbers"),
        ("#image size", "#size", "image size is missing"),
        ("0.998700", "9.98700", "affine parameters is [9.987"),
        ("-1.150000e-06", "nan", "the DIRECT mapping function is \"nan\": it must be a number"),
    ] {
        assert!(text.contains(from), "{from}");
        let message = refused(&text.replacen(from, to, 1));
        assert!(message.contains(expected), "{expected}: {message}");
    }
}

#[test]
fn kalibr_s_omni_is_refused_with_what_would_do() {
    let text = example("kalibr-ds.yaml").replace("camera_model: ds", "camera_model: omni");
    assert!(refused(&text).contains("cam0.camera_model is \"omni\": supported are pinhole"));
    let text = example("kalibr-ds.yaml").replacen("distortion_model: none", "distortion_model: radtan", 1);
    assert!(refused(&text).contains("cam0.distortion_model is \"radtan\": ds is supported with \"none\""));
    let text = example("kalibr-ds.yaml").replacen("[-0.21, 0.59,", "[-0.21,", 1);
    assert!(refused(&text).contains("a double sphere has six numbers"));
}

#[test]
fn a_field_of_view_reaches_from_edge_to_edge() {
    for (text, half_rad) in [
        ("equidistant:180deg", 90f64),
        ("equisolid:200deg", 100.0),
        ("pinhole:90deg", 45.0),
        ("equidistant:62.5deg", 31.25),
    ] {
        let file = load_lens_for_image(text, 800, 600).expect("a good lens");
        assert_eq!((file.format, file.title.as_str()), (LensFormat::FieldOfView, text));
        for column in [-0.5, 799.5] {
            let ray = file.lens.unproject(DVec2::new(column, 299.5)).expect("the edge of the image");
            let angle = ray.x.abs().atan2(ray.z).to_degrees();
            assert!((angle - half_rad).abs() < 1e-9 && ray.y.abs() < 1e-12, "{text}: {angle}");
        }
    }
}

#[test]
fn a_field_of_view_that_no_lens_has_is_refused() {
    for text in [
        "equidistant:361deg",
        "pinhole:180deg",
        "pinhole:0deg",
        "equisolid:-9deg",
        "equisolid:nandeg",
        "pinhole:90",
        "pinhole:",
    ] {
        let message = load_lens_for_image(text, 640, 480).expect_err("refused").to_string();
        assert!(message.contains("full horizontal field of view"), "{text}: {message}");
    }
    assert!(load_lens("equidistant:180deg").expect_err("refused").to_string().contains("how large its image is"));
    assert!(load_lens("stereographic:180deg").expect_err("refused").to_string().contains("no camera is called"));
}

#[test]
fn a_lens_is_scaled_to_images_of_its_aspect_ratio() {
    let full = load_lens("fisheye-640").expect("shipped").lens;
    for (width, height) in [(320, 240), (1280, 960), (1280, 959), (333, 250)] {
        let file = load_lens_for_image("fisheye-640", width, height).expect("scaled");
        assert_eq!(file.scaled_from, Some([640, 480]));
        let ray = DVec3::new(0.3, -0.5, 0.6);
        let [at, whole] = [&file.lens, &full].map(|lens| lens.project(ray).expect("in view") + 0.5);
        let scale = DVec2::new(f64::from(width) / 640.0, f64::from(height) / 480.0);
        assert!((at - whole * scale).length() < 1e-9, "{width} x {height}: {at}");
    }
    assert!(load_lens_for_image("fisheye-640", 640, 360).is_err());
    assert_eq!(load_lens_for_image("fisheye-640", 640, 480).expect("its size").scaled_from, None);
}

#[test]
fn a_lens_survives_its_own_format() {
    for (model, keys) in [
        (LensModel::RationalPolynomial { d: RATIONAL }, format!("model = \"rational_polynomial\"\nd = {RATIONAL:?}")),
        (LensModel::DoubleSphere { xi: -0.2, alpha: 0.6 }, "model = \"double_sphere\"\nxi = -0.2\nalpha = 0.6".into()),
        (LensModel::Eucm { alpha: 0.6, beta: 1.1 }, "model = \"eucm\"\nalpha = 0.6\nbeta = 1.1".into()),
        (
            LensModel::Scaramuzza { c: [-0.3, 0.05, -0.06, 0.0, 0.0], skew: 0.001 },
            "model = \"scaramuzza\"\nc = [-0.3, 0.05, -0.06, 0.0, 0.0]\nskew = 0.001".into(),
        ),
    ] {
        let text = format!(
            "title = \"x\"\nwidth = 640\nheight = 480\nfx = 300.0\nfy = 300.0\ncx = 320.0\ncy = 240.0\n{keys}\n"
        );
        assert_eq!(read(&text).expect("a good file").lens.parameters().model, model);
        assert!(refused(&format!("{text}k = [0.0]\n")).contains("k is [0.0]:"));
        let less = text.lines().take(text.lines().count() - 1).collect::<Vec<_>>().join("\n");
        assert!(refused(&less).contains("is missing"), "{less}");
    }
}

proptest! {
    /// Whatever a file is cut or changed to, the answer is a lens or a message.
    #[test]
    fn damaged_examples_never_panic(which in 0usize..7, at in 0usize..2000, byte in 0u8..128, cut in any::<bool>()) {
        let names = ["opencv-5.yml", "opencv-8.yml", "opencv-12.xml", "opencv-fisheye.xml", "kalibr-ds.yaml", "camera.cameramodel", "calib_results.txt"];
        let mut text = example(names[which]).into_bytes();
        let at = at % text.len();
        if cut { text.truncate(at) } else { text[at] = byte }
        let _ = parse_lens(&String::from_utf8_lossy(&text), "damaged", LensWanted { camera: None, image_size: Some([640, 480]) });
    }
}
