//! A training set for programs that learn a scene (3D Gaussian splatting, NeRF), of a capture or of a database.

use std::path::Path;

use anyhow::Context;
use serde::Serialize;

use super::super::opened_database::OpenedDatabase;
use super::super::output;
use super::super::paths::{make_folder, write, write_bytes};
use super::super::settings::UsageError;
use super::frames::fill_own_folder;
use crate::database::ImageDatabase;
use crate::database::training_set::{TrainingImage, TrainingSet, colmap, nerfstudio};
use crate::recording::Loss;
use crate::views::SURE;

/// The trainers whose formats are written.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Trainer {
    Colmap,
    Nerfstudio,
}

/// A lens model that is farther off its lens, in pixels, is told.
const TOLD_ERROR_PX: f64 = 0.05;

/// Exports a capture, or a database. Returns the number of images, and what was lost.
pub(super) fn training_set(
    input: &Path,
    trainer: Trainer,
    max_sigma_m: f64,
    folder: &Path,
) -> anyhow::Result<(usize, Vec<Loss>)> {
    fill_own_folder(folder, || {
        let opened = OpenedDatabase::of(input, max_sigma_m)?;
        let (written, mut lost) = write_set(&opened.database, trainer, max_sigma_m, folder)?;
        for loss in opened.lost {
            loss.join(&mut lost);
        }
        Ok((written, lost))
    })
}

fn write_set(
    database: &ImageDatabase,
    trainer: Trainer,
    max_sigma_m: f64,
    folder: &Path,
) -> anyhow::Result<(usize, Vec<Loss>)> {
    let mut progress = output::Progress::new("preparing");
    let set = TrainingSet::of(database, max_sigma_m, &mut |done, all| progress.set(done, Some(all)))?;
    progress.finish();
    let model = match trainer {
        Trainer::Colmap => Vec::new(),
        // Before any image is written: a lens may be none of nerfstudio's.
        Trainer::Nerfstudio => vec![
            ("transforms.json".to_owned(), nerfstudio::transforms(&set).map_err(UsageError)?),
            (nerfstudio::SEED_FILE.to_owned(), nerfstudio::ply(&set)),
        ],
    };
    for part in [nerfstudio::IMAGES, nerfstudio::MASKS] {
        make_folder(&folder.join(part))?;
    }
    let mut progress = output::Progress::new("exporting");
    for (done, image) in set.images.iter().enumerate() {
        progress.set(done as u64, Some(set.images.len() as u64));
        write_image(database, image, folder)?;
    }
    progress.finish();
    for (name, text) in model {
        write(&folder.join(name), &text)?;
    }
    if trainer == Trainer::Colmap {
        let sparse = folder.join("sparse/0");
        make_folder(&sparse)?;
        write(&sparse.join("cameras.txt"), &colmap::cameras(&set))?;
        write(&sparse.join("images.txt"), &colmap::images(&set))?;
        write(&sparse.join("points3D.txt"), &colmap::points(&set))?;
    }
    write(&folder.join("held_out.txt"), &held_out(&set))?;
    write(&folder.join("light.json"), &light(database, &set)?)?;
    say(&set);
    let lost = set.unreadable.iter().map(|why| Loss::new(folder, why.clone())).collect();
    Ok((set.images.len(), lost))
}

/// Writes an image as it is stored, and its mask: white where it shows the scene, black outside of the lens's circle, on the robot's own
/// body and on what moves.
fn write_image(database: &ImageDatabase, image: &TrainingImage, folder: &Path) -> anyhow::Result<()> {
    let record = database.index().record(image.number);
    let file = database.file_of(&record).map_err(anyhow::Error::msg)?;
    write_bytes(&folder.join(nerfstudio::IMAGES).join(image.file()), &file)?;
    let shown = database.image(image.number).map_err(anyhow::Error::msg)?;
    let raster = shown.full();
    let white = raster.pixels.iter().map(|pixel| if pixel[3] == SURE { 255 } else { 0 }).collect();
    let mask = image::GrayImage::from_raw(raster.width as u32, raster.height as u32, white);
    let path = folder.join(nerfstudio::MASKS).join(image.mask_file());
    let written = mask.context("a mask of its image's size")?.save(&path);
    written.with_context(|| path.display().to_string())
}

/// The names of the images that no trainer should learn from, so that results can be compared.
fn held_out(set: &TrainingSet) -> String {
    set.images.iter().filter(|image| image.held_out).map(|image| format!("{}\n", image.file())).collect()
}

/// Brightness of the images, and vignetting of the lenses.
fn light(database: &ImageDatabase, set: &TrainingSet) -> anyhow::Result<String> {
    #[derive(Serialize)]
    struct Light {
        images: Vec<ImageLight>,
        /// k1 to k3 of 1 + k1 r^2 + k2 r^4 + k3 r^6 for each source.
        vignetting: Vec<Option<[f64; 3]>>,
    }
    #[derive(Serialize)]
    struct ImageLight {
        file: String,
        stamp_ns: i64,
        gain_rgb: [f64; 3],
        source: u32,
    }
    let images = set.images.iter().map(|image| ImageLight {
        file: image.file(),
        stamp_ns: image.stamp_ns,
        gain_rgb: image.gain.map(|gain| (1e4 * gain).round() / 1e4),
        source: database.index().record(image.number).source,
    });
    let vignetting = database.contents().sources.iter().map(|source| source.darkening);
    Ok(serde_json::to_string_pretty(&Light { images: images.collect(), vignetting: vignetting.collect() })?)
}

/// Tells what was chosen, and lenses that the trainers' model only approximates.
fn say(set: &TrainingSet) {
    let TrainingSet { images, points, imprecise, repeated, .. } = set;
    let held_out = images.iter().filter(|image| image.held_out).count();
    output::say(&format!(
        "{} images, {held_out} of them held out, and {} seed points; left out: {repeated} nearly at the pose of another, {imprecise} \
         whose place is not known well enough",
        images.len(),
        points.len()
    ));
    for fit in set.cameras.iter().filter(|fit| fit.max_error_px > TOLD_ERROR_PX) {
        output::say(&format!("the trainers' fisheye model is up to {:.2} px off the lens", fit.max_error_px));
    }
}
