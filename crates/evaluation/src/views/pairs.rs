//! Real images of one camera's place turned into each other: VisualMesh images with their lens files.

use std::path::{Path, PathBuf};

use serde::Serialize;
use thiserror::Error;

use realitysim_config::{ConfigError, load_lens_for_image, plain_file};
use realitysim_geometry::{Field, Isometry, Lens, LensParameters};
use realitysim_log_input::decode::MAX_IMAGE_FILE_BYTES;
use realitysim_views::{
    Camera, Candidate, Method, NOTHING, Provenance, Pyramid, Raster, Request, TagError, ViewError, ViewSettings,
    Vignetting, World, similarity, view,
};

/// One image as seen through the other.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pair {
    pub source: u32,
    pub target: u32,
    /// Pixels that both show.
    pub overlap: usize,
    pub raw_db: f64,
    /// After one gain per channel, fitted on the overlap.
    pub gain_db: f64,
    pub gain_ssim: f64,
}

#[derive(Debug, Error)]
pub enum PairError {
    #[error("{}: {what}", path.display())]
    File { path: PathBuf, what: String },
    #[error(transparent)]
    Lens(#[from] ConfigError),
    #[error(transparent)]
    View(#[from] ViewError),
}

/// A pair takes ten bytes.
const MAX_PAIRS_BYTES: u64 = 16 << 20;
const TABLE: &str = "same_centre_pairs.csv";
/// The rim of the fisheye's circle is kept off.
const INNER: f64 = 0.98;

/// All pairs that the folder's table names.
pub fn pairs(folder: &Path, field: &Field) -> Result<Vec<Pair>, PairError> {
    let table = folder.join(TABLE);
    let failed = |what: String| PairError::File { path: table.clone(), what };
    let text = plain_file::read_text(&table, MAX_PAIRS_BYTES).map_err(|error| failed(error.to_string()))?;
    let number = |cell: Option<&str>| cell.and_then(|cell| cell.parse().ok());
    let mut pairs = Vec::new();
    for line in text.lines().skip(1) {
        let mut cells = line.split(',');
        let ids = number(cells.next()).zip(number(cells.next()));
        let (source, target) = ids.ok_or_else(|| failed(format!("not a pair: {line:?}")))?;
        pairs.push(pair(&Image::read(folder, source)?, &Image::read(folder, target)?, field)?);
    }
    Ok(pairs)
}

struct Image {
    id: u32,
    camera: Camera,
    pose: Isometry,
    pixels: Raster,
}

impl Image {
    fn read(folder: &Path, id: u32) -> Result<Self, PairError> {
        let path = folder.join(format!("image{id:07}.jpg"));
        let failed = |what: String| PairError::File { path: path.clone(), what };
        let bytes = plain_file::read(&path, MAX_IMAGE_FILE_BYTES).map_err(|error| failed(error.to_string()))?;
        let image = image::load_from_memory(&bytes).map_err(|error| failed(error.to_string()))?.into_rgb8();
        let (width, height) = image.dimensions();
        let lens = folder.join(format!("lens{id:07}.yaml")).display().to_string();
        let file = load_lens_for_image(&lens, width, height)?;
        let pose =
            file.visual_mesh_pose.ok_or_else(|| failed("its lens file does not say how it was turned".to_owned()))?;
        let parameters = file.lens.parameters();
        let fov_deg = parameters.fov_deg.map(|fov| INNER * fov);
        let inner =
            Lens::new(LensParameters { fov_deg, ..parameters.clone() }).map_err(|error| failed(error.to_string()))?;
        let camera = Camera::new(&inner);
        let pixels = Raster::from_rgb(width as usize, height as usize, image.as_raw(), camera.shows());
        let pixels = pixels.ok_or_else(|| failed("its pixels do not fit its size".to_owned()))?;
        Ok(Self { id, camera, pose: pose.world_from_camera_link, pixels })
    }
}

fn pair(source: &Image, target: &Image, field: &Field) -> Result<Pair, PairError> {
    let world = World::without_goals(field);
    let image = Pyramid::new(source.pixels.clone());
    let candidate = Candidate {
        id: u64::from(source.id),
        camera: &source.camera,
        // One place: the heights of the files differ by what they were rounded to.
        map_from_link: Isometry::new(source.pose.rotation, target.pose.translation),
        image: &image,
        tag: TagError::default(),
        vignetting: Vignetting::default(),
    };
    let request = Request {
        camera: &target.camera,
        map_from_link: target.pose,
        method: Method::Exact,
        world: &world,
        vignetting: Vignetting::default(),
        settings: ViewSettings { stored_within_m: -1.0, ..ViewSettings::default() },
    };
    let answer = view(&request, &[candidate])?;
    debug_assert_eq!(answer.made, Provenance::Warped);
    let shown: Vec<bool> = answer.image.pixels.iter().map(|pixel| pixel[3] != NOTHING).collect();
    let gain: [f64; 3] = core::array::from_fn(|c| {
        let both = || answer.image.pixels.iter().zip(&target.pixels.pixels).filter(|(a, _)| a[3] != NOTHING);
        let product: f64 = both().map(|(a, b)| f64::from(a[c]) * f64::from(b[c])).sum();
        product / both().map(|(a, _)| f64::from(a[c]).powi(2)).sum::<f64>().max(1e-9)
    });
    let scaled: Vec<[u8; 4]> = (answer.image.pixels.iter())
        .map(|pixel| {
            core::array::from_fn(|c| {
                if c < 3 { (f64::from(pixel[c]) * gain[c]).round().min(255.0) as u8 } else { pixel[3] }
            })
        })
        .collect();
    let width = target.camera.width();
    let wanted = target.camera.shows();
    let raw = similarity(&target.pixels.pixels, &answer.image.pixels, width, wanted, &shown);
    let gained = similarity(&target.pixels.pixels, &scaled, width, wanted, &shown);
    let overlap = shown.iter().filter(|shown| **shown).count();
    let (raw_db, gain_db, gain_ssim) = (raw.psnr_db, gained.psnr_db, gained.ssim);
    Ok(Pair { source: source.id, target: target.id, overlap, raw_db, gain_db, gain_ssim })
}
