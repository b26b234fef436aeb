//! Lens files that other tools write, in the shape in which they write them.

use realitysim::config::{LensFormat, LensWanted, lens_from_camera_info, load_lens, load_lens_for_image, parse_lens};
use realitysim::geometry::{LensModel, LensParameters};
use realitysim::ros2::messages::{CameraInfo, Header};

pub const ROS: &str = "\
image_width: 640
image_height: 480
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: [438.783367, 0.000000, 305.593336, 0.000000, 437.302876, 243.738352, 0.000000, 0.000000, 1.000000]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.361976, 0.110510, 0.001014, 0.000505, 0.000000]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.000000, 0.000000, 0.000000, 0.000000, 1.000000, 0.000000, 0.000000, 0.000000, 1.000000]
projection_matrix:
  rows: 3
  cols: 4
  data: [393.653800, 0., 322.797939, 0., 0., 393.241800, 241.090902, 0., 0., 0., 1., 0.]
";

pub const KALIBR: &str = "\
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2834, 0.0739, 0.00019, 1.76e-05]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.0137, 0.0208, -0.0128, 0.0025]
  distortion_model: equidistant
  intrinsics: [190.978, 190.973, 254.932, 256.897]
  resolution: [512, 512]
  rostopic: /cam1/image_raw
";

pub const VISUAL_MESH: &str = "\
projection: EQUISOLID
focal_length: 420
centre: [3, -2]
k: [0, 0]
fov: 1.80248
Hoc:
  - [-0.244225, -0.905877, 0.346036, 0]
  - [-0.0304556, 0.363831, 0.930967, 0]
  - [-0.96924, 0.216827, -0.116446, 0.8]
  - [0, 0, 0, 1]
";

pub const LARGE: LensWanted = LensWanted { camera: None, image_size: Some([1280, 1024]) };

#[test]
fn ros_files_load() {
    let file = parse_lens(ROS, "head.yaml", LensWanted::default()).expect("a good file");
    assert_eq!((file.format, file.title.as_str()), (LensFormat::Ros, "head_camera"));
    let p = file.lens.parameters();
    assert_eq!((p.width, p.height, p.fx, p.fy), (640, 480, 438.783367, 437.302876));
    assert_eq!((p.cx, p.cy, p.fov_deg), (305.593336, 243.738352, None));
    assert_eq!(p.model, LensModel::PlumbBob { d: [-0.361976, 0.110510, 0.001014, 0.000505, 0.0] });

    let fisheye = ROS.replace("plumb_bob", "equidistant").replace("0.000505, 0.000000]", "0.000505]");
    let file = parse_lens(&fisheye, "head.yaml", LensWanted::default()).expect("a good file");
    assert_eq!(file.lens.parameters().model, LensModel::KannalaBrandt { k: [-0.361976, 0.110510, 0.001014, 0.000505] });
}

#[test]
fn kalibr_files_load_camera_by_camera() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("camchain#2.yaml");
    std::fs::write(&path, KALIBR).expect("a file");
    let path = path.to_str().expect("a plain path");

    let first = load_lens(path).expect("cam0");
    assert_eq!((first.format, first.title.as_str()), (LensFormat::Kalibr, "/cam0/image_raw"));
    assert_eq!(first.lens.parameters().model, LensModel::PlumbBob { d: [-0.2834, 0.0739, 0.00019, 1.76e-05, 0.0] });
    assert_eq!(load_lens(&format!("{path}#cam0")).expect("cam0"), first);

    let second = load_lens_for_image(&format!("{path}#cam1"), 512, 512).expect("cam1").lens;
    let p = second.parameters();
    assert_eq!((p.fx, p.fy, p.cx, p.cy), (190.978, 190.973, 254.932, 256.897));
    assert_eq!(p.model, LensModel::KannalaBrandt { k: [-0.0137, 0.0208, -0.0128, 0.0025] });
}

#[test]
fn visual_mesh_files_load_with_their_pose() {
    let file = parse_lens(VISUAL_MESH, "lens.yaml", LARGE).expect("a good file");
    assert_eq!(file.format, LensFormat::VisualMesh);
    let p = file.lens.parameters();
    // The middle of 1280 x 1024 less the offset, and half a pixel for the origin.
    assert_eq!((p.width, p.height, p.cx, p.cy), (1280, 1024, 636.5, 513.5));
    assert_eq!((p.model, p.fx, p.fy), (LensModel::Equisolid, 420.0, 420.0));
    assert!((p.fov_deg.expect("stated") - 103.275).abs() < 1e-3);

    let pose = file.visual_mesh_pose.expect("Hoc").world_from_camera_link;
    assert_eq!(pose.translation.to_array(), [0.0, 0.0, 0.8]);
    // The camera's forward axis is Hoc's first column: it looks down.
    let forward = pose.transform_vector(glam::DVec3::X);
    assert!((forward - glam::DVec3::new(-0.244225, -0.0304556, -0.96924)).length() < 1e-5, "{forward}");

    for (projection, model) in [
        ("RECTILINEAR", LensModel::PlumbBob { d: [0.0; 5] }),
        ("EQUIDISTANT", LensModel::KannalaBrandt { k: [0.0; 4] }),
    ] {
        let file = parse_lens(&VISUAL_MESH.replace("EQUISOLID", projection), "lens.yaml", LARGE).expect("a good file");
        assert_eq!(file.lens.parameters().model, model);
    }
    let (without, _) = VISUAL_MESH.split_once("Hoc").expect("it is there");
    assert_eq!(parse_lens(without, "lens.yaml", LARGE).expect("a good file").visual_mesh_pose, None);
}

