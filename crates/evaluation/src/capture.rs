//! Reading of tags, other poses and the truth from logs.

use std::path::Path;

use thiserror::Error;

use super::compare::Tagged;
use realitysim_config::{HeadSettings, Topics};
use realitysim_geometry::Isometry;
use realitysim_log_input::log::{self, LogError, LogSource};
use realitysim_log_input::measurement::{self, Measurement};
use realitysim_log_input::topic_resolution::{self, TopicError};
use realitysim_recording::{Readout, ReadoutError, losses, read_topic};
use realitysim_ros2::mcap_read::{LogMessage, Selection};
use realitysim_ros2::messages::{
    FrameTag, Header, Message, Odometry, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
};

/// Reason why poses or frame times cannot be read from a log.
#[derive(Debug, Error)]
pub enum EvaluationError {
    /// The topic cannot be read.
    #[error(transparent)]
    Readout(#[from] ReadoutError),
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The topic holds no poses.
    #[error(
        "{path}: {topic} is of type {type_name}: poses are geometry_msgs/msg/PoseStamped, \
         PoseWithCovarianceStamped or nav_msgs/msg/Odometry"
    )]
    Type {
        /// Log that was read.
        path: String,
        /// Name of the topic.
        topic: String,
        /// ROS 2 type of its messages.
        type_name: String,
    },
    /// The poses are in another frame than the field's.
    #[error("{path}: {topic}: its poses are in {frame:?}, and poses on the field are needed, which are in \"map\"")]
    Frame {
        /// Log that was read.
        path: String,
        /// Name of the topic.
        topic: String,
        /// The frame that the messages name.
        frame: String,
    },
    /// A line of a table of poses is wrong.
    #[error(
        "{path}: line {line}: {what}: eight numbers are needed, `stamp tx ty tz qx qy qz qw`, the stamp in seconds"
    )]
    Line {
        /// Table that was read.
        path: String,
        /// Number of the line, from 1 on.
        line: usize,
        /// What is wrong with it.
        what: String,
    },
    /// The topic of the camera's images cannot be determined.
    #[error("{path}: {source}")]
    Topic {
        /// Log that was read.
        path: String,
        /// The problem with the topic.
        source: TopicError,
    },
}

/// Reads the true poses of `camera_link` from topic `name`, with times in nanoseconds and in order of time.
pub fn read_truth(path: &Path, name: &str) -> Result<Readout<(i64, Isometry)>, EvaluationError> {
    let read = read_poses_of(path, name, "name the topic of the true poses with topics.ground_truth or --truth-topic")?;
    let posed = |message: &LogMessage| decode_pose(path, message).map(|(tag, _)| (tag.stamp_ns, tag.pose));
    let mut found = read.found.iter().map(posed).collect::<Result<Vec<_>, _>>()?;
    found.sort_by_key(|(stamp, _)| *stamp);
    found.dedup_by_key(|(stamp, _)| *stamp);
    Ok(Readout { found, losses: read.losses, warnings: read.warnings })
}

/// Reads poses of `camera_link` in `map` that another program computed, in order of time.
///
/// The messages carry no validity: all poses count as valid. Frame identifiers that name something else give a warning.
pub fn read_poses(path: &Path, name: &str) -> Result<Readout<Tagged>, EvaluationError> {
    let read = read_poses_of(path, name, "name the topic of the poses to judge")?;
    let posed = read.found.iter().map(|message| decode_pose(path, message)).collect::<Result<Vec<_>, _>>()?;
    let mut warnings: Vec<String> = Vec::new();
    for (_, [parent, child]) in &posed {
        // Many programs leave the identifiers empty, which says nothing.
        let is = |said: &str, meant: &str| said.is_empty() || said.trim_start_matches('/') == meant;
        if is(parent, MAP) && is(child, CAMERA) {
            continue;
        }
        let child = if child.is_empty() { String::new() } else { format!(" of {child:?}") };
        let warning = format!(
            "{}: {name}: it says that its poses are{child} in {parent:?}; they are judged as poses of \"{CAMERA}\" in \"{MAP}\"",
            path.display()
        );
        if !warnings.contains(&warning) && warnings.len() < MAX_WARNINGS {
            warnings.push(warning);
        }
    }
    let mut found: Vec<Tagged> = posed.into_iter().map(|(tag, _)| tag).collect();
    found.sort_by_key(|tag| tag.stamp_ns);
    Ok(Readout { found, losses: read.losses, warnings })
}

