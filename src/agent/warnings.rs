//! What a user will want to know although nothing failed.

use crate::config::FrameNames;
use crate::ros2::messages::{Imu, Message};

/// Where the attitude comes from, if it does.
#[derive(Clone, Debug)]
pub struct AttitudeSource {
    /// `topics.imu`, chosen or found.
    pub topic: String,
    /// All topics of the log that an IMU is on.
    pub all: Vec<String>,
}

impl AttitudeSource {
    /// `unknown` of `frames` were tagged without knowing how the torso was tilted; `was_heard`: an attitude came at all.
    pub fn warning(&self, unknown: u64, frames: u64, was_heard: bool, names: &FrameNames) -> Option<String> {
        if unknown == 0 {
            return None;
        }
        let Self { topic, all } = self;
        let kind = Imu::TYPE;
        let why = if was_heard && unknown == frames {
            let FrameNames { base_footprint, base_link, .. } = names;
            format!(
                "the attitude on {topic} is that of {base_link}, and the transforms from {base_footprint} to the camera \
                 do not pass through it: name the torso with frames.base_link"
            )
        } else if was_heard {
            format!("they came before the first attitude on {topic}")
        } else if all.contains(topic) {
            format!(
                "{topic} states no orientation (orientation_covariance[0] is -1, or the quaternion is zero): record the \
                 topic of a filter that computes it, such as imu_filter_madgwick"
            )
        } else if all.is_empty() {
            format!("the log has no topic of type {kind}: record the torso's attitude")
        } else {
            format!("{topic} is not of type {kind}: choose one with topics.imu: {}", all.join(", "))
        };
        let standing = "as if the torso stood upright, which costs several times the accuracy";
        Some(format!("{unknown} of {frames} frames were tagged {standing}: {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn warning(all: &[&str], unknown: u64, was_heard: bool) -> String {
        let all = all.iter().map(|topic| (*topic).to_owned()).collect();
        let source = AttitudeSource { topic: "/imu/data".to_owned(), all };
        source.warning(unknown, 9, was_heard, &FrameNames::default()).unwrap_or_default()
    }

    #[test]
    fn each_cause_has_its_remedy() {
        assert_eq!(warning(&["/imu/data"], 0, true), "");
        assert!(warning(&[], 9, false).contains("the log has no topic of type sensor_msgs/msg/Imu"));
        assert!(warning(&["/a", "/b"], 9, false).contains("choose one with topics.imu: /a, /b"));
        assert!(warning(&["/imu/data"], 9, false).contains("orientation_covariance[0]"));
        assert!(warning(&["/imu/data"], 2, true).starts_with("2 of 9 frames"));
        assert!(warning(&["/imu/data"], 9, true).contains("frames.base_link"));
    }
}
