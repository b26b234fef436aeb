//! Tags and truth out of logs.

use std::path::{Path, PathBuf};

use thiserror::Error;

use super::compare::Tagged;
use crate::geometry::Isometry;
use crate::recording::{Loss, missing_parts, topic};
use crate::ros2::cdr::CdrError;
use crate::ros2::mcap_read::{Damage, LogMessage, Selection};
use crate::ros2::messages::{
    FrameTag, Header, Message, Odometry, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
};
use crate::sensors::intake::isometry;
use crate::sensors::log::{self, LogError, LogSource};

#[derive(Debug, Error)]
pub enum EvaluationError {
    #[error(transparent)]
    Log(#[from] LogError),
    #[error("{path}: no message on {topic}: {hint}{}", loss.as_ref().map(|l| format!(" ({l})")).unwrap_or_default())]
    NoMessages { path: String, topic: String, hint: &'static str, loss: Option<Loss> },
    #[error("{path}: {topic}: {source}")]
    Message { path: String, topic: String, source: CdrError },
    #[error(
        "{path}: {topic} is of type {type_name}: poses are geometry_msgs/msg/PoseStamped, \
         PoseWithCovarianceStamped or nav_msgs/msg/Odometry"
    )]
    Type { path: String, topic: String, type_name: String },
}

/// What could be read, and what is lost of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Readout<T> {
    pub found: Vec<T>,
    pub losses: Vec<Loss>,
}

/// All tags of a capture (a folder or one of its segments), in the order of the frames.
pub fn read_tags(path: &Path) -> Result<Readout<FrameTag>, EvaluationError> {
    let read = read_topic(path, topic::FRAME_TAG, "is it a capture? `realitysim replay` makes one")?;
    let tag = |message: &LogMessage| {
        FrameTag::decode(&message.data).map_err(|source| EvaluationError::Message {
            path: path.display().to_string(),
            topic: topic::FRAME_TAG.to_owned(),
            source,
        })
    };
    let found = read.found.iter().map(tag).collect::<Result<_, _>>()?;
    Ok(Readout { found, losses: read.losses })
}

/// The true poses of `camera_link` in time order.
pub fn read_truth(path: &Path, name: &str) -> Result<Readout<(i64, Isometry)>, EvaluationError> {
    let read = read_topic(path, name, "name the topic of the true poses with topics.ground_truth or --truth-topic")?;
    let posed = |message: &LogMessage| stamped_pose(path, message).map(|tag| (tag.stamp_ns, tag.pose));
    let mut found = read.found.iter().map(posed).collect::<Result<Vec<_>, _>>()?;
    found.sort_by_key(|(stamp, _)| *stamp);
    found.dedup_by_key(|(stamp, _)| *stamp);
    Ok(Readout { found, losses: read.losses })
}

/// Poses of `camera_link` in `map` that somebody else computed, in time order: they say of none that it is not valid.
pub fn read_poses(path: &Path, name: &str) -> Result<Readout<Tagged>, EvaluationError> {
    let read = read_topic(path, name, "name the topic of the poses to judge")?;
    let mut found = read.found.iter().map(|message| stamped_pose(path, message)).collect::<Result<Vec<_>, _>>()?;
    found.sort_by_key(|tag| tag.stamp_ns);
    Ok(Readout { found, losses: read.losses })
}

/// What is missing of a capture by its manifest, and what its readers met.
pub fn losses(path: &Path, damage: &[(PathBuf, Damage)]) -> Vec<Loss> {
    let mut losses = missing_parts(path);
    damage.iter().for_each(|(file, damage)| Loss::of_damage(file, damage).join(&mut losses));
    losses
}

pub fn tagged(tag: &FrameTag) -> Tagged {
    Tagged {
        stamp_ns: tag.header.stamp.to_nanoseconds(),
        valid: tag.valid,
        pose: isometry(&tag.pose.pose.position, &tag.pose.pose.orientation),
        covariance: in_plane(&tag.pose),
        ambiguous: tag.ambiguous,
    }
}

fn read_topic(path: &Path, name: &str, hint: &'static str) -> Result<Readout<LogMessage>, EvaluationError> {
    let mut source = LogSource::with_outputs(log::files_of(path)?, Selection::topics([name]));
    let found = source.by_ref().collect::<Result<Vec<_>, _>>()?;
    let losses = losses(path, source.damage());
    if !found.is_empty() {
        return Ok(Readout { found, losses });
    }
    let (path, topic) = (path.display().to_string(), name.to_owned());
    Err(EvaluationError::NoMessages { path, topic, hint, loss: losses.into_iter().next() })
}

/// With the covariance of those types that have one; else it is zero.
fn stamped_pose(path: &Path, message: &LogMessage) -> Result<Tagged, EvaluationError> {
    let failed = |source| EvaluationError::Message {
        path: path.display().to_string(),
        topic: message.channel.topic.clone(),
        source,
    };
    let (header, pose): (Header, PoseWithCovariance) = match message.channel.type_name.as_str() {
        "geometry_msgs/msg/PoseStamped" => {
            let stamped = PoseStamped::decode(&message.data).map_err(failed)?;
            (stamped.header, PoseWithCovariance { pose: stamped.pose, covariance: [0.0; 36] })
        }
        "geometry_msgs/msg/PoseWithCovarianceStamped" => {
            let stamped = PoseWithCovarianceStamped::decode(&message.data).map_err(failed)?;
            (stamped.header, stamped.pose)
        }
        "nav_msgs/msg/Odometry" => {
            let odometry = Odometry::decode(&message.data).map_err(failed)?;
            (odometry.header, odometry.pose)
        }
        other => {
            return Err(EvaluationError::Type {
                path: path.display().to_string(),
                topic: message.channel.topic.clone(),
                type_name: other.to_owned(),
            });
        }
    };
    Ok(Tagged {
        stamp_ns: header.stamp.to_nanoseconds(),
        valid: true,
        pose: isometry(&pose.pose.position, &pose.pose.orientation),
        covariance: in_plane(&pose),
        ambiguous: false,
    })
}

/// xx, xy, yy.
fn in_plane(pose: &PoseWithCovariance) -> [f64; 3] {
    [pose.covariance[0], pose.covariance[1], pose.covariance[7]]
}