/// Reads the poses of a robot on the field that it computed itself, with times in nanoseconds and in order of time.
///
/// # Errors
///
/// [`EvaluationError::Frame`] if the messages say that they are in a frame of odometry.
pub fn read_own_poses(path: &Path, name: &str) -> Result<Readout<(i64, Isometry)>, EvaluationError> {
    let read = read_poses_of(path, name, "name the topic of the robot's own poses with --poses")?;
    let mut found = Vec::new();
    for message in &read.found {
        let (tagged, [parent, _]) = decode_pose(path, message)?;
        if parent.trim_start_matches('/').ends_with(ODOM) {
            let (path, topic) = (path.display().to_string(), name.to_owned());
            return Err(EvaluationError::Frame { path, topic, frame: parent });
        }
        found.push((tagged.stamp_ns, tagged.pose));
    }
    found.sort_by_key(|(stamp_ns, _)| *stamp_ns);
    found.dedup_by_key(|(stamp_ns, _)| *stamp_ns);
    Ok(Readout { found, losses: read.losses, warnings: read.warnings })
}

/// Reads poses from the text of a table in the format of TUM, `stamp tx ty tz qx qy qz qw` with stamps in seconds; lines that begin with
/// `#` are comments. `path` is for errors.
pub fn parse_tum(path: &Path, text: &str) -> Result<Vec<(i64, Isometry)>, EvaluationError> {
    let mut found = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'))
    {
        let wrong = |what: String| EvaluationError::Line { path: path.display().to_string(), line: number + 1, what };
        let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        let numbers = numbers.map_err(|_| wrong("not a number".to_owned()))?;
        let [stamp, x, y, z, qx, qy, qz, qw] = numbers[..] else {
            return Err(wrong(format!("{} numbers", numbers.len())));
        };
        let pose = Isometry::new(glam::DQuat::from_xyzw(qx, qy, qz, qw), glam::DVec3::new(x, y, z));
        if !pose.is_finite() || !(0.0..9e9).contains(&stamp) {
            return Err(wrong("a number that cannot be".to_owned()));
        }
        found.push(((stamp * 1e9) as i64, pose));
    }
    found.sort_by_key(|(stamp_ns, _)| *stamp_ns);
    found.dedup_by_key(|(stamp_ns, _)| *stamp_ns);
    Ok(found)
}

/// End of the names of frames in which odometry is.
const ODOM: &str = "odom";
/// Coordinate frame that judged poses are poses of.
const CAMERA: &str = "camera_link";
/// Coordinate frame that judged poses are expressed in.
const MAP: &str = "map";
/// Largest number of different warnings about one topic.
const MAX_WARNINGS: usize = 8;

/// Reads the times at which the camera took the frames of a log, nanoseconds, in ascending order.
pub fn read_frame_times(path: &Path, wanted: &Topics) -> Result<Readout<i64>, EvaluationError> {
    let files = log::files_of(path)?;
    let types = log::topic_types(&log::surveys(&files)?);
    let image = topic_resolution::image(&wanted.image, &types)
        .map_err(|source| EvaluationError::Topic { path: path.display().to_string(), source })?;
    let topics = Topics { image, ..wanted.clone() };
    let mut source = LogSource::new(files, Selection::topics([topics.image.clone()]));
    let mut found = Vec::new();
    for message in source.by_ref() {
        // A frame whose time cannot be read is not counted.
        if let Ok(Measurement::Frame { stamp_ns, .. }) = measurement::read(&message?, &topics, &HeadSettings::default())
        {
            found.push(stamp_ns);
        }
    }
    found.sort_unstable();
    found.dedup();
    Ok(Readout { found, losses: losses(path, source.damage()), warnings: Vec::new() })
}

