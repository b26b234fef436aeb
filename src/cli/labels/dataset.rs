//! Labels all images of a database on all processors, and writes the files in their order.

use std::fmt::Write;
use std::path::Path;
use std::time::Instant;

use anyhow::Context;
use image::RgbImage;

use super::super::opened_database::OpenedDatabase;
use super::super::paths::{make_folder, write, write_bytes};
use super::make::{Classes, Format, MakeArguments, Report};
use super::png_form::{FOLDERS, PngForm, TableRows};
use super::posed_images::{IMAGES, PosedImages};
use super::preview::{PREVIEWS, preview, sheet};
use super::yolo_set::write_yolo_set;
use crate::database::training_set::precise_records;
use crate::database::{ImageDatabase, Record, in_parallel};
use crate::labels::coco::{Coco, CocoImage};
use crate::labels::yolo;
use crate::labels::{Class, ClassList, Labeller, PosedImage, Visibility};
use crate::recording::Loss;

/// Images that are labelled before their results are put together.
const BATCH: usize = 64;

/// The labels of one image.
struct Labelled {
    file: String,
    coco: Option<CocoImage>,
    /// Lines of the image in the tables of the form png.
    rows: TableRows,
    sigmas_px: Vec<f64>,
    ignored: usize,
    pixels: usize,
    preview: Option<RgbImage>,
}

/// Labels the images of a database. `progress` gets the number of images done and of all.
pub(super) fn label_all(
    arguments: &MakeArguments,
    opened: &OpenedDatabase,
    progress: &mut dyn FnMut(u64, u64),
) -> anyhow::Result<Report> {
    let MakeArguments { output: folder, max_sigma, .. } = arguments;
    let database = &opened.database;
    let (chosen, imprecise) = precise_records(database, *max_sigma)?;
    let job = Job::new(arguments, database)?;
    job.make_folders()?;
    let start = Instant::now();
    let (mut done, mut unreadable) = (Vec::new(), Vec::new());
    let every = chosen.len().div_ceil(PREVIEWS).max(1);
    for (batch, part) in chosen.chunks(BATCH).enumerate() {
        let first = batch * BATCH;
        progress(first as u64, chosen.len() as u64);
        let results = in_parallel(part.len(), |place| {
            let (number, record) = &part[place];
            job.label(first + place, *number, record, (first + place).is_multiple_of(every))
        });
        for result in results {
            match result {
                Ok(labelled) => done.push(labelled),
                Err(Failure::Unreadable(why)) => unreadable.push(Loss::new(folder, why)),
                Err(Failure::Output(error)) => return Err(error),
            }
        }
    }
    progress(chosen.len() as u64, chosen.len() as u64);
    let seconds = start.elapsed().as_secs_f64();
    anyhow::ensure!(
        !done.is_empty(),
        "no image can be read: {}",
        unreadable.first().map(ToString::to_string).unwrap_or_default()
    );
    job.write_tables(&mut done)?;
    Ok(report(arguments, opened, &done, imprecise, seconds, unreadable))
}

fn report(
    arguments: &MakeArguments,
    opened: &OpenedDatabase,
    done: &[Labelled],
    imprecise: usize,
    seconds: f64,
    unreadable: Vec<Loss>,
) -> Report {
    let mut sigmas: Vec<f64> = done.iter().flat_map(|labelled| labelled.sigmas_px.iter().copied()).collect();
    sigmas.sort_by(f64::total_cmp);
    let sum = |of: fn(&Labelled) -> usize| done.iter().map(of).sum::<usize>() as f64;
    let mut lost = opened.lost.clone();
    lost.extend(unreadable);
    Report {
        output: arguments.output.clone(),
        images: done.len(),
        imprecise,
        visible_landmarks: sigmas.len(),
        sigma_px: sigmas.get(sigmas.len() / 2).copied(),
        ignored_share: sum(|labelled| labelled.ignored) / sum(|labelled| labelled.pixels).max(1.0),
        images_per_s: done.len() as f64 / seconds.max(1e-9),
        lost,
    }
}

/// Why an image has no labels.
enum Failure {
    /// The image cannot be read.
    Unreadable(String),
    /// The labels cannot be written.
    Output(anyhow::Error),
}

/// What is the same for all images.
struct Job<'a> {
    images: PosedImages<'a>,
    labeller: Labeller,
    format: Format,
    classes: ClassList,
    folder: &'a Path,
}

impl<'a> Job<'a> {
    fn new(arguments: &'a MakeArguments, database: &'a ImageDatabase) -> anyhow::Result<Self> {
        let labeller = Labeller::new(database.field(), database.world().has_goals());
        let classes = arguments.classes.unwrap_or(Classes::Landmarks).list();
        let images = PosedImages::new(database)?;
        Ok(Self { images, labeller, format: arguments.format, classes, folder: &arguments.output })
    }

