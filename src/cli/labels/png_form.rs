//! The form `png` of labels: pictures of classes and depths, and tables of keypoints and of the carpet's border.

use std::fmt::Write;
use std::path::Path;

use anyhow::Context;
use image::GrayImage;

use super::super::depth_picture::depth_png;
use super::super::paths::{write, write_bytes};
use crate::labels::{Class, Labeller, PosedImage, Visibility};
use crate::views::{SURE, World, depth_m};

/// Folders of the pictures of this form.
pub(super) const FOLDERS: [&str; 2] = ["classes", "depth"];

/// Writes labels of this form into a folder.
pub(super) struct PngForm<'a> {
    pub folder: &'a Path,
    pub labeller: &'a Labeller,
    pub world: &'a World,
}

/// The lines of an image in the tables.
#[derive(Default)]
pub(super) struct TableRows {
    keypoints: String,
    border: String,
}

impl PngForm<'_> {
    /// Writes the pictures of an image whose own file is `file`. Returns its lines in the tables.
    pub fn write_image(&self, file: &str, image: &PosedImage, classes: &[Class]) -> anyhow::Result<TableRows> {
        let name = Path::new(file).with_extension("png");
        self.write_classes(&name, image, classes)?;
        let depths = known_depths_m(image, self.world);
        write_bytes(&self.folder.join("depth").join(&name), &depth_png(&depths, image.camera.width())?)?;
        Ok(TableRows { keypoints: self.keypoint_rows(file, image), border: self.border_row(file, image, classes) })
    }

    fn write_classes(&self, name: &Path, image: &PosedImage, classes: &[Class]) -> anyhow::Result<()> {
        let (width, height) = (image.camera.width() as u32, image.camera.height() as u32);
        let gray = GrayImage::from_raw(width, height, classes.iter().map(|class| *class as u8).collect());
        let path = self.folder.join("classes").join(name);
        let written = gray.context("a class for each pixel")?.save(&path);
        written.with_context(|| path.display().to_string())
    }

    fn keypoint_rows(&self, file: &str, image: &PosedImage) -> String {
        let mut rows = String::new();
        for (landmark, found) in self.labeller.landmarks().iter().zip(self.labeller.keypoints(image)) {
            let visibility = match found.visibility {
                Visibility::Outside => continue,
                Visibility::Hidden => "hidden",
                Visibility::Visible => "visible",
            };
            let (name, at, sigma) = (&landmark.name, found.at, found.sigma_px);
            let _ = writeln!(rows, "{file},{name},{:.3},{:.3},{sigma:.3},{visibility}", at.x, at.y);
        }
        rows
    }

    fn border_row(&self, file: &str, image: &PosedImage, classes: &[Class]) -> String {
        let rows: Vec<String> = self.labeller.border(image, classes).iter().map(ToString::to_string).collect();
        format!("{file},{}\n", rows.join(","))
    }

    /// Writes the tables of all images, and what the classes are.
    pub fn write_tables<'r>(&self, images: impl Iterator<Item = &'r TableRows> + Clone) -> anyhow::Result<()> {
        let keypoints: String = images.clone().map(|rows| rows.keypoints.as_str()).collect();
        let border: String = images.map(|rows| rows.border.as_str()).collect();
        write(&self.folder.join("keypoints.csv"), &format!("file,landmark,u,v,sigma_px,visibility\n{keypoints}"))?;
        write(&self.folder.join("border.csv"), &border)?;
        let known = Class::KNOWN.iter().chain([&Class::Ignore]);
        let names: String = known.map(|class| format!("{} {}\n", *class as u8, class.name())).collect();
        write(&self.folder.join("classes.txt"), &names)
    }
}

/// Depth along the ray of each pixel, metres; infinite where it is not known: nothing, or something that moves, is before the world there.
fn known_depths_m(image: &PosedImage, world: &World) -> Vec<f32> {
    let mut depths = depth_m(image.camera, &image.map_from_link, world);
    for (at, depth) in depths.iter_mut().enumerate() {
        if image.shown.get(at) != Some(&SURE) || image.body.get(at).is_some_and(|body| *body) {
            *depth = f32::INFINITY;
        }
    }
    depths
}
