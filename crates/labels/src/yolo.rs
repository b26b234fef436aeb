//! YOLO's text labels, as Ultralytics documents them: <https://docs.ultralytics.com/datasets/>.
//!
//! A file a picture, a line an object, all numbers as shares of the picture's width and height.

use core::fmt::Write;

use glam::DVec2;

use crate::{ClassList, Keypoint, LabelBox, Labeller, Outline, PosedImage, SphereBox, Visibility};

/// Boxes: `class x y width height`, x and y of the middle.
pub fn boxes(labeller: &Labeller, image: &PosedImage, classes: ClassList) -> String {
    let boxes = labeller.boxes(image).into_iter();
    boxes.filter_map(|LabelBox { kind, from, to, .. }| Some(line(classes.class(kind)?, [from, to], image))).collect()
}

/// The box of a sphere, of the only class.
pub fn sphere(found: &SphereBox, image: &PosedImage) -> String {
    line(0, [found.from, found.to], image)
}

fn line(class: usize, [from, to]: [DVec2; 2], image: &PosedImage) -> String {
    let (middle, extent) = ((from + to) / 2.0 / size(image), (to - from) / size(image));
    format!("{class} {:.6} {:.6} {:.6} {:.6}\n", middle.x, middle.y, extent.x, extent.y)
}

/// Outlines of the painted lines, the only class: `class x1 y1 x2 y2 ...`.
pub fn outlines(labeller: &Labeller, image: &PosedImage) -> String {
    let size = size(image);
    let mut text = String::new();
    for Outline { corners } in labeller.line_outlines(image) {
        text.push('0');
        for corner in corners {
            let at = corner / size;
            let _ = write!(text, " {:.6} {:.6}", at.x.clamp(0.0, 1.0), at.y.clamp(0.0, 1.0));
        }
        text.push('\n');
    }
    text
}

/// The field as one object with all landmarks as keypoints: `class x y width height` and for each landmark x, y and visibility (0
/// outside, 1 hidden, 2 visible). Empty if no landmark is in the picture.
pub fn keypoints(labeller: &Labeller, image: &PosedImage) -> String {
    let size = size(image);
    let keypoints = labeller.keypoints(image);
    let inside = keypoints.iter().filter(|keypoint| keypoint.visibility != Visibility::Outside);
    let at = inside.map(|keypoint| (keypoint.at + 0.5) / size);
    let Some((from, to)) = at.map(|at| (at, at)).reduce(|(low, high), (at, _)| (low.min(at), high.max(at))) else {
        return String::new();
    };
    let (middle, extent) = ((from + to) / 2.0, to - from);
    let mut text = format!("0 {:.6} {:.6} {:.6} {:.6}", middle.x, middle.y, extent.x, extent.y);
    for Keypoint { at, visibility, .. } in keypoints {
        let at = (at + 0.5) / size;
        let _ = match visibility {
            Visibility::Outside => write!(text, " 0 0 0"),
            Visibility::Hidden => write!(text, " {:.6} {:.6} 1", at.x, at.y),
            Visibility::Visible => write!(text, " {:.6} {:.6} 2", at.x, at.y),
        };
    }
    text.push('\n');
    text
}

/// For each landmark, the number of the one that takes its place in a picture whose left and right are exchanged.
pub fn mirrored(labeller: &Labeller) -> Vec<usize> {
    let landmarks = labeller.landmarks();
    let place = |name: String| landmarks.iter().position(|landmark| landmark.name == name);
    landmarks.iter().enumerate().map(|(own, landmark)| place(landmark.mirrored_name()).unwrap_or(own)).collect()
}

fn size(image: &PosedImage) -> DVec2 {
    DVec2::new(image.camera.width() as f64, image.camera.height() as f64)
}