    fn make_folders(&self) -> anyhow::Result<()> {
        let others: &[&str] = match self.format {
            Format::Coco => &[],
            Format::Yolo | Format::YoloSeg | Format::YoloPose => &["labels"],
            Format::Png => &FOLDERS,
        };
        [IMAGES].iter().chain(others).try_for_each(|name| make_folder(&self.folder.join(name)))
    }

    /// Labels an image, and writes it with the files that it has alone. `place` is its number among all images that are labelled.
    fn label(&self, place: usize, number: usize, record: &Record, previewed: bool) -> Result<Labelled, Failure> {
        let database = self.images.database();
        let image = database.image(number).map_err(Failure::Unreadable)?;
        let file = database.file_of(record).map_err(Failure::Unreadable)?;
        let ending = database.ending_of(record).map_err(Failure::Unreadable)?;
        let name = format!("{number:06}.{ending}");
        let shown = image.full().mask();
        let posed = self.images.posed(record, &shown).map_err(Failure::Unreadable)?;
        let classes = self.labeller.classes(&posed);
        write_bytes(&self.folder.join(IMAGES).join(&name), &file).map_err(Failure::Output)?;
        let rows = self.write_own(&name, &posed, &classes).map_err(Failure::Output)?;
        let keypoints = self.labeller.keypoints(&posed);
        let visible = keypoints.iter().filter(|keypoint| keypoint.visibility == Visibility::Visible);
        Ok(Labelled {
            coco: (self.format == Format::Coco)
                .then(|| CocoImage::new(&self.labeller, &posed, &classes, place + 1, &name)),
            rows,
            sigmas_px: visible.map(|keypoint| keypoint.sigma_px).collect(),
            ignored: classes
                .iter()
                .zip(posed.camera.shows())
                .filter(|(class, drawn)| **drawn && **class == Class::Ignore)
                .count(),
            pixels: posed.camera.shows().iter().filter(|drawn| **drawn).count(),
            preview: previewed.then(|| preview(&self.labeller, &posed, image.full(), &classes)),
            file: name,
        })
    }

    fn png(&self) -> PngForm<'_> {
        PngForm { folder: self.folder, labeller: &self.labeller, world: self.images.database().world() }
    }

    /// Writes the files that an image has alone. Returns its lines in the tables of the form png.
    fn write_own(&self, name: &str, image: &PosedImage, classes: &[Class]) -> anyhow::Result<TableRows> {
        let text = |text: String| write(&self.folder.join("labels").join(name).with_extension("txt"), &text);
        match self.format {
            Format::Coco => Ok(()),
            Format::Yolo => text(yolo::boxes(&self.labeller, image, self.classes)),
            Format::YoloSeg => text(yolo::outlines(&self.labeller, image)),
            Format::YoloPose => text(yolo::keypoints(&self.labeller, image)),
            Format::Png => return self.png().write_image(name, image, classes),
        }?;
        Ok(TableRows::default())
    }

    /// Writes what all images have together.
    fn write_tables(&self, done: &mut [Labelled]) -> anyhow::Result<()> {
        let folder = self.folder;
        match self.format {
            Format::Coco => {
                let mut coco = Coco::new(&self.labeller);
                done.iter_mut().filter_map(|labelled| labelled.coco.take()).for_each(|image| coco.push(image));
                write(&folder.join("annotations.json"), &coco.text())?;
            }
            Format::Yolo | Format::YoloSeg | Format::YoloPose => self.write_yolo(done)?,
            Format::Png => self.png().write_tables(done.iter().map(|labelled| &labelled.rows))?,
        }
        let pictures: Vec<(RgbImage, String)> =
            done.iter_mut().filter_map(|labelled| Some((labelled.preview.take()?, labelled.file.clone()))).collect();
        let path = folder.join("preview.jpg");
        sheet(&pictures).save(&path).with_context(|| path.display().to_string())?;
        Ok(())
    }

    /// Writes which images are for the training and which for the test, and what the classes and keypoints are.
    fn write_yolo(&self, done: &[Labelled]) -> anyhow::Result<()> {
        let names: &[&str] = match self.format {
            Format::YoloSeg => &["line"],
            Format::YoloPose => &["field"],
            _ => self.classes.names,
        };
        let mut more = String::new();
        if self.format == Format::YoloPose {
            let landmarks: Vec<&str> =
                self.labeller.landmarks().iter().map(|landmark| landmark.name.as_str()).collect();
            let _ = writeln!(more, "kpt_shape: [{}, 3]", landmarks.len());
            let _ = writeln!(more, "flip_idx: {:?}", yolo::mirrored(&self.labeller));
            let _ = writeln!(more, "# Keypoints: {}", landmarks.join(" "));
        }
        let files: Vec<&str> = done.iter().map(|labelled| labelled.file.as_str()).collect();
        write_yolo_set(self.folder, &files, &more, names)
    }
}
