//! A first pass over a log, before its first frame: it reads calibration, transforms and one image only.

use std::collections::BTreeMap;

use super::setup::SetupError;
use super::warnings::AttitudeSource;
use realitysim_config::{Settings, Topics};
use realitysim_log_input::decode;
use realitysim_log_input::log::LogError;
use realitysim_log_input::measurement::{self, Measurement};
use realitysim_log_input::synchroniser::{Expected, Synchroniser, SynchroniserState};
use realitysim_log_input::topic_resolution::{TopicTypes, resolve};
use realitysim_ros2::mcap_read::{LogMessage, Selection};
use realitysim_ros2::messages::{CameraInfo, Imu, JointState, Message, TFMessage};

/// What a stream of messages says about topics, calibration and constant transforms.
pub struct StreamInfo {
    /// The topics of the settings, with those that were found in place of missing ones.
    pub topics: Topics,
    /// The first calibration message, if there is one.
    pub camera_info: Option<CameraInfo>,
    /// Width and height of the first image whose size can be read, pixels.
    pub image_size: Option<[u32; 2]>,
    /// State with the constant transforms, which count from the start wherever in the log they stand.
    pub synchroniser: SynchroniserState,
    /// Kinds of measurements that the stream has, so that frames wait for them.
    pub expected: Expected,
    /// Where the torso's attitude comes from.
    pub attitude: AttitudeSource,
}

/// Messages of each calibration and transform channel that are read; more are not needed to know the constants.
const ENOUGH: u32 = 200;

/// Images whose size is tried to be read: of a camera that begins with broken ones, some later image will do.
const MAX_SIZES_TRIED: usize = 30;

impl StreamInfo {
    /// Reads the calibration and transforms of a stream, resolves its topics and checks the camera's mount.
    ///
    /// `types` are the message types of each topic; `messages` gives the messages of a selection of topics from the start.
    pub fn read(
        settings: &Settings,
        types: &TopicTypes,
        messages: impl Fn(Selection) -> Box<dyn Iterator<Item = Result<LogMessage, LogError>>>,
    ) -> Result<Self, SetupError> {
        let configured = &settings.topics;
        let wanted = types
            .iter()
            .filter(|(topic, kinds)| {
                kinds.contains(CameraInfo::TYPE)
                    || kinds.contains(TFMessage::TYPE)
                    || **topic == configured.tf
                    || **topic == configured.tf_static
            })
            .map(|(topic, _)| topic.clone());
        let found: Vec<LogMessage> = first_of_each(messages(Selection::topics(wanted)))?;
        let odometry_in_tf = found.iter().any(|message| moves_footprint(message, settings));
        let topics = resolve(settings, types, odometry_in_tf)?;
        let mut synchroniser = Synchroniser::new(settings.frames.clone(), SynchroniserState::default());
        let mut camera_info = None;
        for message in &found {
            match measurement::read(message, &topics, &settings.head) {
                Ok(Measurement::CameraInfo(info)) => camera_info = camera_info.or(Some(*info)),
                Ok(input @ Measurement::Transforms { latched: true, .. }) => synchroniser.push(message, input),
                _ => {}
            }
        }
        let mut frames = messages(Selection::topics([topics.image.clone()])).filter(|message| {
            message.as_ref().map_or(true, |message| measurement::is_frame(&message.channel, &topics))
        });
        let first_frame = frames.next().transpose()?;
        check_mount(synchroniser.clone(), &found, first_frame.as_ref(), &topics, settings)?;
        let image_size = first_frame
            .as_ref()
            .and_then(decode::stated_size)
            .or_else(|| frames.by_ref().take(MAX_SIZES_TRIED).find_map(|message| decode::stated_size(&message.ok()?)));
        drop(frames);
        let has = |topic: &String, kind: &str| types.get(topic).is_some_and(|kinds| kinds.contains(kind));
        let expected = Expected { imu: has(&topics.imu, Imu::TYPE), joints: has(&topics.joints, JointState::TYPE) };
        let imus =
            types.iter().filter(|(_, kinds)| kinds.contains(Imu::TYPE)).map(|(topic, _)| topic.clone()).collect();
        let attitude = AttitudeSource { topic: topics.imu.clone(), all: imus };
        Ok(Self { topics, camera_info, image_size, synchroniser: synchroniser.state().clone(), expected, attitude })
    }
}

/// Checks that the transforms can lead to the camera, before anything is written.
fn check_mount(
    mut synchroniser: Synchroniser,
    found: &[LogMessage],
    first_frame: Option<&LogMessage>,
    topics: &Topics,
    settings: &Settings,
) -> Result<(), SetupError> {
    // The first frame names the coordinate frame of the camera.
    for message in found.iter().chain(first_frame) {
        let input = measurement::read(message, topics, &settings.head);
        if let Ok(input @ (Measurement::Transforms { latched: false, .. } | Measurement::Frame { .. })) = input {
            synchroniser.push(message, input);
        }
    }
    let moving = found.iter().filter(|message| message.channel.topic == topics.tf).count();
    Ok(synchroniser.check_mount(moving >= ENOUGH as usize)?)
}

/// The first [`ENOUGH`] messages of each channel.
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

/// Whether a message has the transform from `odom` to `base_footprint`, which is odometry.
fn moves_footprint(message: &LogMessage, settings: &Settings) -> bool {
    let names = &settings.frames;
    let is_step = |t: &measurement::StampedTransform| t.parent == names.odom && t.child == names.base_footprint;
    matches!(
        measurement::read(message, &settings.topics, &settings.head),
        Ok(Measurement::Transforms { transforms, .. }) if transforms.iter().any(is_step)
    )
}
