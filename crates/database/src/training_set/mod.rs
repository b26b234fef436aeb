//! A training set for programs that learn a scene from posed images: 3D Gaussian splatting, NeRF.
//!
//! [`TrainingSet::of`] selects images, and finds seed points and the brightness of each image. [`colmap`] and [`nerfstudio`] write what
//! the trainers read. All that is theirs alone, such as the place of a pixel's centre and the axes of a camera, is in these two modules.

pub mod colmap;
pub mod nerfstudio;
mod seed_points;
mod trainer_lens;

use std::collections::HashMap;

use super::error::DatabaseError;
use super::image_database::ImageDatabase;
use super::record::Record;
use realitysim_geometry::{Isometry, LensParameters};

pub use seed_points::SeedPoint;
pub use trainer_lens::{LensFit, TrainerLens};

/// Images of a database from which a trainer can learn the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingSet {
    /// The lenses, each with what it becomes for the trainer.
    pub cameras: Vec<LensFit>,
    /// The images, in the order of the database.
    pub images: Vec<TrainingImage>,
    /// Points of the ground, the goals and the hall, to begin the training from.
    pub points: Vec<SeedPoint>,
    /// Number of images whose pose is not known well enough.
    pub imprecise: usize,
    /// Number of images left out because a better one was taken nearly at the same pose.
    pub repeated: usize,
    /// Images that cannot be read, with the reason.
    pub unreadable: Vec<String>,
}

/// One image of a training set.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainingImage {
    /// Number of the record in the database's index.
    pub number: usize,
    /// File name without ending, of at least six digits.
    pub stem: String,
    /// Ending of the image's file: `jpg` or `png`.
    pub ending: &'static str,
    /// Number of the lens in [`TrainingSet::cameras`].
    pub camera: usize,
    /// `map_from_camera_optical_frame`.
    pub map_from_optical: Isometry,
    /// Time of exposure, nanoseconds; 0 if it is not known.
    pub stamp_ns: i64,
    /// Whether the image is left out of the training, to measure its result.
    pub held_out: bool,
    /// Pixel values of red, green and blue over those of the seed points; 1 where the image shows too few of these.
    pub gain: [f64; 3],
}

/// Side of a cell of which one image is taken, metres.
const CELL_M: f64 = 0.05;
/// The same of directions, as a difference of unit vectors: three degrees.
const CELL_DIRECTION: f64 = 0.05;
/// Every n-th image is held out, as is usual since LLFF (Mildenhall et al. 2019).
const HELD_OUT_EVERY: usize = 8;

/// What both formats add to a pixel's coordinates: the centre of their first pixel is (0.5, 0.5), ours is (0, 0).
const FIRST_CENTRE: f64 = 0.5;

/// Callback that gets the numbers of images read so far, and of all.
pub type TrainingProgress<'a> = &'a mut dyn FnMut(u64, u64);

impl TrainingSet {
    /// Selects the images whose position has a standard deviation of at most `max_sigma_m` metres, one for each cell of 5 cm and three
    /// degrees, and finds seed points and brightness.
    ///
    /// # Errors
    ///
    /// [`DatabaseError::Empty`] without any image, [`DatabaseError::Training`] if no pose is known well enough, or the lens cannot be
    /// stated in the trainers' models.
    pub fn of(
        database: &ImageDatabase,
        max_sigma_m: f64,
        progress: TrainingProgress<'_>,
    ) -> Result<Self, DatabaseError> {
        let (precise, imprecise) = precise_records(database, max_sigma_m)?;
        let chosen = one_of_each_cell(&precise);
        let repeated = precise.len() - chosen.len();
        let (cameras, camera_of) = cameras(database, &chosen)?;
        let all = chosen.len() as u64;
        let points = seed_points::seed_points(database, &chosen, &mut |done, of| progress(done, of + all));
        let first = seed_points::SAMPLED_IMAGES.min(chosen.len()) as u64;
        let (mut images, mut unreadable) = (Vec::new(), Vec::new());
        for (done, (number, record)) in chosen.iter().enumerate() {
            progress(first + done as u64, first + all);
            let read = database.image(*number).and_then(|image| Ok((image, database.ending_of(record)?)));
            let (image, ending) = match read {
                Ok(read) => read,
                Err(why) => {
                    unreadable.push(why);
                    continue;
                }
            };
            let Some(camera) = database.camera(record) else { continue };
            let map_from_optical = record.pose() * Isometry::link_from_optical();
            images.push(TrainingImage {
                number: *number,
                stem: format!("{number:06}"),
                ending,
                camera: camera_of[record.source as usize],
                map_from_optical,
                stamp_ns: record.stamp_ns,
                held_out: is_held_out(images.len()),
                gain: seed_points::gain(&points, camera, &map_from_optical, image.full()),
            });
        }
        Ok(Self { cameras, images, points, imprecise, repeated, unreadable })
    }
}

