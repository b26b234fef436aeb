//! A first pass over a log, before its first frame: it reads calibration, transforms and one image only.

use std::collections::{BTreeMap, BTreeSet};

use super::setup::SetupError;
use super::warnings::{self, AttitudeSource};
use realitysim_config::{Settings, Topics};
use realitysim_log_input::decode;
use realitysim_log_input::log::LogError;
use realitysim_log_input::measurement::{self, Measurement};
use realitysim_log_input::synchroniser::{Expected, GONE_NS, Synchroniser, SynchroniserState};
use realitysim_log_input::topic_resolution::{self, ResolvedTopics, StreamFacts, TopicChoice, TopicTypes, resolve};
use realitysim_ros2::mcap_read::{Channel, LogMessage, Selection};
use realitysim_ros2::messages::{
    CameraInfo, Image, ImageView, Imu, JointState, LowState, Message, Odometer, TFMessage, schema,
};

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
    /// The topics that are read, and why each was chosen.
    pub choices: Vec<TopicChoice>,
    /// Findings that a user will want to know, as sentences.
    pub warnings: Vec<String>,
}

/// Gives the messages of a selection of topics from the start of a stream.
pub type Messages<'a> = &'a dyn Fn(Selection) -> Box<dyn Iterator<Item = Result<LogMessage, LogError>>>;

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
        let messages: Messages = &messages;
        let found = constants(settings, types, messages)?;
        let facts = facts(settings, types, &found, messages)?;
        let ResolvedTopics { topics, choices } = resolve(settings, types, &facts)?;
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
        check_schemas(&choices, messages)?;
        let warnings = check_clocks(&choices, &topics, settings, messages)?;
        let has = |topic: &String, kinds: &[&str]| {
            types.get(topic).is_some_and(|has| kinds.iter().any(|kind| has.contains(*kind)))
        };
        let expected = Expected {
            imu: has(&topics.imu, &[Imu::TYPE, LowState::TYPE]),
            joints: has(&topics.joints, &[JointState::TYPE, LowState::TYPE]),
        };
        let attitude = AttitudeSource { topic: topics.imu.clone(), all: topic_resolution::imus(types) };
        let synchroniser = synchroniser.state().clone();
        Ok(Self { topics, camera_info, image_size, synchroniser, expected, attitude, choices, warnings })
    }
}

/// Finds out which topics a stream would be read from, as [`StreamInfo::read`] does.
pub fn topics_of(settings: &Settings, types: &TopicTypes, messages: Messages) -> Result<ResolvedTopics, SetupError> {
    let found = constants(settings, types, messages)?;
    Ok(resolve(settings, types, &facts(settings, types, &found, messages)?)?)
}

/// The first messages of calibrations and transforms.
fn constants(settings: &Settings, types: &TopicTypes, messages: Messages) -> Result<Vec<LogMessage>, LogError> {
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
    first_of_each(messages(Selection::topics(wanted)))
}

/// What messages say about topics beyond their types.
fn facts(
    settings: &Settings,
    types: &TopicTypes,
    found: &[LogMessage],
    messages: Messages,
) -> Result<StreamFacts, LogError> {
    let odometry_in_tf = has_odometry_in_tf(found, settings);
    let (images, imus) = (topic_resolution::images(types), topic_resolution::imus(types));
    let mut facts = StreamFacts { odometry_in_tf, ..StreamFacts::default() };
    if images.len() > 1 && !images.contains(&settings.topics.image) {
        for topic in images {
            let first = first_of(&topic, messages)?;
            if first.is_some_and(|message| is_no_picture(&message)) {
                facts.not_pictures.insert(topic);
            }
        }
    }
    if imus.len() > 1 && !imus.contains(&settings.topics.imu) {
        facts.mounted_imus = mounted_imus(settings, found, imus, messages)?;
    }
    Ok(facts)
}

/// Whether a message is an image of something else than brightness or colour: depths, in the encodings of REP 118.
fn is_no_picture(message: &LogMessage) -> bool {
    message.channel.type_name == Image::TYPE
        && ImageView::decode(&message.data).is_ok_and(|image| ["16UC1", "32FC1"].contains(&image.encoding))
}

/// The inertial sensors whose coordinate frame constants connect to the torso.
fn mounted_imus(
    settings: &Settings,
    found: &[LogMessage],
    imus: Vec<String>,
    messages: Messages,
) -> Result<BTreeSet<String>, LogError> {
    let mut synchroniser = Synchroniser::new(settings.frames.clone(), SynchroniserState::default());
    for message in found {
        if let Ok(input @ Measurement::Transforms { .. }) = measurement::read(message, &settings.topics, &settings.head)
        {
            synchroniser.push(message, input);
        }
    }
    let mut mounted = BTreeSet::new();
    for topic in imus {
        let first = first_of(&topic, messages)?;
        let frame = first.and_then(|message| Imu::decode(&message.data).ok()).map(|imu| imu.header.frame_id);
        if frame.is_some_and(|frame| synchroniser.is_mounted_on_torso(&frame)) {
            mounted.insert(topic);
        }
    }
    Ok(mounted)
}

/// The first message of a topic.
fn first_of(topic: &str, messages: Messages) -> Result<Option<LogMessage>, LogError> {
    let is_of_it = |message: &Result<LogMessage, LogError>| {
        message.as_ref().map_or(true, |message| message.channel.topic == topic)
    };
    messages(Selection::topics([topic])).find(is_of_it).transpose()
}

