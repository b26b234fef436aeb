//! Finds out which topic of a log carries which measurement, and says why.

use core::fmt;
use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use thiserror::Error;

use super::foxglove::FoxgloveType;
use realitysim_config::{MotionSource, Settings, Topics};
use realitysim_ros2::topics;

/// For each topic that a log has messages of, the names of their types: mostly one.
pub type TopicTypes = BTreeMap<String, BTreeSet<String>>;

/// What a first look at a log's messages says about its topics, beyond their types.
#[derive(Clone, Debug, Default)]
pub struct StreamFacts {
    /// Whether `/tf` has odometry, so that no topic for it is needed.
    pub odometry_in_tf: bool,
    /// The topics of inertial sensors whose coordinate frame constants connect to the torso.
    pub mounted_imus: BTreeSet<String>,
    /// The topics of images that are no pictures: depths, for example.
    pub not_pictures: BTreeSet<String>,
}

/// The topics to read, and why each was chosen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResolvedTopics {
    /// The configured topics, with those that were found in place of missing ones.
    pub topics: Topics,
    /// The topics that the log has, each with the reason for the choice.
    pub choices: Vec<TopicChoice>,
}

/// A topic that is read, and why it and no other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TopicChoice {
    /// The measurement: a key under `topics` in the settings.
    pub measurement: &'static str,
    /// Name of the topic.
    pub topic: String,
    /// Type of its messages; several are joined by commas.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Why it was chosen.
    pub reason: ChoiceReason,
}

/// Why a topic was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChoiceReason {
    /// The settings name it.
    Configured,
    /// The log has no other topic of such a type.
    OnlyOfType,
    /// It is the only one in the namespace of the camera.
    BesideImage,
    /// Of the forms of one camera's picture, its lens is known best, and then it has lost least.
    PreferredForm,
    /// It is the only sensor whose coordinate frame is mounted on the torso.
    MountedOnTorso,
    /// The log has no topic of odometry, and `/tf` has transforms of it.
    OdometryInTransforms,
}

impl fmt::Display for ChoiceReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Configured => "configured",
            Self::OnlyOfType => "only topic of this type",
            Self::BesideImage => "beside the image topic",
            Self::PreferredForm => "preferred form of this camera's picture",
            Self::MountedOnTorso => "only sensor mounted on the torso",
            Self::OdometryInTransforms => "has odometry, and no topic has",
        })
    }
}

impl Serialize for ChoiceReason {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl fmt::Display for TopicChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} ({})", self.measurement, self.topic, self.reason)
    }
}

/// Why the topics of a log cannot be assigned.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TopicError {
    /// The topic of a measurement is missing, and not exactly one other has the right type.
    #[error("no {} on {wanted}{}: {hint}", needed.what, instead(found))]
    Missing {
        /// The measurement.
        needed: &'static NeededTopic,
        /// The configured topic.
        wanted: String,
        /// The types that the configured topic has instead, if the log has it.
        found: Vec<String>,
        /// How to choose a topic, or what the log lacks, in words.
        hint: String,
    },
    /// The log has no odometry, and the settings do not say that it goes without.
    #[error(
        "no odometry on {wanted}{} and none in /tf: record it (nav_msgs/msg/Odometry or booster_interface/msg/Odometer), name its \
         topic with topics.odometry{}, or replay with filter.motion = \"random_walk\" (--motion random_walk)",
        instead(found),
        named(candidates)
    )]
    NoOdometry {
        /// The configured topic.
        wanted: String,
        /// The types that the configured topic has instead, if the log has it.
        found: Vec<String>,
        /// The topics of poses and velocities, which are odometry only if somebody says so.
        candidates: Vec<String>,
    },
}

/// A measurement that a log must have, for error messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NeededTopic {
    /// The measurement, in words.
    pub what: &'static str,
    /// The types that its topic may have, in words.
    pub types: &'static str,
    /// The key under `topics` in the settings that chooses one.
    pub key: &'static str,
}

