//! A single image and the prior knowledge of how it was taken.

use std::cmp::Ordering;
use std::path::Path;
use std::sync::Once;

use anyhow::Context;
use clap::Args;
use image::RgbImage;

use super::paths::cannot_read;
use super::settings::{UsageError, numbers};
use super::values::any_number;
use crate::config::{LensFile, LensFormat, load_lens_for_image, plain_file};
use crate::geometry::{Euler, Field, Lens, Pose2};
use crate::log_input::{body_mask, decode};
use crate::recording::{SESSION_FILE, read_info};
use crate::tagging::image_location::{ImageLocation, MIN_SHARE, MIN_WEIGHT, PoseHypothesis};
use crate::tagging::single_image::{ImagePrior, Look, MEASURED_HEIGHT_SIGMA_M};
use crate::tagging::unknown_mount::UnknownMount;
use crate::tagging::warnings::scaled_lens;
use crate::vision::{BodyMask, Picture};

#[derive(Args)]
pub struct PhotoArguments {
    /// Of an image: roll (-180 to 180) and pitch (-90 to 90) of camera_link, pitch > 0 looks down (a VisualMesh file has its own)
    #[arg(long, value_name = "roll_deg,pitch_deg", value_parser = attitude, allow_hyphen_values = true)]
    attitude: Option<Euler>,
    /// How wrong that may be: standard deviation of roll and pitch, 0 to 5 [default: 2]
    #[arg(long, value_name = "DEG", value_parser = attitude_sigma, allow_negative_numbers = true)]
    attitude_sigma: Option<f64>,
    /// Of an image: height of camera_link above the carpet, 0.01 to 100 (a VisualMesh file has its own)
    #[arg(long, value_name = "M", allow_negative_numbers = true, value_parser = any_number)]
    height: Option<f64>,
}

/// Standard deviation of roll and pitch if none is given, degrees.
const ATTITUDE_SIGMA_DEG: f64 = 2.0;

/// Inputs of a command besides the image.
pub struct OtherInputs<'a> {
    pub lens: &'a str,
    pub body_mask: Option<&'a str>,
    /// Approximate pose of `camera_link`.
    pub initial: Option<Pose2>,
}

/// A camera whose attitude and height are known, or not.
pub enum Camera {
    Known(ImagePrior),
    Unknown(UnknownMount),
}

impl Camera {
    /// Finds the poses on each field that explain the picture.
    pub fn locate<'f>(
        &self,
        picture: &Picture,
        fields: &'f [(String, Field)],
        seed: u64,
    ) -> Vec<(&'f str, &'f Field, ImageLocation)> {
        match self {
            Self::Known(known) => locate_known(known, picture, fields, seed),
            Self::Unknown(unknown) => {
                let locate =
                    |(name, field): &'f (String, Field)| (name.as_str(), field, unknown.locate(picture, field, seed));
                fields.iter().map(locate).collect()
            }
        }
    }

    pub fn lens(&self) -> &Lens {
        match self {
            Self::Known(known) => &known.lens,
            Self::Unknown(unknown) => &unknown.lens,
        }
    }
}

/// Number of fields that are searched closely.
const SEARCHED_CLOSELY: usize = 2;

/// Finds the poses on each field that explain a picture of a camera whose attitude and height are known.
///
/// Of many fields, those that a survey of each finds best are searched closely.
fn locate_known<'f>(
    known: &ImagePrior,
    picture: &Picture,
    fields: &'f [(String, Field)],
    seed: u64,
) -> Vec<(&'f str, &'f Field, ImageLocation)> {
    if let [(name, field)] = fields {
        return vec![(name, field, known.locate(&known.look(picture, field.line_width()), field, seed))];
    }
    // What a picture shows depends on how wide its lines are, and most fields share a width.
    let mut looks: Vec<(f64, Look)> = Vec::new();
    for (_, field) in fields {
        if looks.iter().all(|(width_m, _)| *width_m != field.line_width()) {
            looks.push((field.line_width(), known.look(picture, field.line_width())));
        }
    }
    let mut located = Vec::new();
    for (name, field) in fields {
        let Some((_, look)) = looks.iter().find(|(width_m, _)| *width_m == field.line_width()) else { continue };
        located.push((name.as_str(), field, known.locate_by_survey(look, field, seed), look));
    }
    located.sort_by(|a, b| by_fit(&a.2, &b.2));
    for (_, field, found, look) in located.iter_mut().take(SEARCHED_CLOSELY) {
        *found = known.locate(look, field, seed);
    }
    located.into_iter().map(|(name, field, found, _)| (name, field, found)).collect()
}