/// Refuses a topic whose type is defined otherwise than its name says, since its numbers would be read as others.
fn check_schemas(choices: &[TopicChoice], messages: Messages) -> Result<(), SetupError> {
    for choice in choices {
        let Some(first) = first_of(&choice.topic, messages)? else { continue };
        let Channel { topic, type_name, schema_encoding, definition, .. } = first.channel.as_ref();
        if schema_encoding == "ros2msg"
            && let Some(difference) = schema::difference(type_name, definition)
        {
            let (topic, type_name, difference) = (topic.clone(), type_name.clone(), Box::new(difference));
            return Err(SetupError::Schema { topic, type_name, difference });
        }
    }
    Ok(())
}

/// Number of messages of a topic whose stamps are compared with the times of the log.
const CLOCK_SAMPLES: usize = 20;
/// Largest difference between stamps and log times, nanoseconds, with which a log's times can stand for missing stamps. Images
/// take some tenths of a second from their exposure to the log.
const MAX_STAMP_OFFSET_NS: i64 = 500_000_000;
/// Largest difference between the stamps of two topics, by the log's times, before it is told, nanoseconds: beyond it no
/// measurement of one is used for the other.
const MAX_APART_NS: i64 = GONE_NS;

/// Compares stamps with the times at which messages were logged. Fails if some topics have no stamps and those of the others are of
/// another clock than the log's; warns if the stamps of two topics are of different clocks.
fn check_clocks(
    choices: &[TopicChoice],
    topics: &Topics,
    settings: &Settings,
    messages: Messages,
) -> Result<Vec<String>, SetupError> {
    let is_unstamped = |choice: &&TopicChoice| [Odometer::TYPE, LowState::TYPE].contains(&choice.type_name.as_str());
    let unstamped = choices.iter().find(is_unstamped);
    let mut offsets: Vec<(String, i64)> = Vec::new();
    for measurement in ["image", "odometry", "imu", "tf"] {
        let Some(choice) = choices.iter().find(|choice| choice.measurement == measurement) else { continue };
        if is_unstamped(&choice) || offsets.iter().any(|(topic, _)| *topic == choice.topic) {
            continue;
        }
        if let Some(offset_ns) = stamp_offset_ns(&choice.topic, topics, settings, messages)? {
            offsets.push((choice.topic.clone(), offset_ns));
        }
    }
    let Some(((image, image_offset_ns), others)) = offsets.split_first().filter(|(first, _)| first.0 == topics.image)
    else {
        return Ok(Vec::new());
    };
    if let Some(unstamped) = unstamped
        && image_offset_ns.saturating_abs() > MAX_STAMP_OFFSET_NS
    {
        let agreeing = others.iter().find(|(_, offset_ns)| offset_ns.saturating_abs() <= MAX_STAMP_OFFSET_NS);
        return Err(SetupError::Clocks {
            unstamped: unstamped.topic.clone(),
            stamped: image.clone(),
            offset_s: *image_offset_ns as f64 * 1e-9,
            agreeing: agreeing.map(|(topic, _)| topic.clone()),
        });
    }
    let apart = others.iter().map(|(topic, offset_ns)| (topic, image_offset_ns.saturating_sub(*offset_ns)));
    let told = apart.filter(|(_, apart_ns)| apart_ns.saturating_abs() > MAX_APART_NS);
    Ok(told.map(|(topic, apart_ns)| warnings::clocks_apart(image, topic, apart_ns as f64 * 1e-9)).collect())
}

/// The median by which the first messages of a topic were logged after their stamps, nanoseconds; `None` without stamps.
fn stamp_offset_ns(
    topic: &str,
    topics: &Topics,
    settings: &Settings,
    messages: Messages,
) -> Result<Option<i64>, LogError> {
    let mut offsets = Vec::new();
    for message in messages(Selection::topics([topic])) {
        let message = message?;
        if message.channel.topic != topic {
            continue;
        }
        let stamp_ns = match measurement::read(&message, topics, &settings.head) {
            Ok(Measurement::Frame { stamp_ns, .. } | Measurement::Imu { stamp_ns, .. }) => Some(stamp_ns),
            Ok(Measurement::Odometry { stamp_ns, .. } | Measurement::Velocity { stamp_ns, .. }) => Some(stamp_ns),
            Ok(Measurement::Transforms { transforms, .. }) => transforms.first().map(|first| first.stamp_ns),
            _ => None,
        };
        offsets.extend(stamp_ns.map(|stamp_ns| message.log_time_ns.saturating_sub(stamp_ns)));
        if offsets.len() >= CLOCK_SAMPLES {
            break;
        }
    }
    offsets.sort_unstable();
    Ok(offsets.get(offsets.len() / 2).copied())
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

/// Whether messages have the transform from `odom` to `base_footprint`, or to the `base_link` that the footprint hangs on.
fn has_odometry_in_tf(found: &[LogMessage], settings: &Settings) -> bool {
    let names = &settings.frames;
    let has = |parent: &String, child: &String| {
        found.iter().any(|message| {
            matches!(
                measurement::read(message, &settings.topics, &settings.head),
                Ok(Measurement::Transforms { transforms, .. })
                    if transforms.iter().any(|t| t.parent == *parent && t.child == *child)
            )
        })
    };
    has(&names.odom, &names.base_footprint)
        || (has(&names.odom, &names.base_link) && has(&names.base_link, &names.base_footprint))
}