const NEEDED_IMAGE: NeededTopic =
    NeededTopic { what: "camera images", types: "sensor_msgs/msg/CompressedImage or Image", key: "image" };
const NEEDED_CALIBRATION: NeededTopic = NeededTopic {
    what: "camera calibration",
    types: "sensor_msgs/msg/CameraInfo (or give a lens file with camera.lens)",
    key: "camera_info",
};
const NEEDED_ODOMETRY: NeededTopic =
    NeededTopic { what: "odometry", types: "nav_msgs/msg/Odometry or booster_interface/msg/Odometer", key: "odometry" };
const NEEDED_TRANSFORMS: NeededTopic = NeededTopic { what: "transforms", types: TRANSFORMS[0], key: "tf_static" };

/// Says what the configured topic has instead of what is needed.
fn instead(found: &[String]) -> String {
    if found.is_empty() { String::new() } else { format!(", whose type is {}", found.join(", ")) }
}

/// Lists topics that may be named.
fn named(candidates: &[String]) -> String {
    if candidates.is_empty() { String::new() } else { format!(" (is it {}?)", candidates.join(" or ")) }
}

/// Says how to choose among the candidates, or what a log without any lacks.
fn hint(log: &TopicTypes, needed: &NeededTopic, candidates: &[String]) -> String {
    let NeededTopic { types, key, .. } = needed;
    match candidates {
        [] => format!("the log has no topic of type {types}{}", hint_of_unread(log)),
        _ => format!("choose one with topics.{key}: {}", candidates.join(", ")),
    }
}

/// Begin of the names of Foxglove's types.
pub(crate) const FOXGLOVE_PACKAGE: &str = "foxglove.";
/// Largest number of topics that an error lists as not read.
const MAX_UNREAD: usize = 5;

/// Names the topics with Foxglove's messages that are not read, and says which would be; empty without such topics.
fn hint_of_unread(log: &TopicTypes) -> String {
    let all = log.iter().flat_map(|(topic, kinds)| kinds.iter().map(move |kind| (topic, kind)));
    let unread = all.filter(|(_, kind)| kind.starts_with(FOXGLOVE_PACKAGE)).take(MAX_UNREAD);
    let unread: Vec<String> = unread.map(|(topic, kind)| format!("{topic} ({kind})")).collect();
    if unread.is_empty() {
        return String::new();
    }
    let names = FoxgloveType::ALL.map(FoxgloveType::name).join(", ");
    format!("; not read are {}: of Foxglove's messages, these are read, in protobuf: {names}", unread.join(", "))
}

const TRANSFORMS: [&str; 1] = ["tf2_msgs/msg/TFMessage"];
const IMAGES: [&str; 2] = ["sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"];
const CAMERA_INFO: [&str; 1] = ["sensor_msgs/msg/CameraInfo"];
const IMU: [&str; 1] = ["sensor_msgs/msg/Imu"];
const LOW_STATE: [&str; 1] = ["booster_interface/msg/LowState"];
const JOINTS: [&str; 1] = ["sensor_msgs/msg/JointState"];
const ODOMETRY: [&str; 1] = ["nav_msgs/msg/Odometry"];
const ODOMETER: [&str; 1] = ["booster_interface/msg/Odometer"];
/// Types that are odometry where the settings say so: such topics may as well be commands, goals or poses on the map.
const ODOMETRY_IF_NAMED: [&str; 4] = [
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TwistStamped",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
];

/// Returns the topics to read: the configured ones, and where the log lacks one, the one that its type, its namespace or the
/// transforms single out. Two cameras are never chosen between.
pub fn resolve(settings: &Settings, log: &TopicTypes, facts: &StreamFacts) -> Result<ResolvedTopics, TopicError> {
    let mut resolver = Resolver { settings, log, topics: settings.topics.clone(), choices: Vec::new() };
    let image = resolver.image(&facts.not_pictures)?;
    resolver.camera_info(image)?;
    resolver.odometry(facts.odometry_in_tf)?;
    resolver.attitude_and_joints(&facts.mounted_imus);
    resolver.transforms()?;
    Ok(ResolvedTopics { topics: resolver.topics, choices: resolver.choices })
}

