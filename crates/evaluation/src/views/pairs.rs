//! Real images taken from one position, each warped into the view of another: VisualMesh images with their lens files.

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

/// Similarity of a target image and a source image warped into its view.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// Number of the source image.
    pub source: u32,
    /// Number of the target image.
    pub target: u32,
    /// Number of pixels that both images show.
    pub overlap: usize,
    /// Peak signal-to-noise ratio over the overlap, dB.
    pub raw_db: f64,
    /// Peak signal-to-noise ratio after one gain per channel, fitted on the overlap, dB.
    pub gain_db: f64,
    /// Structural similarity after the same gains.
    pub gain_ssim: f64,
}

/// Reason why pairs cannot be evaluated.
#[derive(Debug, Error)]
pub enum PairError {
    /// The table or an image is unusable.
    #[error("{}: {what}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Description of the problem.
        what: String,
    },
    /// A lens file is unusable.
    #[error(transparent)]
    Lens(#[from] ConfigError),
    /// The view cannot be made.
    #[error(transparent)]
    View(#[from] ViewError),
}

/// Largest size of the table of pairs, bytes. A pair takes ten bytes.
const MAX_PAIRS_BYTES: u64 = 16 << 20;
/// File name of the table of pairs.
const TABLE: &str = "same_centre_pairs.csv";
/// Share of the field of view that is used: the rim of the image circle is left out.
const INNER: f64 = 0.98;

/// Evaluates all pairs that the table `same_centre_pairs.csv` in `folder` names.
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

/// Warps the source image into the view of the target and compares them.
fn pair(source: &Image, target: &Image, field: &Field) -> Result<Pair, PairError> {
    let world = World::without_goals(field);
    let image = Pyramid::new(source.pixels.clone());
    let candidate = Candidate {
        id: u64::from(source.id),
        camera: &source.camera,
        // Both cameras get one position: the heights in the files differ by rounding only.
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
