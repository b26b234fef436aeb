//! Tags and truth out of logs.

use std::path::Path;

use thiserror::Error;

use super::compare::Tagged;
use crate::geometry::Isometry;
use crate::recording::topic;
use crate::ros2::cdr::CdrError;
use crate::ros2::mcap_read::{LogMessage, Selection};
use crate::ros2::messages::{FrameTag, Header, Message, Odometry, Pose, PoseStamped, PoseWithCovarianceStamped};
use crate::sensors::intake::isometry;
use crate::sensors::log::{self, LogError, LogSource};

#[derive(Debug, Error)]
pub enum EvaluationError {
    #[error(transparent)]
    Log(#[from] LogError),
    #[error("{path}: no message on {topic}: {hint}")]
    NoMessages { path: String, topic: String, hint: &'static str },
    #[error("{path}: {topic}: {source}")]
    Message { path: String, topic: String, source: CdrError },
    #[error(
        "{path}: {topic} is of type {type_name}: poses are geometry_msgs/msg/PoseStamped, \
         PoseWithCovarianceStamped or nav_msgs/msg/Odometry"
    )]
    Type { path: String, topic: String, type_name: String },
}

/// All tags of a capture (a folder or one of its segments), in the order of the frames.
pub fn read_tags(path: &Path) -> Result<Vec<FrameTag>, EvaluationError> {
    let messages = read_topic(path, topic::FRAME_TAG, "is it a capture? `realitysim replay` makes one")?;
    messages
        .iter()
        .map(|message| {
            FrameTag::decode(&message.data).map_err(|source| EvaluationError::Message {
                path: path.display().to_string(),
                topic: topic::FRAME_TAG.to_owned(),
                source,
            })
        })
        .collect()
}

/// The true poses of `camera_link` in time order.
pub fn read_truth(path: &Path, name: &str) -> Result<Vec<(i64, Isometry)>, EvaluationError> {
    let messages =
        read_topic(path, name, "name the topic of the true poses with topics.ground_truth or --truth-topic")?;
    let mut truth = messages.iter().map(|message| stamped_pose(path, message)).collect::<Result<Vec<_>, _>>()?;
    truth.sort_by_key(|(stamp, _)| *stamp);
    truth.dedup_by_key(|(stamp, _)| *stamp);
    Ok(truth)
}

pub fn tagged(tag: &FrameTag) -> Tagged {
    let covariance = &tag.pose.covariance;
    Tagged {
        stamp_ns: tag.header.stamp.to_nanoseconds(),
        valid: tag.valid,
        pose: isometry(&tag.pose.pose.position, &tag.pose.pose.orientation),
        covariance: [covariance[0], covariance[1], covariance[7]],
    }
}

fn read_topic(path: &Path, name: &str, hint: &'static str) -> Result<Vec<LogMessage>, EvaluationError> {
    let files = log::files_of(path)?;
    let source = LogSource::with_outputs(files, Selection::topics([name]));
    let messages = source.collect::<Result<Vec<_>, _>>()?;
    if messages.is_empty() {
        return Err(EvaluationError::NoMessages { path: path.display().to_string(), topic: name.to_owned(), hint });
    }
    Ok(messages)
}

fn stamped_pose(path: &Path, message: &LogMessage) -> Result<(i64, Isometry), EvaluationError> {
    let failed = |source| EvaluationError::Message {
        path: path.display().to_string(),
        topic: message.channel.topic.clone(),
        source,
    };
    let (header, pose): (Header, Pose) = match message.channel.type_name.as_str() {
        "geometry_msgs/msg/PoseStamped" => {
            let stamped = PoseStamped::decode(&message.data).map_err(failed)?;
            (stamped.header, stamped.pose)
        }
        "geometry_msgs/msg/PoseWithCovarianceStamped" => {
            let stamped = PoseWithCovarianceStamped::decode(&message.data).map_err(failed)?;
            (stamped.header, stamped.pose.pose)
        }
        "nav_msgs/msg/Odometry" => {
            let odometry = Odometry::decode(&message.data).map_err(failed)?;
            (odometry.header, odometry.pose.pose)
        }
        other => {
            return Err(EvaluationError::Type {
                path: path.display().to_string(),
                topic: message.channel.topic.clone(),
                type_name: other.to_owned(),
            });
        }
    };
    Ok((header.stamp.to_nanoseconds(), isometry(&pose.position, &pose.orientation)))
}