/// The order of locations, the most trusted first. Wide lines are seen farther away, so that log likelihoods on fields with other
/// lines compare only roughly.
pub fn by_fit(a: &ImageLocation, b: &ImageLocation) -> Ordering {
    let score = |located: &ImageLocation| located.found.first().map_or(f64::NEG_INFINITY, |found| found.log_likelihood);
    a.fit().cmp(&b.fit()).then(score(b).total_cmp(&score(a)))
}

/// What is known of an image's camera.
struct Facts {
    lens: Lens,
    attitude: Option<Euler>,
    tilt_sigma_rad: f64,
    height_m: Option<f64>,
    body: Option<BodyMask>,
}

impl PhotoArguments {
    /// Name of the first argument that is given, if any.
    pub fn first_given(&self) -> Option<&'static str> {
        let given = [
            (self.attitude.is_some(), "--attitude"),
            (self.attitude_sigma.is_some(), "--attitude-sigma"),
            (self.height.is_some(), "--height"),
        ];
        given.into_iter().find_map(|(is_given, name)| is_given.then_some(name))
    }

    /// Reads the image, its lens and mask. Attitude and height must be known.
    pub fn open(&self, image: &Path, beside: &OtherInputs) -> anyhow::Result<(Picture, ImagePrior)> {
        let (picture, facts) = self.facts(image, beside)?;
        let Facts { lens, attitude, tilt_sigma_rad, height_m, body } = facts;
        let missing = |what: &str| UsageError(format!("{what} is missing, and {} does not say it", beside.lens));
        let attitude = attitude.ok_or_else(|| missing("--attitude"))?;
        let height_m = height_m.ok_or_else(|| missing("--height"))?;
        let (height_sigma_m, initial) = (MEASURED_HEIGHT_SIGMA_M, beside.initial);
        Ok((picture, ImagePrior { lens, attitude, tilt_sigma_rad, height_m, height_sigma_m, initial, body }))
    }

    /// Reads the image, its lens and mask. What is not known of attitude and height is left to be found from the lines.
    pub fn open_any(&self, image: &Path, beside: &OtherInputs) -> anyhow::Result<(Picture, Camera)> {
        let (picture, facts) = self.facts(image, beside)?;
        let Facts { lens, attitude, tilt_sigma_rad, height_m, body } = facts;
        let initial = beside.initial;
        let camera = match (attitude, height_m) {
            (Some(attitude), Some(height_m)) => {
                let height_sigma_m = MEASURED_HEIGHT_SIGMA_M;
                Camera::Known(ImagePrior { lens, attitude, tilt_sigma_rad, height_m, height_sigma_m, initial, body })
            }
            (attitude, height_m) => {
                let attitude = attitude.map(|attitude| (attitude, tilt_sigma_rad));
                Camera::Unknown(UnknownMount { lens, attitude, height_m, initial, body })
            }
        };
        Ok((picture, camera))
    }

    fn facts(&self, image: &Path, beside: &OtherInputs) -> anyhow::Result<(Picture, Facts)> {
        let bytes = plain_file::read(image, decode::MAX_IMAGE_FILE_BYTES).map_err(|error| cannot_read(image, error))?;
        let picture = decode::compressed(&bytes).with_context(|| image.display().to_string())?;
        let (width, height) = (picture.width as u32, picture.height as u32);
        let lens = lens_for_image(beside.lens, width, height).with_context(|| image.display().to_string())?;
        if let Some(stated) = lens.scaled_from {
            // Many images have one lens.
            static SAID: Once = Once::new();
            SAID.call_once(|| {
                eprintln!("realitysim: warning: {}", scaled_lens(beside.lens, stated, [width, height]));
            });
        }
        let stated = lens.visual_mesh_pose.map(|pose| pose.world_from_camera_link);
        let attitude = self.attitude.or(stated.map(|pose| pose.euler()));
        let height_m = self.height_above_carpet(beside.lens, stated.map(|pose| pose.translation.z))?;
        let body = match beside.body_mask {
            Some(png) => {
                Some(body_mask(png, width, height).map_err(|message| UsageError(format!("{png}: {message}")))?)
            }
            None => None,
        };
        let tilt_sigma_rad = self.attitude_sigma.unwrap_or(ATTITUDE_SIGMA_DEG).to_radians();
        Ok((picture, Facts { lens: lens.lens, attitude, tilt_sigma_rad, height_m, body }))
    }

    /// The same arguments with what is known of one image in place of what holds for all.
    pub fn of_image(&self, attitude: Option<Euler>, height_m: Option<f64>) -> Self {
        let Self { attitude_sigma, .. } = *self;
        Self { attitude: attitude.or(self.attitude), attitude_sigma, height: height_m.or(self.height) }
    }

    fn height_above_carpet(&self, lens: &str, stated: Option<f64>) -> Result<Option<f64>, UsageError> {
        let (height_m, source) = match (self.height, stated) {
            (Some(height_m), _) => (height_m, "--height".to_owned()),
            (None, Some(height_m)) => (height_m, format!("{lens}: the height in Hoc")),
            (None, None) => return Ok(None),
        };
        if (0.01..=100.0).contains(&height_m) {
            return Ok(Some(height_m));
        }
        Err(UsageError(format!("{source} is {height_m}: it must be 0.01 to 100 m")))
    }
}

