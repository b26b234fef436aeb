//! What must be known before the first frame: topics, lens, field, the camera's mount, the robot's body.

use std::collections::BTreeMap;

use thiserror::Error;

use crate::config::{ConfigError, LensFileError, Settings, Topics, lens_from_camera_info, load_field, load_lens};
use crate::geometry::{Field, FieldDimensions, Lens, LensError, LensParameters};
use crate::localization::observation;
use crate::ros2::mcap_read::{LogMessage, Selection};
use crate::ros2::messages::CameraInfo;
use crate::sensors::body_mask;
use crate::sensors::intake::{self, Input};
use crate::sensors::log::LogError;
use crate::sensors::synchroniser::{Expected, Synchroniser, SynchroniserState};
use crate::sensors::topics::{TopicError, TopicTypes, resolve};
use crate::sensors::transforms::{ChainError, Head};
use crate::vision::{BodyMask, Vision, VisionSettings};

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

/// Read from a first pass over the log, which touches calibration and transforms only.
pub struct Prelude {
    pub topics: Topics,
    pub camera_info: Option<CameraInfo>,
    /// Constants are known from the start, wherever in the log they stand.
    pub synchroniser: SynchroniserState,
    pub expected: Expected,
}

/// Everything about seeing, ready for use.
pub struct Eyes {
    pub vision: Vision,
    bodies: Vec<BodyRange>,
}

struct BodyRange {
    mask: BodyMask,
    pan_rad: Option<[f64; 2]>,
    tilt_rad: Option<[f64; 2]>,
}

impl Prelude {
    pub fn read(
        settings: &Settings,
        types: &TopicTypes,
        messages: impl Fn(Selection) -> Box<dyn Iterator<Item = Result<LogMessage, LogError>>>,
    ) -> Result<Self, SetupError> {
        let configured = &settings.topics;
        let wanted = types
            .iter()
            .filter(|(topic, kind)| {
                kind.as_str() == "sensor_msgs/msg/CameraInfo"
                    || **topic == configured.tf
                    || **topic == configured.tf_static
                    || kind.as_str() == "tf2_msgs/msg/TFMessage"
            })
            .map(|(topic, _)| topic.clone());
        let found: Vec<LogMessage> = first_of_each(messages(Selection::topics(wanted)))?;
        let odometry_in_tf = found.iter().any(|message| moves_footprint(message, settings));
        let topics = resolve(settings, types, odometry_in_tf)?;
        let mut synchroniser = Synchroniser::new(settings.frames.clone(), SynchroniserState::default());
        let mut camera_info = None;
        for message in &found {
            match intake::read(message, &topics, &settings.head) {
                Ok(Input::CameraInfo(info)) => camera_info = camera_info.or(Some(*info)),
                Ok(input @ Input::Transforms { latched: true, .. }) => synchroniser.push(message, input),
                _ => {}
            }
        }
        let first_frame = messages(Selection::topics([topics.image.clone()]))
            .find(|message| message.as_ref().map_or(true, |message| message.channel.topic == topics.image));
        check_mount(synchroniser.clone(), &found, first_frame.transpose()?.as_ref(), &topics, settings)?;
        let has = |topic: &String, kind: &str| types.get(topic).is_some_and(|found| found == kind);
        let expected = Expected {
            imu: has(&topics.imu, "sensor_msgs/msg/Imu"),
            joints: has(&topics.joints, "sensor_msgs/msg/JointState"),
        };
        Ok(Self { topics, camera_info, synchroniser: synchroniser.state().clone(), expected })
    }
}

/// Whether the camera can be where the log says, before anything is written.
fn check_mount(
    mut synchroniser: Synchroniser,
    found: &[LogMessage],
    first_frame: Option<&LogMessage>,
    topics: &Topics,
    settings: &Settings,
) -> Result<(), SetupError> {
    // The first frame tells what its optical frame is called.
    for message in found.iter().chain(first_frame) {
        let input = intake::read(message, topics, &settings.head);
        if let Ok(input @ (Input::Transforms { latched: false, .. } | Input::Frame { .. })) = input {
            synchroniser.push(message, input);
        }
    }
    let moving = found.iter().filter(|message| message.channel.topic == topics.tf).count();
    Ok(synchroniser.check_mount(moving >= ENOUGH as usize)?)
}

/// More messages of one topic than this are not needed to know calibration and constants.
const ENOUGH: u32 = 200;

fn first_of_each(messages: impl Iterator<Item = Result<LogMessage, LogError>>) -> Result<Vec<LogMessage>, LogError> {
    let mut counts: BTreeMap<u16, u32> = BTreeMap::new();
    let mut kept = Vec::new();
    for message in messages {
        let message = message?;
        let count = counts.entry(message.channel.id).or_default();
        *count += 1;
        if *count <= ENOUGH {
            kept.push(message);
        }
    }
    Ok(kept)
}

fn moves_footprint(message: &LogMessage, settings: &Settings) -> bool {
    let names = &settings.frames;
    let is_step = |t: &intake::StampedTransform| t.parent == names.odom && t.child == names.base_footprint;
    matches!(
        intake::read(message, &settings.topics, &settings.head),
        Ok(Input::Transforms { transforms, .. }) if transforms.iter().any(is_step)
    )
}

/// The configured lens file, else what the log says of its camera.
pub fn lens(settings: &Settings, prelude: &Prelude) -> Result<Lens, SetupError> {
    let mut parameters: LensParameters = match (&settings.camera.lens, &prelude.camera_info) {
        (Some(file), _) => load_lens(file)?.lens.parameters().clone(),
        (None, Some(info)) => {
            let topic = || prelude.topics.camera_info.clone();
            let binned = info.binning_x > 1 || info.binning_y > 1;
            let roi = &info.roi;
            let whole = (roi.width, roi.height) == (info.width, info.height) || (roi.width, roi.height) == (0, 0);
            if binned || !whole {
                return Err(SetupError::CameraInfoPart { topic: topic() });
            }
            lens_from_camera_info(info.width, info.height, &info.distortion_model, &info.d, &info.k)
                .map_err(|source| SetupError::CameraInfo { topic: topic(), source })?
        }
        (None, None) => return Err(SetupError::NoMessage { topic: prelude.topics.camera_info.clone() }),
    };
    parameters.fov_deg = settings.camera.fov_deg.or(parameters.fov_deg);
    Ok(Lens::new(parameters)?)
}

pub fn field(settings: &Settings) -> Result<(Field, FieldDimensions), SetupError> {
    let dimensions = load_field(&settings.field)?;
    let field =
        Field::new(dimensions.clone()).map_err(|source| ConfigError::Field { file: settings.field.clone(), source })?;
    Ok((field, dimensions))
}

impl Eyes {
    pub fn new(settings: &Settings, lens: Lens) -> Result<Self, SetupError> {
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
            range_m: f.range_m,
            tilt_sigma_rad: f.tilt_sigma_deg.to_radians(),
            nearest_reach_m: f.nearest_reach_m,
        };
        Ok(Self { vision: Vision::new(lens, vision), bodies })
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