/// Returns the topic of the camera's images: the configured one, or the only one of such a type, or the preferred form of the only
/// camera's picture.
pub fn image(wanted: &str, log: &TopicTypes) -> Result<String, TopicError> {
    choose_image(wanted, log, &BTreeSet::new()).map(|(topic, _)| topic)
}

/// Returns whether a log has a topic of odometry: the configured one, or one whose type is that of nothing else.
pub fn has_odometry(wanted: &str, log: &TopicTypes) -> bool {
    has_type(log, wanted, &ODOMETRY_IF_NAMED) || !of_types(log, &[ODOMETRY[0], ODOMETER[0]]).is_empty()
}

/// Returns the topics of a log that inertial sensors send on.
pub fn imus(log: &TopicTypes) -> Vec<String> {
    of_types(log, &[IMU[0], LOW_STATE[0]])
}

/// Returns the topics of a log that images are sent on.
pub fn images(log: &TopicTypes) -> Vec<String> {
    of_types(log, &IMAGES)
}

/// The topics of a log while they are assigned.
struct Resolver<'a> {
    settings: &'a Settings,
    log: &'a TopicTypes,
    topics: Topics,
    choices: Vec<TopicChoice>,
}

impl Resolver<'_> {
    fn choose(&mut self, measurement: &'static str, topic: &str, reason: ChoiceReason) {
        let type_name = self.types_of(topic).join(", ");
        self.choices.push(TopicChoice { measurement, topic: topic.to_owned(), type_name, reason });
    }

    fn types_of(&self, topic: &str) -> Vec<String> {
        types_of(self.log, topic)
    }

    fn image(&mut self, not_pictures: &BTreeSet<String>) -> Result<ChoiceReason, TopicError> {
        let (topic, reason) = choose_image(&self.topics.image, self.log, not_pictures)?;
        self.choose("image", &topic, reason);
        self.topics.image = topic;
        Ok(reason)
    }

    fn camera_info(&mut self, image: ChoiceReason) -> Result<(), TopicError> {
        let wanted = self.topics.camera_info.clone();
        let beside = self.calibration_beside_image();
        // The default name may be that of another camera than the one whose images were found.
        let is_asked_for = image == ChoiceReason::Configured || wanted != Topics::default().camera_info;
        let found = match (beside, find(self.log, &wanted, &CAMERA_INFO)) {
            (_, Ok(configured @ (_, ChoiceReason::Configured))) if is_asked_for => Ok(configured),
            (Some(beside), _) => Ok((beside, ChoiceReason::BesideImage)),
            (None, found) => found,
        };
        match found {
            Ok((topic, reason)) => {
                self.choose("camera_info", &topic, reason);
                self.topics.camera_info = topic;
                Ok(())
            }
            Err(_) if self.settings.camera.lens.is_some() => Ok(()),
            Err(candidates) => Err(TopicError::Missing {
                needed: &NEEDED_CALIBRATION,
                found: self.types_of(&wanted),
                wanted,
                hint: hint(self.log, &NEEDED_CALIBRATION, &candidates),
            }),
        }
    }

    /// Returns the only calibration in the namespace of the image.
    fn calibration_beside_image(&self) -> Option<String> {
        let camera = PictureName::of(&self.topics.image).namespace;
        let is_beside = |topic: &&String| topic.rsplit_once('/').is_some_and(|(folder, _)| folder == camera);
        let candidates = of_types(self.log, &CAMERA_INFO);
        let mut beside = candidates.iter().filter(is_beside);
        beside.next().filter(|_| beside.next().is_none()).cloned()
    }

    fn odometry(&mut self, is_in_tf: bool) -> Result<(), TopicError> {
        let wanted = self.topics.odometry.clone();
        let all: Vec<&str> = [&ODOMETRY[..], &ODOMETER, &ODOMETRY_IF_NAMED].concat();
        let found = match has_type(self.log, &wanted, &all) {
            true => Ok((wanted.clone(), ChoiceReason::Configured)),
            false => find(self.log, &wanted, &ODOMETRY).or_else(|candidates| match candidates[..] {
                [] => find(self.log, &wanted, &ODOMETER),
                _ => Err(candidates),
            }),
        };
        match found {
            Ok((topic, reason)) => {
                self.choose("odometry", &topic, reason);
                self.topics.odometry = topic;
                Ok(())
            }
            Err(_) if is_in_tf => {
                self.choose("odometry", &self.topics.tf.clone(), ChoiceReason::OdometryInTransforms);
                Ok(())
            }
            Err(_) if self.settings.filter.motion == MotionSource::RandomWalk => Ok(()),
            Err(candidates) if candidates.is_empty() => {
                let other = |topic: &String| {
                    ![&self.topics.initial_pose, &self.topics.ground_truth].contains(&topic)
                        && !topics::OUTPUTS.contains(&topic.as_str())
                };
                let mut candidates = of_types(self.log, &ODOMETRY_IF_NAMED);
                candidates.retain(other);
                Err(TopicError::NoOdometry { found: self.types_of(&wanted), wanted, candidates })
            }
            Err(candidates) => Err(TopicError::Missing {
                needed: &NEEDED_ODOMETRY,
                found: self.types_of(&wanted),
                wanted,
                hint: hint(self.log, &NEEDED_ODOMETRY, &candidates),
            }),
        }
    }

    /// Finds the topics of attitude and joints. Without them a log can be replayed, with a warning about the attitude.
    fn attitude_and_joints(&mut self, mounted_imus: &BTreeSet<String>) {
        let wanted = self.topics.imu.clone();
        let found = match has_type(self.log, &wanted, &LOW_STATE) {
            true => Ok((wanted.clone(), ChoiceReason::Configured)),
            false => find(self.log, &wanted, &IMU),
        };
        let found = found.or_else(|imus| {
            let mut mounted = imus.iter().filter(|imu| mounted_imus.contains(*imu));
            match (imus.is_empty(), mounted.next(), mounted.next()) {
                (false, Some(only), None) => Ok((only.clone(), ChoiceReason::MountedOnTorso)),
                (false, ..) => Err(imus),
                (true, ..) => find(self.log, &wanted, &LOW_STATE),
            }
        });
        if let Ok((topic, reason)) = found {
            self.choose("imu", &topic, reason);
            self.topics.imu = topic;
        }
        let wanted = self.topics.joints.clone();
        let found = match has_type(self.log, &wanted, &JOINTS) {
            true => Ok((wanted, ChoiceReason::Configured)),
            false => find(self.log, &wanted, &LOW_STATE),
        };
        if let Ok((topic, reason)) = found {
            self.choose("joints", &topic, reason);
            self.topics.joints = topic;
        }
    }

    fn transforms(&mut self) -> Result<(), TopicError> {
        let (tf, wanted) = (self.topics.tf.clone(), self.topics.tf_static.clone());
        if has_type(self.log, &tf, &TRANSFORMS) {
            self.choose("tf", &tf, ChoiceReason::Configured);
        }
        // Some robots send constant transforms on /tf, too. Whether the chain is complete is checked where it is used.
        match find(self.log, &wanted, &TRANSFORMS) {
            // Moving transforms must not be taken for constant ones because the log has no others.
            Ok((topic, reason)) if topic != tf => {
                self.choose("tf_static", &topic, reason);
                self.topics.tf_static = topic;
                Ok(())
            }
            Ok(_) => Ok(()),
            Err(_) if self.log.contains_key(&tf) => Ok(()),
            Err(candidates) => Err(TopicError::Missing {
                needed: &NEEDED_TRANSFORMS,
                found: self.types_of(&wanted),
                wanted,
                hint: hint(self.log, &NEEDED_TRANSFORMS, &candidates),
            }),
        }
    }
}

