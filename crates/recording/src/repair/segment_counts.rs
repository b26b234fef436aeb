//! Counts of a segment: makes its manifest line from what it holds.

use std::collections::{BTreeMap, BTreeSet};

use super::super::gap::gaps_in;
use super::super::manifest::{Counts, ManifestLine, PoseBox, TopicEntry};
use super::super::recorder::count_gap;
use realitysim_config::{Settings, ThinningMode};
use realitysim_log_input::decode::stamp_ns;
use realitysim_log_input::measurement::is_frame;
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::{FrameTag, Message};
use realitysim_ros2::topics;

/// Counts of the messages of one segment.
pub(super) struct SegmentCounts<'a> {
    settings: &'a Settings,
    /// Stamps of images that no tag was found for yet, ns, if frames are thinned: each image stands before its tag
    /// then.
    images: BTreeSet<i64>,
    /// Tags whose image is missing.
    tags_without_image: u64,
    counts: Counts,
    poses: Option<PoseBox>,
    times: Option<(i64, i64)>,
    messages: u64,
    by_topic: BTreeMap<TopicEntry, u64>,
}

impl<'a> SegmentCounts<'a> {
    /// Begins with an empty segment.
    pub fn new(settings: &'a Settings) -> Self {
        Self {
            settings,
            images: BTreeSet::new(),
            tags_without_image: 0,
            counts: Counts::default(),
            poses: None,
            times: None,
            messages: 0,
            by_topic: BTreeMap::new(),
        }
    }

    /// Number of messages.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Counts a message.
    pub fn note(&mut self, message: &LogMessage) {
        let at_ns = message.log_time_ns;
        self.times = Some(self.times.map_or((at_ns, at_ns), |(first, last)| (first.min(at_ns), last.max(at_ns))));
        self.messages += 1;
        *self.by_topic.entry(TopicEntry::of(&message.channel)).or_default() += 1;
        let thins = self.settings.recording.thinning.mode != ThinningMode::All;
        if is_frame(&message.channel, &self.settings.topics) {
            self.counts.captured += 1;
            self.counts.written += 1;
            self.images.extend(thins.then(|| stamp_ns(message).ok()).flatten());
        }
        if message.channel.topic == topics::FRAME_TAG {
            self.counts.tagged += 1;
            let tag = FrameTag::decode(&message.data).ok();
            let stamp = tag.as_ref().map(|tag| tag.header.stamp.to_nanoseconds());
            self.tags_without_image += u64::from(thins && stamp.is_some_and(|stamp| !self.images.remove(&stamp)));
            if let Some(tag) = tag.filter(|tag| tag.valid) {
                self.counts.valid += 1;
                let position = &tag.pose.pose.position;
                self.poses = Some(PoseBox::around(self.poses, position.x, position.y));
            }
        }
        for gap in gaps_in(message) {
            count_gap(&mut self.counts, &gap);
        }
    }

    /// Makes the manifest line and the numbers of messages by topic. `bytes` and `blake3` are size and hash of the
    /// file, `cut` the bytes that a repair could not keep.
    pub fn line(
        mut self,
        name: &str,
        bytes: u64,
        blake3: String,
        cut: u64,
    ) -> (ManifestLine, BTreeMap<TopicEntry, u64>) {
        // A tag without its image was thinned out, unless a gap says that the image was dropped.
        self.counts.thinned = self.tags_without_image.saturating_sub(self.counts.all_dropped());
        self.counts.captured += self.counts.thinned;
        let (first_ns, last_ns) = self.times.unwrap_or_default();
        let line = ManifestLine {
            name: name.to_owned(),
            bytes,
            blake3,
            first_ns,
            last_ns,
            messages: self.messages,
            frames: self.counts,
            poses: self.poses,
            cut_bytes: (cut > 0).then_some(cut),
        };
        (line, self.by_topic)
    }
}
