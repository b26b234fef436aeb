//! What must be known before the first frame, whatever it comes from: topics, lens, field, the robot's body.

use std::sync::Arc;

use thiserror::Error;

use super::log_scan::StreamInfo;
use super::warnings::AttitudeSource;
use realitysim_config::{ConfigError, LensFileError, Settings, Topics, lens_from_camera_info, load_field, load_lens};
use realitysim_geometry::{Field, FieldDimensions, Lens, LensError, LensParameters};
use realitysim_localization::observation;
use realitysim_log_input::body_mask;
use realitysim_log_input::log::LogError;
use realitysim_log_input::synchroniser::{Expected, SynchroniserState};
use realitysim_log_input::topic_resolution::TopicError;
use realitysim_log_input::transforms::{ChainError, Head};
use realitysim_ros2::messages::CameraInfo;
use realitysim_vision::{BodyMask, Vision, VisionSettings};

#[derive(Debug, Error)]
pub enum SetupError {
    #[error(transparent)]
    Log(#[from] LogError),
    #[error(transparent)]
    Topic(#[from] TopicError),
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error("{topic}: {source}")]
    CameraInfo { topic: String, source: LensFileError },
    #[error("{topic}: binning or a region of interest is set: record whole images, or give a lens file of the part")]
    CameraInfoPart { topic: String },
    #[error("camera.fov_deg: {0}")]
    Fov(#[from] LensError),
    #[error("{topic}: the log has no message that can be read")]
    NoMessage { topic: String },
    #[error(transparent)]
    Mount(#[from] ChainError),
    #[error("{png}: {message}")]
    BodyMask { png: String, message: String },
}

/// All that the pipeline works with, checked.
pub struct Setup {
    pub settings: Settings,
    /// Of the settings, or those found in their place.
    pub topics: Topics,
    pub lens: LensParameters,
    pub dimensions: FieldDimensions,
    pub field: Field,
    pub eyes: Arc<FramePerception>,
    pub expected: Expected,
    /// The transforms that are constant.
    pub synchroniser: SynchroniserState,
    pub attitude: AttitudeSource,
}

impl Setup {
    pub fn new(settings: Settings, prelude: StreamInfo) -> Result<Self, SetupError> {
        let lens = lens(&settings, &prelude)?;
        let (field, dimensions) = field(&settings)?;
        let eyes = Arc::new(FramePerception::new(&settings, &lens, field.line_width())?);
        let StreamInfo { topics, expected, synchroniser, attitude, .. } = prelude;
        let lens = lens.parameters().clone();
        Ok(Self { settings, topics, lens, dimensions, field, eyes, expected, synchroniser, attitude })
    }
}

/// Everything about seeing, ready for use.
pub struct FramePerception {
    pub vision: Vision,
    bodies: Vec<BodyRange>,
}

struct BodyRange {
    mask: BodyMask,
    pan_rad: Option<[f64; 2]>,
    tilt_rad: Option<[f64; 2]>,
}

/// The configured lens file, else what the log says of its camera.
fn lens(settings: &Settings, prelude: &StreamInfo) -> Result<Lens, SetupError> {
    let mut parameters: LensParameters = match (&settings.camera.lens, &prelude.camera_info) {
        (Some(file), _) => load_lens(file)?.lens.parameters().clone(),
        (None, Some(info)) => lens_of(info, &prelude.topics.camera_info)?,
        (None, None) => return Err(SetupError::NoMessage { topic: prelude.topics.camera_info.clone() }),
    };
    parameters.fov_deg = settings.camera.fov_deg.or(parameters.fov_deg);
    Ok(Lens::new(parameters)?)
}

fn lens_of(info: &CameraInfo, topic: &str) -> Result<LensParameters, SetupError> {
    let binned = info.binning_x > 1 || info.binning_y > 1;
    let roi = &info.roi;
    let whole = (roi.width, roi.height) == (info.width, info.height) || (roi.width, roi.height) == (0, 0);
    if binned || !whole {
        return Err(SetupError::CameraInfoPart { topic: topic.to_owned() });
    }
    lens_from_camera_info(info.width, info.height, &info.distortion_model, &info.d, &info.k)
        .map_err(|source| SetupError::CameraInfo { topic: topic.to_owned(), source })
}

fn field(settings: &Settings) -> Result<(Field, FieldDimensions), SetupError> {
    let dimensions = load_field(&settings.field)?;
    let field =
        Field::new(dimensions.clone()).map_err(|source| ConfigError::Field { file: settings.field.clone(), source })?;
    Ok((field, dimensions))
}

impl FramePerception {
    pub fn new(settings: &Settings, lens: &Lens, line_width_m: f64) -> Result<Self, SetupError> {
        let f = &settings.filter;
        let bodies = settings
            .camera
            .body_mask
            .iter()
            .map(|file| {
                let radians = |range: Option<[f64; 2]>| range.map(|[low, high]| [low.to_radians(), high.to_radians()]);
                let mask = body_mask(&file.png, lens.width(), lens.height())
                    .map_err(|message| SetupError::BodyMask { png: file.png.clone(), message })?;
                Ok(BodyRange { mask, pan_rad: radians(file.pan_deg), tilt_rad: radians(file.tilt_deg) })
            })
            .collect::<Result<_, SetupError>>()?;
        let vision = VisionSettings {
            reading: observation::reading(f.model, f.formula),
            line_width_m,
            range_m: f.range_m,
            tilt_sigma_rad: f.tilt_sigma_deg.to_radians(),
            nearest_reach_m: f.nearest_reach_m,
            reduction: f.image_reduction,
        };
        Ok(Self { vision: Vision::new(lens, vision), bodies })
    }

    /// [`BodyMask::runs`] of all of them.
    pub fn body_masks(&self) -> Vec<Vec<u32>> {
        self.bodies.iter().map(|body| body.mask.runs()).collect()
    }

    /// The first mask whose ranges hold the head.
    pub fn body(&self, head: Option<Head>) -> Option<&BodyMask> {
        let head = head.unwrap_or(Head { pan: 0.0, tilt: 0.0 });
        let within =
            |range: Option<[f64; 2]>, angle: f64| range.is_none_or(|[low, high]| (low..=high).contains(&angle));
        let fits = |body: &&BodyRange| within(body.pan_rad, head.pan) && within(body.tilt_rad, head.tilt);
        self.bodies.iter().find(fits).map(|body| &body.mask)
    }
}
