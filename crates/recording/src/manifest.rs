//! What a session says about itself: `session.json`, one line of `manifest.jsonl` per segment, and `metadata.yaml`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use realitysim_config::Settings;
use realitysim_geometry::{FieldDimensions, LensParameters};
use realitysim_ros2::mcap_read::Channel;

/// Version of the format of `session.json`; a reader refuses any other.
pub const FORMAT_VERSION: u32 = 1;
/// File with a [`SessionInfo`]. A folder that has it is a session.
pub const SESSION_FILE: &str = "session.json";
/// File with one [`ManifestLine`] per finished segment.
pub const MANIFEST_FILE: &str = "manifest.jsonl";
/// File that `ros2 bag` reads; it is written last.
pub const METADATA_FILE: &str = "metadata.yaml";
/// A session whose folder has a file of this name is pinned: `prune` leaves it, and the recorder makes room with it
/// last.
pub const PIN_FILE: &str = "pinned";
/// File in the folder of a session that was synced: how many copies lie between it and the recorder.
pub const RECEIVED_FILE: &str = "received.json";
/// Folder in a session's folder with the result of `refine`.
pub const REFINED_FOLDER: &str = "refined";
/// File that lists segments that were removed because another store has them.
pub const EVICTED_FILE: &str = "evicted.jsonl";

/// Content of `session.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SessionInfo {
    /// Version of the format, [`FORMAT_VERSION`].
    pub format: u32,
    /// Identity of the session whatever its folder is called: 32 hexadecimal digits.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<String>,
    /// Name and version of the program that recorded.
    pub software: String,
    /// Name of the robot.
    pub robot: String,
    /// UTC of the first message, RFC 3339.
    pub started: String,
    /// The log or scene that was replayed; `None` for a live recording.
    pub source: Option<String>,
    /// Settings as they were used; `topics` are those that the log was found to have. Everything that reads a capture
    /// goes by them.
    #[serde(deserialize_with = "super::recorded_settings::deserialize")]
    pub settings: Settings,
    /// Dimensions of the field.
    pub field: FieldDimensions,
    /// Parameters of the lens.
    pub lens: LensParameters,
    /// The robot's own body in the image, for each mask of the settings: row by row, alternating numbers of pixels
    /// that are visible and hidden, the first of them visible.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub body_masks: Vec<Vec<u32>>,
    /// Camera and clock of a live recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub live: Option<LiveInfo>,
}

/// What a live camera agreed to, and how its clock stands to UTC.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LiveInfo {
    /// Identity of the machine, which tells apart two robots of one name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot_id: Option<String>,
    /// UTC minus CLOCK_MONOTONIC, frozen at the start, ns.
    pub utc_offset_ns: i64,
    /// Delay that is subtracted from the camera's stamps, ns.
    pub camera_delay_ns: i64,
    /// Format, size, rate and controls as read back; null if there was no camera yet.
    pub camera: serde_json::Value,
}

/// Number of frames by what became of them: captured = written + thinned + the sum of dropped.
///
/// In the end each frame that reached the recorder, written or not, is tagged or untagged.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counts {
    /// Frames that the camera made.
    pub captured: u64,
    /// Frames that were written.
    pub written: u64,
    /// Frames that have a tag.
    pub tagged: u64,
    /// Frames that have a valid tag.
    pub valid: u64,
    /// Frames that were tagged and not written, as `recording.thinning` asks.
    #[serde(default)]
    pub thinned: u64,
    /// Frames that were not written, by cause.
    pub dropped: BTreeMap<String, u64>,
    /// Frames that were written and whose time of exposure is unknown, by cause.
    #[serde(default)]
    pub untagged: BTreeMap<String, u64>,
    /// Other messages that were taken and not written, by cause.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub lost: BTreeMap<String, u64>,
}

/// Sum of numbers that a file may hold in any size, at most `u64::MAX`.
pub fn saturating_sum(numbers: impl IntoIterator<Item = u64>) -> u64 {
    numbers.into_iter().fold(0, u64::saturating_add)
}

impl Counts {
    /// Whether every captured frame was written, thinned out or dropped.
    pub fn is_conserved(&self) -> bool {
        self.captured == saturating_sum([self.written, self.thinned, self.all_dropped()])
    }

    /// Dropped frames of all causes.
    pub fn all_dropped(&self) -> u64 {
        saturating_sum(self.dropped.values().copied())
    }

    /// Share of valid tags among all tags, 0 to 1, be their frames written or not; `None` without tags.
    pub fn valid_share(&self) -> Option<f64> {
        (self.tagged > 0).then(|| self.valid as f64 / self.tagged as f64)
    }

    /// Adds other counts; a sum that is too large stays at `u64::MAX`, since a manifest may have been edited.
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

/// Smallest box around the valid tags, metres in `map`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseBox {
    /// Least and greatest x, m.
    pub x: [f64; 2],
    /// Least and greatest y, m.
    pub y: [f64; 2],
}

impl PoseBox {
    /// Box around a known box, if there is one, and a point.
    pub fn around(known: Option<Self>, x: f64, y: f64) -> Self {
        let PoseBox { x: [x0, x1], y: [y0, y1] } = known.unwrap_or(PoseBox { x: [x, x], y: [y, y] });
        PoseBox { x: [x0.min(x), x1.max(x)], y: [y0.min(y), y1.max(y)] }
    }
}

/// A finished segment, as a line of the manifest describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ManifestLine {
    /// Name of the segment's file.
    pub name: String,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// BLAKE3 hash of the file, 64 hexadecimal digits.
    pub blake3: String,
    /// Earliest log time, ns; 0 without messages.
    pub first_ns: i64,
    /// Latest log time, ns.
    pub last_ns: i64,
    /// Number of messages.
    pub messages: u64,
    /// Frames of this segment.
    pub frames: Counts,
    /// Box around the valid tags; `None` without any.
    pub poses: Option<PoseBox>,
    /// Bytes that a repair could not keep of a segment that was never finished.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut_bytes: Option<u64>,
}

impl ManifestLine {
    /// Log times of the first and the last message, ns; `None` without messages.
    pub fn times(&self) -> Option<(i64, i64)> {
        (self.messages > 0).then_some((self.first_ns, self.last_ns))
    }

    /// First and last log time of several segments, ns; `None` without messages.
    pub fn times_of<'a>(lines: impl IntoIterator<Item = &'a Self>) -> Option<(i64, i64)> {
        let times = lines.into_iter().filter_map(Self::times);
        times.reduce(|(first, last), (from, to)| (first.min(from), last.max(to)))
    }
}

/// Key of an entry of `metadata.yaml`. Readers look for the files' channels by all three fields.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TopicEntry {
    /// Topic.
    pub name: String,
    /// Type of the messages.
    pub type_name: String,
    /// Quality of service, as YAML.
    pub qos_profiles: String,
}

impl TopicEntry {
    /// Entry of a channel.
    pub fn of(channel: &Channel) -> Self {
        let [name, type_name, qos_profiles] =
            [&channel.topic, &channel.type_name, channel.qos_profiles()].map(str::to_owned);
        Self { name, type_name, qos_profiles }
    }
}

/// Content of `metadata.yaml` (version 5, which `ros2 bag` understands since Humble). `topics` has the number of
/// messages of each topic.
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

/// Quotes a text for YAML. Every JSON string is a YAML string.
fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
