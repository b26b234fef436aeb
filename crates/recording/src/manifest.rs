//! What a session says about itself: `session.json`, a line of `manifest.jsonl` per segment, `metadata.yaml`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use realitysim_config::Settings;
use realitysim_geometry::{FieldDimensions, LensParameters};
use realitysim_ros2::mcap_read::Channel;

pub const FORMAT_VERSION: u32 = 1;
/// What a session's folder is known by.
pub const SESSION_FILE: &str = "session.json";
pub const MANIFEST_FILE: &str = "manifest.jsonl";
/// For `ros2 bag`; written last.
pub const METADATA_FILE: &str = "metadata.yaml";
/// A file of this name in a session's folder: `prune` leaves the session, the recorder makes room with it last.
pub const PIN_FILE: &str = "pinned";
/// In a session's folder that was synced into: how many copies there are between it and the recorder.
pub const RECEIVED_FILE: &str = "received.json";
/// In a session's folder: what `refine` has made of it.
pub const REFINED_FOLDER: &str = "refined";
/// Segments that were removed because another store has them.
pub const EVICTED_FILE: &str = "evicted.jsonl";

/// `session.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionInfo {
    pub format: u32,
    /// Of this session alone, whatever its folder is called: 32 hexadecimal digits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    pub software: String,
    pub robot: String,
    /// UTC of the first message, RFC 3339.
    pub started: String,
    /// The log or scene that was replayed.
    pub source: Option<String>,
    /// As they were used: `topics` are those that the log was found to have. Everything that reads a capture goes by them.
    pub settings: Settings,
    pub field: FieldDimensions,
    pub lens: LensParameters,
    /// What of the image is the robot's own body, of each mask of the settings: row by row, how many pixels show, hide, show, and so on.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub body_masks: Vec<Vec<u32>>,
    /// Of a live recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveInfo>,
}

/// What a live camera agreed to, and how its clock stands to UTC.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveInfo {
    /// Of the machine: two robots of one name are told apart by it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot_id: Option<String>,
    /// UTC minus CLOCK_MONOTONIC, frozen at the start.
    pub utc_offset_ns: i64,
    /// Subtracted from the camera's stamps.
    pub camera_delay_ns: i64,
    /// Format, size, rate and controls as read back; null if there was no camera yet.
    pub camera: serde_json::Value,
}

/// Frames, by what became of them: captured = written + thinned + the sum of dropped. In the end each frame that reached the
/// recorder, whether it was written or not, is tagged or untagged.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    pub captured: u64,
    pub written: u64,
    pub tagged: u64,
    pub valid: u64,
    /// Tagged and not written, as `recording.thinning` asks.
    #[serde(default)]
    pub thinned: u64,
    /// Not written, by cause.
    pub dropped: BTreeMap<String, u64>,
    /// Written, but of which nobody can say when they were exposed; by cause.
    #[serde(default)]
    pub untagged: BTreeMap<String, u64>,
    /// Other messages that were taken and not written, by cause.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub lost: BTreeMap<String, u64>,
}

/// Of numbers that anybody may have edited: as much as can be counted.
pub fn saturating_sum(numbers: impl IntoIterator<Item = u64>) -> u64 {
    numbers.into_iter().fold(0, u64::saturating_add)
}

impl Counts {
    /// Every captured frame was written, thinned out or dropped.
    pub fn is_conserved(&self) -> bool {
        self.captured == saturating_sum([self.written, self.thinned, self.all_dropped()])
    }

    /// Whatever the cause.
    pub fn all_dropped(&self) -> u64 {
        saturating_sum(self.dropped.values().copied())
    }

    /// Of the tags, be their frames written or not; `None` without any.
    pub fn valid_share(&self) -> Option<f64> {
        (self.tagged > 0).then(|| self.valid as f64 / self.tagged as f64)
    }

