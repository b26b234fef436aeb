//! Finds out which topic of a log carries which measurement.

use std::collections::{BTreeMap, BTreeSet};

use thiserror::Error;

use super::foxglove::FoxgloveType;
use realitysim_config::{MotionSource, Settings, Topics};

/// For each topic that a log has messages of, the names of their types: mostly one.
pub type TopicTypes = BTreeMap<String, BTreeSet<String>>;

/// Why the topics of a log cannot be assigned.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TopicError {
    /// The topic of a measurement is missing, and not exactly one other has the right type.
    #[error("no {what} on {wanted}: {hint}")]
    Missing {
        /// The measurement, in words.
        what: &'static str,
        /// The configured topic.
        wanted: String,
        /// How to choose a topic, or what the log lacks, in words.
        hint: String,
    },
    /// The log has no odometry, and the settings do not say that it goes without.
    #[error(
        "no odometry on {wanted} and none in /tf: record it (nav_msgs/msg/Odometry), name its topic with \
         topics.odometry, or replay with filter.motion = \"random_walk\" (--motion random_walk)"
    )]
    NoOdometry {
        /// The configured topic.
        wanted: String,
    },
}

/// Says how to choose among the candidates, or what a log without any lacks; `types` are the types that would do, in words.
fn hint(log: &TopicTypes, types: &str, candidates: &[String], key: &str) -> String {
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

/// Returns the topics to read: the configured ones, and where the log lacks one, the only other topic of the right type.
///
/// `odometry_in_tf` says that `/tf` has odometry, so that no topic for it is needed.
pub fn resolve(settings: &Settings, log: &TopicTypes, odometry_in_tf: bool) -> Result<Topics, TopicError> {
    let mut topics = settings.topics.clone();
    let find = |wanted: &str, types: &[&str]| find(log, wanted, types);
    topics.image = image(&topics.image, log)?;
    match find(&topics.camera_info, &["sensor_msgs/msg/CameraInfo"]) {
        Ok(topic) => topics.camera_info = topic,
        Err(_) if settings.camera.lens.is_some() => {}
        Err(candidates) => {
            return Err(TopicError::Missing {
                what: "camera calibration",
                wanted: settings.topics.camera_info.clone(),
                hint: hint(
                    log,
                    "sensor_msgs/msg/CameraInfo (or give a lens file with camera.lens)",
                    &candidates,
                    "camera_info",
                ),
            });
        }
    }
    // Some robots send constant transforms on /tf, too. Whether the chain is complete is checked where it is used.
    match find(&topics.tf_static, &TRANSFORMS) {
        // Moving transforms must not be taken for constant ones because the log has no others.
        Ok(topic) if topic != topics.tf => topics.tf_static = topic,
        Ok(_) => {}
        Err(_) if log.contains_key(&topics.tf) => {}
        Err(candidates) => {
            return Err(TopicError::Missing {
                what: "transforms",
                wanted: settings.topics.tf_static.clone(),
                hint: hint(log, TRANSFORMS[0], &candidates, "tf_static"),
            });
        }
    }
    if let Ok(topic) = find(&topics.imu, &["sensor_msgs/msg/Imu"]) {
        topics.imu = topic;
    }
    match find(&topics.odometry, &["nav_msgs/msg/Odometry"]) {
        Ok(topic) => topics.odometry = topic,
        Err(_) if odometry_in_tf || settings.filter.motion == MotionSource::RandomWalk => {}
        Err(candidates) if candidates.is_empty() => {
            return Err(TopicError::NoOdometry { wanted: settings.topics.odometry.clone() });
        }
        Err(candidates) => {
            return Err(TopicError::Missing {
                what: "odometry",
                wanted: settings.topics.odometry.clone(),
                hint: hint(log, "nav_msgs/msg/Odometry", &candidates, "odometry"),
            });
        }
    }
    Ok(topics)
}

/// Returns the topic of the camera's images: the configured one, or the only one of such a type.
pub fn image(wanted: &str, log: &TopicTypes) -> Result<String, TopicError> {
    find(log, wanted, &IMAGES).map_err(|candidates| TopicError::Missing {
        what: "camera images",
        wanted: wanted.to_owned(),
        hint: hint(log, "sensor_msgs/msg/CompressedImage or Image", &candidates, "image"),
    })
}

/// Returns the wanted topic if it has one of these types, or the only topic that has; the error lists all that have.
fn find(log: &TopicTypes, wanted: &str, types: &[&str]) -> Result<String, Vec<String>> {
    let fits = |(_, kinds): &(&String, &BTreeSet<String>)| types.iter().any(|kind| kinds.contains(*kind));
    if log.get_key_value(wanted).as_ref().is_some_and(fits) {
        return Ok(wanted.to_owned());
    }
    let mut candidates: Vec<String> = log.iter().filter(fits).map(|(topic, _)| topic.clone()).collect();
    match candidates.len() {
        1 => candidates.pop().ok_or_else(Vec::new),
        _ => Err(candidates),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(topics: &[(&str, &str)]) -> TopicTypes {
        topics.iter().map(|(topic, kind)| ((*topic).to_owned(), [(*kind).to_owned()].into())).collect()
    }

    const WHOLE: [(&str, &str); 4] = [
        ("/cam/raw", "sensor_msgs/msg/Image"),
        ("/cam/info", "sensor_msgs/msg/CameraInfo"),
        ("/tf_static", "tf2_msgs/msg/TFMessage"),
        ("/walk", "nav_msgs/msg/Odometry"),
    ];

    #[test]
    fn the_only_topic_of_a_type_is_taken() {
        let topics = resolve(&Settings::default(), &log(&WHOLE), false).expect("all there");
        assert_eq!((topics.image.as_str(), topics.odometry.as_str()), ("/cam/raw", "/walk"));
    }

    #[test]
    fn messages_of_foxglove_in_json_are_told() {
        let mut rest = log(&WHOLE[1..]);
        rest.insert("/eye".into(), ["foxglove.CompressedImage in json".to_owned()].into());
        let said = resolve(&Settings::default(), &rest, false).expect_err("JSON").to_string();
        assert!(said.contains("not read are /eye (foxglove.CompressedImage in json)"), "{said}");
        assert!(said.contains("in protobuf: foxglove.CompressedImage, foxglove.RawImage"), "{said}");
    }

    #[test]
    fn what_is_missing_or_unclear_is_said() {
        let without = |topic: &str| {
            let rest: Vec<_> = WHOLE.into_iter().filter(|(name, _)| *name != topic).collect();
            resolve(&Settings::default(), &log(&rest), false).expect_err("missing").to_string()
        };
        assert!(without("/walk").contains("random_walk"));
        assert!(without("/cam/raw").contains("no camera images on /camera/image/compressed"));
        assert!(without("/cam/info").contains("camera.lens"));
        assert!(without("/tf_static").contains("tf2_msgs/msg/TFMessage"));
        let mut two = log(&WHOLE);
        two.insert("/cam2".into(), ["sensor_msgs/msg/Image".to_owned()].into());
        let said = resolve(&Settings::default(), &two, false).expect_err("unclear").to_string();
        assert!(said.contains("topics.image: /cam/raw, /cam2"), "{said}");
    }
}