fn choose_image(
    wanted: &str,
    log: &TopicTypes,
    not_pictures: &BTreeSet<String>,
) -> Result<(String, ChoiceReason), TopicError> {
    if has_type(log, wanted, &IMAGES) {
        return Ok((wanted.to_owned(), ChoiceReason::Configured));
    }
    let mut candidates = of_types(log, &IMAGES);
    candidates.retain(|topic| !not_pictures.contains(topic));
    match &candidates[..] {
        [only] => return Ok((only.clone(), ChoiceReason::OnlyOfType)),
        [first, others @ ..] => {
            let name = PictureName::of(first);
            let is_same = |other: &String| PictureName::of(other).is_of_the_same_picture_as(&name);
            if others.iter().all(is_same)
                && let Some(preferred) = candidates.iter().min_by_key(|topic| PictureName::of(topic).form)
            {
                return Ok((preferred.clone(), ChoiceReason::PreferredForm));
            }
        }
        [] => {}
    }
    Err(TopicError::Missing {
        needed: &NEEDED_IMAGE,
        wanted: wanted.to_owned(),
        found: types_of(log, wanted),
        hint: hint(log, &NEEDED_IMAGE, &candidates),
    })
}

/// What the name of an image's topic says, by the conventions of image_transport and image_proc.
#[derive(PartialEq, Eq)]
pub struct PictureName<'a> {
    /// Namespace of the camera: the topic without its last part and without that of the transport.
    namespace: &'a str,
    /// The last part without the words that say how it was processed.
    stem: Vec<&'a str>,
    /// How it was processed.
    form: PictureForm,
}