    /// Of a manifest that somebody edited, as much as can be counted.
    pub fn add(&mut self, other: &Self) {
        self.captured = self.captured.saturating_add(other.captured);
        self.written = self.written.saturating_add(other.written);
        self.tagged = self.tagged.saturating_add(other.tagged);
        self.valid = self.valid.saturating_add(other.valid);
        self.thinned = self.thinned.saturating_add(other.thinned);
        let sums = [&mut self.dropped, &mut self.untagged, &mut self.lost];
        for (sum, more) in sums.into_iter().zip([&other.dropped, &other.untagged, &other.lost]) {
            for (cause, count) in more {
                let sum = sum.entry(cause.clone()).or_default();
                *sum = sum.saturating_add(*count);
            }
        }
    }
}

/// Smallest box around the valid tags: metres in `map`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseBox {
    pub x: [f64; 2],
    pub y: [f64; 2],
}

impl PoseBox {
    pub fn around(known: Option<Self>, x: f64, y: f64) -> Self {
        let PoseBox { x: [x0, x1], y: [y0, y1] } = known.unwrap_or(PoseBox { x: [x, x], y: [y, y] });
        PoseBox { x: [x0.min(x), x1.max(x)], y: [y0.min(y), y1.max(y)] }
    }
}

/// A finished segment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ManifestLine {
    pub name: String,
    pub bytes: u64,
    pub blake3: String,
    pub first_ns: i64,
    pub last_ns: i64,
    pub messages: u64,
    pub frames: Counts,
    pub poses: Option<PoseBox>,
    /// Of a segment that was never finished: so much of its file made no sense and was cut off.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut_bytes: Option<u64>,
}

impl ManifestLine {
    /// Log times of the first and the last message; `None` without any.
    pub fn times(&self) -> Option<(i64, i64)> {
        (self.messages > 0).then_some((self.first_ns, self.last_ns))
    }

    /// First and last of several segments.
    pub fn times_of<'a>(lines: impl IntoIterator<Item = &'a Self>) -> Option<(i64, i64)> {
        let times = lines.into_iter().filter_map(Self::times);
        times.reduce(|(first, last), (from, to)| (first.min(from), last.max(to)))
    }
}

/// What tells an entry of `metadata.yaml` from the others. Readers look for the files' channels by all three.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TopicEntry {
    pub name: String,
    pub type_name: String,
    pub qos_profiles: String,
}

impl TopicEntry {
    pub fn of(channel: &Channel) -> Self {
        let [name, type_name, qos_profiles] =
            [&channel.topic, &channel.type_name, channel.qos_profiles()].map(str::to_owned);
        Self { name, type_name, qos_profiles }
    }
}

/// What `ros2 bag` wants beside the files (version 5: understood since Humble).
/// `topics` with the number of their messages.
pub fn metadata_yaml(lines: &[ManifestLine], topics: &BTreeMap<TopicEntry, u64>) -> String {
    let (first, last) = ManifestLine::times_of(lines).unwrap_or_default();
    let messages: u64 = topics.values().sum();
    let mut yaml = String::new();
    // Writing to a String cannot fail.
    let _ = write!(
        yaml,
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {}\n  \
         starting_time:\n    nanoseconds_since_epoch: {first}\n  message_count: {messages}\n  \
         topics_with_message_count:\n",
        last.saturating_sub(first)
    );
    for (TopicEntry { name, type_name, qos_profiles }, messages) in topics {
        let _ = write!(
            yaml,
            "    - topic_metadata:\n        name: {}\n        type: {}\n        serialization_format: cdr\n        \
             offered_qos_profiles: {}\n      message_count: {messages}\n",
            quoted(name),
            quoted(type_name),
            quoted(qos_profiles)
        );
    }
    let _ = writeln!(yaml, "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:");
    for line in lines {
        let _ = writeln!(yaml, "    - {}", quoted(&line.name));
    }
    let _ = writeln!(yaml, "  files:");
    for line in lines {
        let (from, to) = line.times().unwrap_or((first, first));
        let _ = write!(
            yaml,
            "    - path: {}\n      starting_time:\n        nanoseconds_since_epoch: {}\n      duration:\n        \
             nanoseconds: {}\n      message_count: {}\n",
            quoted(&line.name),
            from,
            to.saturating_sub(from),
            line.messages
        );
    }
    yaml
}

/// A JSON string is a YAML one.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
