//! What must be known before the first frame of any source: topics, lens, field, masks of the robot's body.

use std::sync::Arc;

use thiserror::Error;

use super::log_scan::StreamInfo;
use super::warnings::AttitudeSource;
use realitysim_config::{ConfigError, LensFileError, Settings, Topics, lens_from_camera_info, load_lens};
use realitysim_geometry::{Field, FieldDimensions, Lens, LensError, LensParameters};
use realitysim_localization::observation;
use realitysim_log_input::FrameAssembler;
use realitysim_log_input::body_mask;
use realitysim_log_input::log::LogError;
use realitysim_log_input::synchroniser::{Expected, Synchroniser, SynchroniserState};
use realitysim_log_input::topic_resolution::TopicError;
use realitysim_log_input::transforms::{ChainError, Head};
use realitysim_ros2::messages::CameraInfo;
use realitysim_vision::{BodyMask, Vision, VisionSettings};

/// Why the pipeline cannot be set up.
#[derive(Debug, Error)]
pub enum SetupError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A topic is missing or ambiguous.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// The field or lens file is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The calibration message does not describe a lens.
    #[error("{topic}: {source}")]
    CameraInfo {
        /// The topic of the calibration.
        topic: String,
        /// What is wrong.
        source: LensFileError,
    },
    /// The calibration is of binned or cropped images.
    #[error("{topic}: binning or a region of interest is set: record whole images, or give a lens file of the part")]
    CameraInfoPart {
        /// The topic of the calibration.
        topic: String,
    },
    /// `camera.fov_deg` is not possible with this lens.
    #[error("camera.fov_deg: {0}")]
    Fov(#[from] LensError),
    /// There is no calibration message, and the settings name no lens.
    #[error("{topic}: the log has no message that can be read")]
    NoMessage {
        /// The topic of the calibration.
        topic: String,
    },
    /// The transforms cannot lead to the camera.
    #[error(transparent)]
    Mount(#[from] ChainError),
    /// A mask of the robot's body cannot be used.
    #[error("{png}: {message}")]
    BodyMask {
        /// The mask's file.
        png: String,
        /// What is wrong.
        message: String,
    },
}

/// Everything that the pipeline needs before the first message, checked.
pub struct Setup {
    /// The settings.
    pub settings: Settings,
    /// The topics of the settings, with those that were found in place of missing ones.
    pub topics: Topics,
    /// The lens.
    pub lens: LensParameters,
    /// Dimensions of the field, as its file states them.
    pub dimensions: FieldDimensions,
    /// The field.
    pub field: Field,
    /// Vision and body masks, shared by threads.
    pub perception: Arc<FramePerception>,
    /// Kinds of measurements that the source has, so that frames wait for them.
    pub expected: Expected,
    /// State with the constant transforms.
    pub synchroniser: SynchroniserState,
    /// Where the torso's attitude comes from.
    pub attitude: AttitudeSource,
}

impl Setup {
    /// What makes frames of the source's messages. `state` is that of a checkpoint, where the source begins with one. With
    /// `initial_is_given`, poses that are announced in the messages are ignored.
    pub fn assembler(&self, state: Option<SynchroniserState>, initial_is_given: bool) -> FrameAssembler {
        let state = state.unwrap_or_else(|| self.synchroniser.clone());
        let mut synchroniser = Synchroniser::new(self.settings.frames.clone(), state);
        synchroniser.expect(self.expected);
        FrameAssembler::new(self.topics.clone(), self.settings.head.clone(), synchroniser, initial_is_given)
    }

    /// Loads and checks lens, field and body masks for a source.
    pub fn new(settings: Settings, prelude: StreamInfo) -> Result<Self, SetupError> {
        let lens = lens(&settings, &prelude)?;
        let (field, dimensions) = field(&settings)?;
        let perception = Arc::new(FramePerception::new(&settings, &lens, field.line_width())?);
        let StreamInfo { topics, expected, synchroniser, attitude, .. } = prelude;
        let lens = lens.parameters().clone();
        Ok(Self { settings, topics, lens, dimensions, field, perception, expected, synchroniser, attitude })
    }
}

/// What is needed to look at an image: vision for the lens, and the masks of the robot's body.
pub struct FramePerception {
    /// Vision for the lens.
    pub vision: Vision,
    bodies: Vec<BodyRange>,
}

/// A mask of the robot's body with the ranges of the head joints that it is for.
struct BodyRange {
    mask: BodyMask,
    pan_rad: Option<[f64; 2]>,
    tilt_rad: Option<[f64; 2]>,
}

/// The lens of the configured file, or else of the log's calibration.
fn lens(settings: &Settings, prelude: &StreamInfo) -> Result<Lens, SetupError> {
    let mut parameters: LensParameters = match (&settings.camera.lens, &prelude.camera_info) {
        (Some(file), _) => load_lens(file)?.lens.parameters().clone(),
        (None, Some(info)) => lens_of(info, &prelude.topics.camera_info)?,
        (None, None) => return Err(SetupError::NoMessage { topic: prelude.topics.camera_info.clone() }),
    };
    parameters.fov_deg = settings.camera.fov_deg.or(parameters.fov_deg);
    Ok(Lens::new(parameters)?)
}

/// The lens that a calibration message describes.
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
    let dimensions = settings.field_dimensions()?;
    let field =
        Field::new(dimensions.clone()).map_err(|source| ConfigError::Field { file: settings.field.clone(), source })?;
    Ok((field, dimensions))
}

impl FramePerception {
    /// Prepares vision for a lens and a width of field lines, and loads the body masks of the settings.
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

    /// All body masks, each as [`BodyMask::runs`].
    pub fn body_masks(&self) -> Vec<Vec<u32>> {
        self.bodies.iter().map(|body| body.mask.runs()).collect()
    }

    /// The first mask whose ranges contain the head's joint angles; an unknown head counts as pan and tilt 0.
    pub fn body(&self, head: Option<Head>) -> Option<&BodyMask> {
        let head = head.unwrap_or(Head { pan: 0.0, tilt: 0.0 });
        let within =
            |range: Option<[f64; 2]>, angle: f64| range.is_none_or(|[low, high]| (low..=high).contains(&angle));
        let fits = |body: &&BodyRange| within(body.pan_rad, head.pan) && within(body.tilt_rad, head.tilt);
        self.bodies.iter().find(fits).map(|body| &body.mask)
    }
}