/// How a picture was processed. The least one is preferred: a calibration describes the picture as the camera took it, rectifying
/// cuts off its border, and gray and compressed pictures have lost something.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct PictureForm {
    is_rectified: bool,
    is_gray: bool,
    is_compressed: bool,
}

impl<'a> PictureName<'a> {
    /// Takes a topic's name apart.
    pub fn of(topic: &'a str) -> Self {
        let picture = topic.strip_suffix("/compressed");
        let (namespace, name) = picture.unwrap_or(topic).rsplit_once('/').unwrap_or(("", topic));
        let has = |words: &[&str]| name.split('_').any(|word| words.contains(&word));
        let form = PictureForm {
            is_rectified: has(&["rect", "rectified"]),
            is_gray: has(&["mono", "gray"]),
            is_compressed: picture.is_some(),
        };
        let is_form = |word: &&str| ["raw", "color", "rect", "rectified", "mono", "gray"].contains(word);
        Self { namespace, stem: name.split('_').filter(|word| !is_form(word)).collect(), form }
    }

    /// Returns whether the picture is rectified: it has no distortion, whatever the calibration says of the camera.
    pub fn is_rectified(&self) -> bool {
        self.form.is_rectified
    }

    fn is_of_the_same_picture_as(&self, other: &Self) -> bool {
        (self.namespace, &self.stem) == (other.namespace, &other.stem)
    }
}

fn types_of(log: &TopicTypes, topic: &str) -> Vec<String> {
    log.get(topic).map(|types| types.iter().cloned().collect()).unwrap_or_default()
}

fn has_type(log: &TopicTypes, topic: &str, types: &[&str]) -> bool {
    log.get(topic).is_some_and(|has| types.iter().any(|kind| has.contains(*kind)))
}

/// Returns the topics that have one of these types.
fn of_types(log: &TopicTypes, types: &[&str]) -> Vec<String> {
    log.keys().filter(|topic| has_type(log, topic, types)).cloned().collect()
}

/// Returns the wanted topic if it has one of these types, or the only topic that has; the error lists all that have.
fn find(log: &TopicTypes, wanted: &str, types: &[&str]) -> Result<(String, ChoiceReason), Vec<String>> {
    if has_type(log, wanted, types) {
        return Ok((wanted.to_owned(), ChoiceReason::Configured));
    }
    let mut candidates = of_types(log, types);
    match candidates.len() {
        1 => candidates.pop().map(|only| (only, ChoiceReason::OnlyOfType)).ok_or_else(Vec::new),
        _ => Err(candidates),
    }
}

#[cfg(test)]
mod tests;
