//! COLMAP's text model: `cameras.txt`, `images.txt` and `points3D.txt` (<https://colmap.github.io/format.html>).
//!
//! The centre of the first pixel is (0.5, 0.5), a pose is `camera_optical_frame_from_map`, and camera and image numbers begin with 1.

use std::fmt::Write;

use super::{FIRST_CENTRE, LensFit, TrainerLens, TrainingSet};

/// `cameras.txt`.
pub fn cameras(set: &TrainingSet) -> String {
    let mut text = String::from(
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n",
    );
    for (number, LensFit { size: [width, height], focal: [fx, fy], centre, lens, .. }) in set.cameras.iter().enumerate()
    {
        let (model, parameters): (_, &[f64]) = match lens {
            TrainerLens::Fisheye { k } => ("OPENCV_FISHEYE", k),
            TrainerLens::Pinhole { d } => ("FULL_OPENCV", d),
        };
        let (cx, cy) = (centre.x + FIRST_CENTRE, centre.y + FIRST_CENTRE);
        let _ = write!(text, "{} {model} {width} {height} {fx} {fy} {cx} {cy}", number + 1);
        parameters.iter().for_each(|parameter| _ = write!(text, " {parameter}"));
        text.push('\n');
    }
    text
}

/// `images.txt`. The images have no points of their own.
pub fn images(set: &TrainingSet) -> String {
    let mut text = String::from(
        "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n#   POINTS2D[] as (X, Y, \
         POINT3D_ID)\n",
    );
    for (number, image) in set.images.iter().enumerate() {
        let pose = image.map_from_optical.inverse();
        let (q, t) = (pose.rotation, pose.translation);
        let (camera, file) = (image.camera + 1, image.file());
        let _ =
            writeln!(text, "{} {} {} {} {} {} {} {} {camera} {file}\n", number + 1, q.w, q.x, q.y, q.z, t.x, t.y, t.z);
    }
    text
}

/// `points3D.txt`. The points have no error and no track.
pub fn points(set: &TrainingSet) -> String {
    let mut text = String::from(
        "# 3D point list with one line of data per point:\n#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n",
    );
    for (number, point) in set.points.iter().enumerate() {
        let ([red, green, blue], at) = (point.colour, point.at);
        let _ = writeln!(text, "{} {:.4} {:.4} {:.4} {red} {green} {blue} 0", number + 1, at.x, at.y, at.z);
    }
    text
}
