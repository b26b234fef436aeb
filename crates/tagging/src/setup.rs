//! What must be known before the first frame of any source: topics, lens, field, masks of the robot's body.

use std::sync::Arc;

use thiserror::Error;

use super::log_scan::StreamInfo;
use super::warnings::{self, AttitudeSource};
use realitysim_config::{
    ConfigError, LensFileError, Settings, Topics, lens_from_camera_info, load_lens, load_lens_for_image,
};
use realitysim_geometry::{Field, FieldDimensions, Lens, LensError, LensParameters};
use realitysim_localization::observation;
use realitysim_log_input::FrameAssembler;
use realitysim_log_input::body_mask;
use realitysim_log_input::log::LogError;
use realitysim_log_input::synchroniser::{Expected, Synchroniser, SynchroniserState};
use realitysim_log_input::topic_resolution::{PictureName, TopicChoice, TopicError};
use realitysim_log_input::transforms::{ChainError, Head};
use realitysim_ros2::messages::CameraInfo;
use realitysim_ros2::messages::schema::SchemaDifference;
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
    /// The calibration is of binned or cropped images of which nothing is left.
    #[error("{topic}: {what}")]
    CameraInfoPart {
        /// The topic of the calibration.
        topic: String,
        /// What is wrong with binning or region of interest, and what would be right.
        what: String,
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
    /// The type of a topic is defined otherwise than its name says.
    #[error(
        "{topic}: its type {type_name} is defined otherwise than this program reads it: {}. Record it with the usual definition, or \
         name another topic",
        told(difference)
    )]
    Schema {
        /// The topic.
        topic: String,
        /// Name of its type.
        type_name: String,
        /// The first field that differs.
        difference: Box<SchemaDifference>,
    },
    /// Some topics have no stamps, and the stamps of the images are of another clock than the log's times.
    #[error(
        "{unstamped} has no stamps, so that the times of the log stand for them, but the stamps on {stamped} are {:.1} s {} the log's: {}",
        offset_s.abs(),
        if *offset_s > 0.0 { "before" } else { "after" },
        off_clock(stamped, agreeing)
    )]
    Clocks {
        /// A topic without stamps.
        unstamped: String,
        /// The topic of the images.
        stamped: String,
        /// Time from stamp to log, seconds.
        offset_s: f64,
        /// A topic whose stamps agree with the times of the log.
        agreeing: Option<String>,
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

/// Says in which field a definition differs.
fn told(difference: &SchemaDifference) -> String {
    let SchemaDifference { within, found, expected } = difference;
    let within = if within.is_empty() { String::new() } else { format!(" of {within}") };
    let quoted = |field: &Option<String>| field.as_ref().map_or("nothing".to_owned(), |field| format!("`{field}`"));
    format!("it has {} where {}{within} is expected", quoted(found), quoted(expected))
}

/// Says which clock is off, and what mends it.
fn off_clock(stamped: &str, agreeing: &Option<String>) -> String {
    match agreeing {
        Some(agreeing) => format!(
            "those on {agreeing} agree with the log's, so the camera's clock is off. Set the clock that stamps {stamped} by the robot's"
        ),
        None => "the recorder's clock is not the one that stamps. Record with that clock (of a simulation with `ros2 bag record \
                 --use-sim-time`), and keep the times of the log when it is converted"
            .to_owned(),
    }
}

/// Everything that the pipeline needs before the first message, checked.
pub struct Setup {
    /// The settings.
    pub settings: Settings,
    /// The topics of the settings, with those that were found in place of missing ones.
    pub topics: Topics,
    /// The lens.
    pub lens: LensParameters,
    /// What a user should know about how the lens was found.
    pub lens_warning: Option<String>,
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
    /// The topics that are read, and why each was chosen.
    pub choices: Vec<TopicChoice>,
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
        let (lens, lens_warning) = lens(&settings, &prelude)?;
        let (field, dimensions) = field(&settings)?;
        let perception = Arc::new(FramePerception::new(&settings, &lens, field.line_width())?);
        let StreamInfo { topics, expected, synchroniser, attitude, choices, .. } = prelude;
        let lens = lens.parameters().clone();
        Ok(Self {
            settings,
            topics,
            lens,
            lens_warning,
            dimensions,
            field,
            perception,
            expected,
            synchroniser,
            attitude,
            choices,
        })
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

/// The lens of the configured file, or else of the log's calibration, for the log's images; with a warning if it was scaled to them.
///
/// Where the aspect ratio of the images is another, the lens stays as it is: each of the frames is rejected by its size.
fn lens(settings: &Settings, prelude: &StreamInfo) -> Result<(Lens, Option<String>), SetupError> {
    let (origin, mut parameters) = match (&settings.camera.lens, &prelude.camera_info) {
        (Some(file), _) => (file, lens_of_file(file, prelude.image_size)?),
        (None, Some(info)) => (&prelude.topics.camera_info, lens_of(info, &prelude.topics)?),
        (None, None) => return Err(SetupError::NoMessage { topic: prelude.topics.camera_info.clone() }),
    };
    parameters.fov_deg = settings.camera.fov_deg.or(parameters.fov_deg);
    let lens = Lens::new(parameters)?;
    let stated = [lens.width(), lens.height()];
    let scaled = prelude.image_size.filter(|size| *size != stated);
    match scaled.and_then(|size| lens.parameters().scaled_to(size)) {
        Some(scaled) => {
            let warning = warnings::scaled_lens(origin, stated, [scaled.width, scaled.height]);
            Ok((Lens::new(scaled)?, Some(warning)))
        }
        None => Ok((lens, None)),
    }
}

/// The lens of a file as it stands there; one that does not state the size of its image gets that of the log's.
fn lens_of_file(file: &str, image_size: Option<[u32; 2]>) -> Result<LensParameters, SetupError> {
    let read = match (load_lens(file), image_size) {
        (Err(ConfigError::Lens { source: LensFileError::ImageSizeUnknown, .. }), Some([width, height])) => {
            load_lens_for_image(file, width, height)
        }
        (read, _) => read,
    };
    Ok(read?.lens.parameters().clone())
}

/// The lens that a calibration message describes: that of the part of the image which the message says is sent.
///
/// The matrix is that of the whole image. The region of interest counts in its pixels, and `binning_x` by `binning_y` of them
/// make one pixel of the image (ros2/common_interfaces, sensor_msgs/msg/CameraInfo.msg).
///
/// `k` and `d` are those of the camera itself. A rectified picture has no distortion, and its intrinsics are the left part of `p`.
/// Drivers that send nothing but rectified pictures state `d` as zeros and `k` as `p` has it.
fn lens_of(info: &CameraInfo, topics: &Topics) -> Result<LensParameters, SetupError> {
    let topic = &topics.camera_info;
    let [fx, skew, cx, _, below_fx, fy, cy, _, bottom @ .., _] = info.p;
    let is_rectified = PictureName::of(&topics.image).is_rectified() && info.d.iter().any(|d| *d != 0.0) && fx != 0.0;
    let (model, d, k) = if is_rectified {
        let [b0, b1, b2] = bottom;
        ("plumb_bob", &[][..], [fx, skew, cx, below_fx, fy, cy, b0, b1, b2])
    } else {
        (info.distortion_model.as_str(), &info.d[..], info.k)
    };
    let whole = lens_from_camera_info(info.width, info.height, model, d, &k)
        .map_err(|source| SetupError::CameraInfo { topic: topic.to_owned(), source })?;
    let refused = |what: String| SetupError::CameraInfoPart { topic: topic.to_owned(), what };
    let roi = &info.roi;
    let is_whole = (roi.x_offset, roi.y_offset, roi.width, roi.height) == (0, 0, 0, 0);
    let part = if is_whole {
        whole
    } else {
        let fits =
            |offset: u32, size: u32, all: u32| size > 0 && offset.checked_add(size).is_some_and(|end| end <= all);
        if !fits(roi.x_offset, roi.width, info.width) || !fits(roi.y_offset, roi.height, info.height) {
            let (width, height) = (info.width, info.height);
            return Err(refused(format!(
                "roi is {} x {} pixels from column {}, row {}: it must lie within width x height, {width} x {height}, or be all 0",
                roi.width, roi.height, roi.x_offset, roi.y_offset
            )));
        }
        whole.cropped([roi.x_offset, roi.y_offset], [roi.width, roi.height])
    };
    // 0 means the same as 1.
    let [x, y] = [info.binning_x, info.binning_y].map(|factor| factor.max(1));
    let sent = if [x, y] == [1, 1] { Some(part) } else { part.binned([x, y]) };
    let sent =
        sent.ok_or_else(|| refused(format!("binning_x, binning_y are {x}, {y}: no pixel is left of the image")))?;
    // Its numbers are judged here, under its name, before the settings add their field of view.
    let lens = Lens::new(sent)
        .map_err(|error| SetupError::CameraInfo { topic: topic.to_owned(), source: LensFileError::from(error) })?;
    Ok(lens.parameters().clone())
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
            tilt_sigma_rad: f.tilt_sigma_deg.to_radians(),
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