/// Converts a `FrameTag` message to the form that [`compare()`](crate::compare()) judges.
pub fn tagged(tag: &FrameTag) -> Tagged {
    Tagged {
        stamp_ns: tag.header.stamp.to_nanoseconds(),
        valid: tag.valid,
        pose: Isometry::from(tag.pose.pose),
        covariance: xy_covariance(&tag.pose),
        ambiguous: tag.ambiguous,
    }
}

/// Reads all messages of a topic. If it is missing, the error gives `hint` and the topics with poses.
fn read_poses_of(path: &Path, name: &str, hint: &str) -> Result<Readout<LogMessage>, ReadoutError> {
    read_topic(path, name, || format!("{hint}{}", list_pose_topics(path)))
}

const POSE_TYPES: [&str; 3] = [PoseStamped::TYPE, PoseWithCovarianceStamped::TYPE, Odometry::TYPE];

/// Lists the topics of a log that hold poses, as the end of an error message.
fn list_pose_topics(path: &Path) -> String {
    let surveys = log::files_of(path).and_then(|files| log::surveys(&files)).unwrap_or_default();
    let types = log::topic_types(&surveys);
    let is_pose = |kinds: &std::collections::BTreeSet<String>| POSE_TYPES.iter().any(|kind| kinds.contains(*kind));
    let topics: Vec<&str> = types.iter().filter(|(_, kinds)| is_pose(kinds)).map(|(topic, _)| topic.as_str()).collect();
    if topics.is_empty() {
        "; it holds no poses at all".to_owned()
    } else {
        format!(": it holds poses on {}", topics.join(", "))
    }
}

/// Decodes a message with a pose; returns it with the names of its parent and child coordinate frames.
///
/// The covariance is zero for message types without one.
fn decode_pose(path: &Path, message: &LogMessage) -> Result<(Tagged, [String; 2]), EvaluationError> {
    let failed = |source| ReadoutError::Message {
        path: path.display().to_string(),
        topic: message.channel.topic.clone(),
        source,
    };
    let (header, child, pose): (Header, String, PoseWithCovariance) = match message.channel.type_name.as_str() {
        "geometry_msgs/msg/PoseStamped" => {
            let stamped = PoseStamped::decode(&message.data).map_err(failed)?;
            (stamped.header, String::new(), PoseWithCovariance { pose: stamped.pose, covariance: [0.0; 36] })
        }
        "geometry_msgs/msg/PoseWithCovarianceStamped" => {
            let stamped = PoseWithCovarianceStamped::decode(&message.data).map_err(failed)?;
            (stamped.header, String::new(), stamped.pose)
        }
        "nav_msgs/msg/Odometry" => {
            let odometry = Odometry::decode(&message.data).map_err(failed)?;
            (odometry.header, odometry.child_frame_id, odometry.pose)
        }
        other => {
            return Err(EvaluationError::Type {
                path: path.display().to_string(),
                topic: message.channel.topic.clone(),
                type_name: other.to_owned(),
            });
        }
    };
    let tagged = Tagged {
        stamp_ns: header.stamp.to_nanoseconds(),
        valid: true,
        pose: Isometry::from(pose.pose),
        covariance: xy_covariance(&pose),
        ambiguous: false,
    };
    Ok((tagged, [header.frame_id, child]))
}

/// Returns the covariance of x and y, square metres: xx, xy, yy.
fn xy_covariance(pose: &PoseWithCovariance) -> [f64; 3] {
    [pose.covariance[0], pose.covariance[1], pose.covariance[7]]
}