/// What a capture announces is what its replay reads.
#[test]
fn every_model_comes_back_from_its_calibration_message() {
    for model in [
        LensModel::KannalaBrandt { k: [-0.01, 0.002, 0.0, 0.0] },
        LensModel::Equisolid,
        LensModel::PlumbBob { d: [-0.2, 0.05, 0.001, -0.001, 0.0] },
        LensModel::RationalPolynomial { d: [4.1, -2.3, 0.001, -0.001, 0.3, 4.3, -0.7, -0.2] },
        LensModel::ThinPrism { d: [-0.3, 0.1, 0.001, -0.001, -0.01, 0.02, 0.0, 0.0, 0.002, 0.0, -0.001, 0.0] },
        LensModel::DoubleSphere { xi: -0.2, alpha: 0.6 },
        LensModel::Eucm { alpha: 0.6, beta: 1.1 },
        LensModel::Scaramuzza { c: [-0.3, 0.05, -0.06, 0.0, 0.0], skew: 0.001 },
    ] {
        let lens = LensParameters {
            width: 640,
            height: 480,
            fx: 300.0,
            fy: 301.0,
            cx: 320.0,
            cy: 240.0,
            model,
            fov_deg: None,
        };
        let info = CameraInfo::of_lens(&lens, Header::default());
        let read = lens_from_camera_info(info.width, info.height, &info.distortion_model, &info.d, &info.k);
        // And what session.json and database.json state.
        let stored = serde_json::to_string(&lens).expect("it can be stored");
        assert_eq!(serde_json::from_str::<LensParameters>(&stored).expect("it can be read"), lens, "{stored}");
        assert_eq!(read, Ok(lens));
    }
}

#[test]
fn camera_info_gives_the_lens() {
    let k = [410.0, 0.0, 320.5, 0.0, 411.0, 240.5, 0.0, 0.0, 1.0];
    let lens = |model: &str, d: &[f64]| lens_from_camera_info(640, 480, model, d, &k).map(|p| p.model);
    let ideal = Ok(LensModel::PlumbBob { d: [0.0; 5] });
    assert_eq!(lens("plumb_bob", &[]), ideal);
    assert_eq!(lens("", &[]), ideal);
    assert_eq!(lens("plumb_bob", &[0.1, 0.2, 0.3, 0.4]), Ok(LensModel::PlumbBob { d: [0.1, 0.2, 0.3, 0.4, 0.0] }));
    assert_eq!(lens("plumb_bob", &[0.1, 0.2, 0.3, 0.4, 0.5]), Ok(LensModel::PlumbBob { d: [0.1, 0.2, 0.3, 0.4, 0.5] }));
    assert_eq!(lens("equidistant", &[]), Ok(LensModel::KannalaBrandt { k: [0.0; 4] }));
    assert_eq!(lens("equidistant", &[0.1, 0.2, 0.3, 0.4]), Ok(LensModel::KannalaBrandt { k: [0.1, 0.2, 0.3, 0.4] }));
    let rational = [0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0];
    assert_eq!(lens("rational_polynomial", &rational), Ok(LensModel::PlumbBob { d: [0.1, 0.2, 0.3, 0.4, 0.5] }));

    let eight = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8];
    assert_eq!(lens("rational_polynomial", &eight), Ok(LensModel::RationalPolynomial { d: eight }));
    let twelve = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.01, 0.0, 0.0, 0.0];
    for (name, d) in [("thin_prism", &twelve[..]), ("rational_polynomial", &[&twelve[..], &[0.0, 0.0]].concat())] {
        assert_eq!(lens(name, d), Ok(LensModel::ThinPrism { d: twelve }));
    }
    assert_eq!(lens("fisheye", &[0.1, 0.2, 0.3, 0.4]), Ok(LensModel::KannalaBrandt { k: [0.1, 0.2, 0.3, 0.4] }));

    let p = lens_from_camera_info(640, 480, "plumb_bob", &[], &k).expect("a good lens");
    assert_eq!((p.width, p.height, p.fx, p.fy, p.cx, p.cy), (640, 480, 410.0, 411.0, 320.5, 240.5));
}