impl TrainingImage {
    /// Name of the image's file.
    pub fn file(&self) -> String {
        format!("{}.{}", self.stem, self.ending)
    }

    /// Name of its mask, which is black where the trainer should not look: the file's name and `.png`, as COLMAP has it.
    pub fn mask_file(&self) -> String {
        format!("{}.png", self.file())
    }
}

/// Whether an image of a training set is left out of the training, by its place among all.
pub fn is_held_out(place: usize) -> bool {
    place % HELD_OUT_EVERY == HELD_OUT_EVERY / 2
}

/// The images whose position has a standard deviation of at most `max_sigma_m` metres, and the number of others.
///
/// # Errors
///
/// [`DatabaseError::Empty`] without any image, [`DatabaseError::Training`] if none is known that well.
pub fn precise_records(
    database: &ImageDatabase,
    max_sigma_m: f64,
) -> Result<(Vec<(usize, Record)>, usize), DatabaseError> {
    let index = database.index();
    if index.is_empty() {
        return Err(DatabaseError::Empty);
    }
    let precise: Vec<(usize, Record)> =
        index.records().enumerate().filter(|(_, record)| record.tag().position_m <= max_sigma_m).collect();
    if precise.is_empty() {
        let best = index.records().map(|record| record.tag().position_m).fold(f64::INFINITY, f64::min);
        return Err(DatabaseError::Training(format!(
            "no image's position is known to {max_sigma_m} m; the best is known to {best:.3} m: `realitysim refine CAPTURE` makes \
             poses better, and --max-sigma takes worse ones"
        )));
    }
    let imprecise = index.len() - precise.len();
    Ok((precise, imprecise))
}

/// The image of each cell that is known best, in the order of the database.
fn one_of_each_cell(records: &[(usize, Record)]) -> Vec<(usize, Record)> {
    let mut best: HashMap<[i64; 6], (usize, Record)> = HashMap::new();
    for (number, record) in records {
        let pose = record.pose();
        let direction = pose.rotation * glam::DVec3::X;
        let cell = |value: f64, side: f64| libm::floor(value / side) as i64;
        let place = pose.translation.to_array().map(|metres| cell(metres, CELL_M));
        let looks = direction.to_array().map(|part| cell(part, CELL_DIRECTION));
        let key = [place[0], place[1], place[2], looks[0], looks[1], looks[2]];
        let known = best.entry(key).or_insert((*number, *record));
        if record.tag().position_m < known.1.tag().position_m {
            *known = (*number, *record);
        }
    }
    let mut chosen: Vec<(usize, Record)> = best.into_values().collect();
    chosen.sort_by_key(|(number, _)| *number);
    chosen
}

/// The lenses of the chosen images, and for each source the number of its lens.
fn cameras(database: &ImageDatabase, chosen: &[(usize, Record)]) -> Result<(Vec<LensFit>, Vec<usize>), DatabaseError> {
    let sources = &database.contents().sources;
    let mut lenses: Vec<&LensParameters> = Vec::new();
    let mut fits = Vec::new();
    let mut camera_of = vec![0; sources.len()];
    for (number, source) in sources.iter().enumerate() {
        if !chosen.iter().any(|(_, record)| record.source as usize == number) {
            continue;
        }
        camera_of[number] = match lenses.iter().position(|lens| **lens == source.lens) {
            Some(known) => known,
            None => {
                let fit = LensFit::of(&source.lens);
                fits.push(fit.map_err(|why| DatabaseError::Training(format!("{}: {why}", source.path.display())))?);
                lenses.push(&source.lens);
                lenses.len() - 1
            }
        };
    }
    Ok((fits, camera_of))
}