/// Loads a lens for an image; of a capture or one of its segments that with which it was tagged.
fn lens_for_image(lens: &str, width: u32, height: u32) -> anyhow::Result<LensFile> {
    let path = Path::new(lens);
    let session = if path.is_dir() { Some(path) } else { path.parent().filter(|_| is_log(path)) };
    let Some(session) = session.filter(|session| session.join(SESSION_FILE).is_file()) else {
        return Ok(load_lens_for_image(lens, width, height)?);
    };
    let known = read_info(session)?.lens;
    let size = [known.width, known.height];
    let scaled = known.scaled_to([width, height]).with_context(|| {
        format!("{lens}: its lens is for images of {} x {}, and this one has {width} x {height}", size[0], size[1])
    })?;
    Ok(LensFile {
        title: lens.to_owned(),
        format: LensFormat::Own,
        lens: Lens::new(scaled)?,
        scaled_from: (size != [width, height]).then_some(size),
        visual_mesh_pose: None,
    })
}

/// Whether a path names a segment of a capture.
fn is_log(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == "mcap" || ending == "active")
}

/// Returns the picture's pixels, to draw on.
pub fn rgb(picture: &Picture) -> anyhow::Result<RgbImage> {
    RgbImage::from_raw(picture.width as u32, picture.height as u32, picture.to_rgb())
        .context("the picture's pixels do not fit its size")
}

/// Explains why even the best pose is not accepted.
pub fn explain_no_pose(located: Option<&ImageLocation>) -> String {
    let best = located.and_then(|located| located.found.first());
    let is_unknown = located.is_some_and(|located| !located.mount_is_known);
    let found = match best {
        Some(best) if is_unknown && !is_too_weak(best) && !best.is_determined() => {
            "its lines do not determine attitude and height: state --attitude and --height".to_owned()
        }
        Some(best) if is_unknown && !is_too_weak(best) && located.is_some_and(|located| located.rival().is_some()) => {
            "two poses with different attitudes or heights explain its lines equally well: state --attitude and --height".to_owned()
        }
        None => "there is no line of a field where the ground is in view".to_owned(),
        Some(best) if !is_too_weak(best) => {
            "the best pose's lines lie where chance would put some as well".to_owned()
        }
        Some(best) => format!(
            "the best explains {:.0} % of the expected line contrast on {:.1} m of certain line, and {:.0} % on {:.1} m are \
             needed",
            100.0 * best.share,
            0.1 * best.weight,
            100.0 * MIN_SHARE,
            0.1 * MIN_WEIGHT
        ),
    };
    format!("{found}: check the image, --lens, --attitude, --height and --field")
}

/// Whether there is less line contrast than any pose needs.
fn is_too_weak(best: &PoseHypothesis) -> bool {
    best.share < MIN_SHARE || best.weight < MIN_WEIGHT
}

fn attitude_sigma(text: &str) -> Result<f64, String> {
    let [degrees] = numbers::<1>(text, "degrees")?;
    if (0.0..=5.0).contains(&degrees) { Ok(degrees) } else { Err(format!("it is {degrees}: it must be 0 to 5")) }
}

fn attitude(text: &str) -> Result<Euler, String> {
    let [roll_deg, pitch_deg] = numbers::<2>(text, "roll_deg,pitch_deg")?;
    for (name, value, most) in [("roll_deg", roll_deg, 180.0), ("pitch_deg", pitch_deg, 90.0)] {
        if value.abs() > most {
            return Err(format!("{name} is {value}: it must be -{most} to {most}"));
        }
    }
    Ok(Euler { yaw: 0.0, pitch: pitch_deg.to_radians(), roll: roll_deg.to_radians() })
}
