//! A detector of the user's own, run on the forms of images, and what it makes of their landmarks.

use std::time::Instant;

use anyhow::Context;
use image::{Rgb, RgbImage};
use tempfile::TempDir;

use super::forms::{FORMS, HeldOut, WITHOUT_GOALS};
use crate::cli::detector::Detector;
use crate::cli::marks::{DIAGONAL, UPRIGHT, cross, rgb};
use crate::cli::paths::{save, temporary};
use crate::cli::pose_covariances::PoseCovariances;
use crate::database::ImageDatabase;
use crate::evaluation::perception::{
    Delay, DetectorReport, ErrorModel, JudgedPicture, Observations, angular_speeds, observe,
};
use crate::labels::{Detection, LANDMARK_CLASSES, Labeller, PosedImage, Visibility, parse_detections};
use crate::views::{Raster, SURE};

/// Half the length of a cross at a landmark or detection, pixels.
const CROSS_PX: i64 = 5;

/// A detector, and what it did on each form.
pub struct JudgedDetector<'a> {
    command: &'a str,
    detector: Detector,
    /// Whether the command has been started: only then its answers are timed.
    is_warm: bool,
    database: &'a ImageDatabase,
    labeller: Labeller,
    without_goals: Labeller,
    covariances: PoseCovariances,
    speeds_rad_s: Vec<Option<f64>>,
    folder: TempDir,
    forms: Vec<Judged>,
}

/// What a detector did on the images of one form.
#[derive(Default)]
struct Judged {
    observations: Observations,
    times_ms: Vec<f64>,
}

impl<'a> JudgedDetector<'a> {
    /// A detector that looks at images of a database.
    pub fn new(command: &'a str, database: &'a ImageDatabase) -> anyhow::Result<Self> {
        Ok(Self {
            command,
            detector: Detector::new(command),
            is_warm: false,
            database,
            labeller: Labeller::new(database.field(), database.world().has_goals()),
            without_goals: Labeller::new(database.field(), false),
            covariances: PoseCovariances::of(database)?,
            speeds_rad_s: camera_speeds(database),
            folder: temporary()?,
            forms: FORMS.iter().map(|_| Judged::default()).collect(),
        })
    }

    /// Has the detector look at one form of an image. Returns the form with what it found.
    pub fn look(&mut self, held_out: &HeldOut, form: usize) -> anyhow::Result<RgbImage> {
        let image = &held_out.images[form];
        let mut picture = rgb(image)?;
        let (detections, time_ms) = self.ask(&picture)?;
        let shown = judged_pixels(&held_out.images[0], image);
        let labeller = if form == WITHOUT_GOALS { &self.without_goals } else { &self.labeller };
        let posed = PosedImage {
            camera: &held_out.camera,
            map_from_link: held_out.pose,
            covariance: self.covariances.get(&held_out.record),
            shown: &shown,
            body: self.database.body(held_out.record.source),
        };
        let speed_rad_s = self.speeds_rad_s[held_out.number];
        let judged = JudgedPicture { labeller, image: posed, pixels: image, speed_rad_s };
        observe(&judged, &detections, &mut self.forms[form].observations);
        self.forms[form].times_ms.push(time_ms);
        draw(&mut picture, &judged, &detections);
        Ok(picture)
    }

    /// What the detector did on the images of one form.
    pub fn report(&self, form: usize) -> DetectorReport {
        let Judged { observations, times_ms } = &self.forms[form];
        DetectorReport::new(observations, Delay::of(times_ms.clone()))
    }

    /// The model of its errors on recorded images.
    pub fn error_model(&self) -> ErrorModel {
        let Judged { observations, times_ms } = &self.forms[0];
        ErrorModel::new(observations, Delay::of(times_ms.clone()))
    }

    /// What the detector finds in a picture, and how long that took, milliseconds.
    fn ask(&mut self, picture: &RgbImage) -> anyhow::Result<(Vec<Detection>, f64)> {
        let file = self.folder.path().join("picture.png");
        save(picture, &file)?;
        if !self.is_warm {
            // The first answer takes the start of the command, which is no delay of a camera's frame.
            self.detector.ask(&file)?;
            self.is_warm = true;
        }
        let start = Instant::now();
        let answer = self.detector.ask(&file)?;
        let time_ms = start.elapsed().as_secs_f64() * 1e3;
        let detections = parse_detections(&answer, LANDMARK_CLASSES)
            .with_context(|| format!("--detector {:?} printed", self.command))?;
        Ok((detections, time_ms))
    }
}

/// Which pixels show the scene in the recorded image and in another form of it.
fn judged_pixels(recorded: &Raster, image: &Raster) -> Vec<u8> {
    if recorded.pixels.len() != image.pixels.len() {
        return recorded.mask();
    }
    let both = recorded.pixels.iter().zip(&image.pixels);
    both.map(|(recorded, image)| if image[3] == SURE { recorded[3] } else { image[3] }).collect()
}

/// Angular speed of the camera at each image of a database, radians a second; `None` where its neighbours do not tell.
fn camera_speeds(database: &ImageDatabase) -> Vec<Option<f64>> {
    let mut order: Vec<(u32, i64, usize)> =
        database.index().records().enumerate().map(|(number, of)| (of.source, of.stamp_ns, number)).collect();
    order.sort_unstable();
    let mut speeds = vec![None; order.len()];
    for of_source in order.chunk_by(|a, b| a.0 == b.0) {
        let rotation = |number| database.index().record(number).pose().rotation;
        let tags: Vec<_> = of_source.iter().map(|(_, stamp_ns, number)| (*stamp_ns, rotation(*number))).collect();
        for ((_, _, number), speed) in of_source.iter().zip(angular_speeds(&tags)) {
            speeds[*number] = speed;
        }
    }
    speeds
}

/// Draws what was to be seen (yellow), and what was found of it (green) or of nothing (red).
fn draw(picture: &mut RgbImage, judged: &JudgedPicture, detections: &[Detection]) {
    let keypoints = judged.labeller.keypoints(&judged.image);
    let matched = judged.labeller.match_detections(&keypoints, detections, judged.image.camera.width());
    for keypoint in keypoints.iter().filter(|keypoint| keypoint.visibility == Visibility::Visible) {
        cross(picture, keypoint.at, UPRIGHT, CROSS_PX, Rgb([255, 255, 0]));
    }
    for (found, of) in detections.iter().zip(matched) {
        let colour = if of.is_some() { Rgb([0, 255, 0]) } else { Rgb([255, 40, 40]) };
        cross(picture, found.at, DIAGONAL, CROSS_PX, colour);
    }
}
