//! Nerfstudio's `transforms.json` (<https://docs.nerf.studio/quickstart/data_conventions.html>), and its seed points as PLY.
//!
//! The centre of the first pixel is (0.5, 0.5). A pose is `map_from_camera` of a camera that looks along -z, with x to the right and
//! y up (OpenGL).

use std::fmt::Write;

use glam::{DMat3, DVec3};
use serde::Serialize;

use super::{FIRST_CENTRE, TrainerLens, TrainingImage, TrainingSet};

/// Folder of the images.
pub const IMAGES: &str = "images";
/// Folder of the masks.
pub const MASKS: &str = "masks";
/// File of the seed points.
pub const SEED_FILE: &str = "seed.ply";

#[derive(Serialize)]
struct Transforms {
    ply_file_path: &'static str,
    train_filenames: Vec<String>,
    val_filenames: Vec<String>,
    test_filenames: Vec<String>,
    frames: Vec<Frame>,
}

#[derive(Serialize)]
struct Frame {
    file_path: String,
    mask_path: String,
    camera_model: &'static str,
    w: u32,
    h: u32,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    k1: f64,
    k2: f64,
    k3: f64,
    k4: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    p1: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    p2: Option<f64>,
    transform_matrix: [[f64; 4]; 4],
}

/// `transforms.json`, with the parameters of the lens in each frame.
///
/// # Errors
///
/// The reason, if a lens has a rational distortion, which nerfstudio cannot state.
pub fn transforms(set: &TrainingSet) -> Result<String, String> {
    let path = |image: &TrainingImage| format!("{IMAGES}/{}", image.file());
    let names = |held_out: bool| set.images.iter().filter(move |image| image.held_out == held_out).map(path).collect();
    let frames: Result<Vec<Frame>, String> = set.images.iter().map(|image| frame(set, image, path(image))).collect();
    let transforms = Transforms {
        ply_file_path: SEED_FILE,
        train_filenames: names(false),
        val_filenames: names(true),
        test_filenames: names(true),
        frames: frames?,
    };
    serde_json::to_string_pretty(&transforms).map_err(|error| error.to_string())
}

fn frame(set: &TrainingSet, image: &TrainingImage, file_path: String) -> Result<Frame, String> {
    let camera = &set.cameras[image.camera];
    let (camera_model, [k1, k2, k3, k4], tangential) = match camera.lens {
        TrainerLens::Fisheye { k } => ("OPENCV_FISHEYE", k, None),
        TrainerLens::Pinhole { d: [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0] } => {
            ("OPENCV", [k1, k2, k3, 0.0], Some([p1, p2]))
        }
        TrainerLens::Pinhole { .. } => {
            return Err(
                "nerfstudio has no lens with rational distortion: export to colmap, or calibrate another model"
                    .to_owned(),
            );
        }
    };
    Ok(Frame {
        file_path,
        mask_path: format!("{MASKS}/{}", image.mask_file()),
        camera_model,
        w: camera.size[0],
        h: camera.size[1],
        fl_x: camera.focal[0],
        fl_y: camera.focal[1],
        cx: camera.centre.x + FIRST_CENTRE,
        cy: camera.centre.y + FIRST_CENTRE,
        k1,
        k2,
        k3,
        k4,
        p1: tangential.map(|[p1, _]| p1),
        p2: tangential.map(|[_, p2]| p2),
        transform_matrix: opengl(image),
    })
}

/// The pose of a camera that looks along -z, with y up, row by row.
fn opengl(image: &TrainingImage) -> [[f64; 4]; 4] {
    let pose = image.map_from_optical;
    let turned = DMat3::from_quat(pose.rotation) * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let row = |index: usize| {
        let part = turned.row(index);
        [part.x, part.y, part.z, pose.translation[index]]
    };
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

/// The seed points as a text PLY with colours.
pub fn ply(set: &TrainingSet) -> String {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {}\n", set.points.len());
    ["x", "y", "z"].iter().for_each(|axis| _ = writeln!(text, "property float {axis}"));
    ["red", "green", "blue"].iter().for_each(|colour| _ = writeln!(text, "property uchar {colour}"));
    text.push_str("end_header\n");
    for point in &set.points {
        let ([red, green, blue], at) = (point.colour, point.at);
        let _ = writeln!(text, "{:.4} {:.4} {:.4} {red} {green} {blue}", at.x, at.y, at.z);
    }
    text
}
