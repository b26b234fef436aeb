//! The files with the boxes, and the page to look at.

use std::path::Path;

use image::imageops;
use image::{Rgb, RgbImage};

use super::super::super::marks::{frame_box, rgb};
use super::super::super::paths::{make_folder, save, write, write_bytes};
use super::super::posed_images::{IMAGES, PosedImages};
use super::super::yolo_set::write_yolo_set;
use super::BoxFormat;
use super::sightings::{Finding, Sighting};
use crate::evaluation::drawing::{panels, scaled};
use crate::labels::coco::{Coco, CocoImage};
use crate::labels::{SphereBox, yolo};
use crate::recording::Loss;

/// Where the files go, and in which form.
pub(super) struct Files<'a> {
    pub(super) folder: &'a Path,
    pub(super) format: BoxFormat,
    pub(super) class: &'a str,
}

/// Frames with a box on the page.
const SHOWN: usize = 12;
/// Frames on the page that show something else.
const SHOWN_OTHERS: usize = 6;
/// Columns of the page.
const COLUMNS: u32 = 6;
/// Side of a picture on the page, pixels.
const SIDE_PX: u32 = 240;
/// Side of the cut-out, in sides of the box.
const AROUND: f64 = 4.0;
/// Smallest side of the cut-out, pixels of the image.
const MIN_CUT_PX: f64 = 64.0;

impl Files<'_> {
    /// Writes all files. Returns the images that cannot be read.
    pub(super) fn write(&self, images: &PosedImages, sightings: &[Sighting]) -> anyhow::Result<Vec<Loss>> {
        let labels = matches!(self.format, BoxFormat::Yolo).then_some("labels");
        [IMAGES].into_iter().chain(labels).try_for_each(|name| make_folder(&self.folder.join(name)))?;
        let mut coco = Coco::of_one_class(self.class);
        let (mut names, mut lost) = (Vec::new(), Vec::new());
        for sighting in sightings {
            if let Finding::Unreadable(why) = &sighting.finding {
                lost.push(Loss::new(self.folder, format!("frame {}: {why}", sighting.frame.sequence)));
            }
            let Some(found) = sighting.labelled() else { continue };
            let place = names.len() + 1;
            let image = images.posed(&sighting.frame.record, &[]).map_err(anyhow::Error::msg)?;
            let (name, stem) = self.copy(images, sighting)?;
            match self.format {
                BoxFormat::Coco => coco.push(CocoImage::of_sphere(found, &image, place, &name)),
                BoxFormat::Yolo => {
                    write(&self.folder.join("labels").join(format!("{stem}.txt")), &yolo::sphere(found, &image))?;
                }
            }
            names.push(name);
        }
        match self.format {
            BoxFormat::Coco => write(&self.folder.join("annotations.json"), &coco.text())?,
            BoxFormat::Yolo => {
                let names: Vec<&str> = names.iter().map(String::as_str).collect();
                write_yolo_set(self.folder, &names, "", &[&format!("{:?}", self.class)])?;
            }
        }
        self.write_preview(images, sightings)?;
        Ok(lost)
    }

    /// Copies a frame's stored image. Returns its name, and the name without its ending.
    fn copy(&self, images: &PosedImages, sighting: &Sighting) -> anyhow::Result<(String, String)> {
        let record = &sighting.frame.record;
        let stem = format!("{:06}", sighting.frame.sequence);
        let ending = images.database().ending_of(record).map_err(anyhow::Error::msg)?;
        let bytes = images.database().file_of(record).map_err(anyhow::Error::msg)?;
        let name = format!("{stem}.{ending}");
        write_bytes(&self.folder.join(IMAGES).join(&name), &bytes)?;
        Ok((name, stem))
    }

    fn write_preview(&self, images: &PosedImages, sightings: &[Sighting]) -> anyhow::Result<()> {
        let is_object = |sighting: &&Sighting| matches!(sighting.finding, Finding::Object(..));
        let is_other = |sighting: &&Sighting| matches!(sighting.finding, Finding::SomethingElse(..));
        let mut pictures = Vec::new();
        let objects = some(sightings.iter().filter(is_object).collect(), SHOWN);
        let others = some(sightings.iter().filter(is_other).collect(), SHOWN_OTHERS);
        for sighting in objects.into_iter().chain(others) {
            let (Finding::Object(found, similarity) | Finding::SomethingElse(found, similarity)) = &sighting.finding
            else {
                continue;
            };
            let picture = images.database().image(sighting.frame.number).map_err(anyhow::Error::msg)?;
            let colour = if is_object(&sighting) { [0, 255, 0] } else { [255, 0, 0] };
            let words = format!("frame {}, {:.1} s, {similarity:.2}", sighting.frame.sequence, sighting.frame.time_s);
            pictures.push((cut_out(&rgb(picture.full())?, found, colour), words));
        }
        let path = self.folder.join("preview.jpg");
        save(&panels(&pictures, COLUMNS), &path)
    }
}

/// At most so many of them, evenly.
fn some<T: Copy>(all: Vec<T>, count: usize) -> Vec<T> {
    let every = all.len().div_ceil(count).max(1);
    all.into_iter().step_by(every).collect()
}

/// The surroundings of a box, enlarged, with the box.
fn cut_out(picture: &RgbImage, found: &SphereBox, colour: [u8; 3]) -> RgbImage {
    let side = (AROUND * (found.to - found.from).max_element()).max(MIN_CUT_PX);
    let from = (found.from + found.to) / 2.0 - side / 2.0;
    let mut cut = RgbImage::new(side.ceil() as u32, side.ceil() as u32);
    imageops::replace(&mut cut, picture, -(from.x.floor() as i64), -(from.y.floor() as i64));
    let mut large = scaled(&cut, SIDE_PX, SIDE_PX);
    let scale = f64::from(SIDE_PX) / side.ceil();
    frame_box(&mut large, (found.from - from.floor()) * scale, (found.to - from.floor()) * scale, Rgb(colour));
    large
}
