//! A segment's line of the manifest, from what the segment holds.

use std::collections::BTreeMap;

use super::super::gap::gaps_in;
use super::super::manifest::{Counts, ManifestLine, PoseBox, TopicEntry};
use super::super::recorder::note_gap;
use super::super::topic;
use crate::config::Topics;
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::{FrameTag, Message};
use crate::sensors::intake::is_frame;

pub(super) struct Account<'a> {
    topics: &'a Topics,
    counts: Counts,
    poses: Option<PoseBox>,
    times: Option<(i64, i64)>,
    messages: u64,
    by_topic: BTreeMap<TopicEntry, u64>,
}

impl<'a> Account<'a> {
    pub fn new(topics: &'a Topics) -> Self {
        Self { topics, counts: Counts::default(), poses: None, times: None, messages: 0, by_topic: BTreeMap::new() }
    }

    pub fn messages(&self) -> u64 {
        self.messages
    }

    pub fn note(&mut self, message: &LogMessage) {
        let at_ns = message.log_time_ns;
        self.times = Some(self.times.map_or((at_ns, at_ns), |(first, last)| (first.min(at_ns), last.max(at_ns))));
        self.messages += 1;
        *self.by_topic.entry(TopicEntry::of(&message.channel)).or_default() += 1;
        if is_frame(&message.channel, self.topics) {
            self.counts.captured += 1;
            self.counts.written += 1;
        }
        if message.channel.topic == topic::FRAME_TAG {
            self.counts.tagged += 1;
            if let Some(tag) = FrameTag::decode(&message.data).ok().filter(|tag| tag.valid) {
                self.counts.valid += 1;
                let position = &tag.pose.pose.position;
                self.poses = Some(PoseBox::around(self.poses, position.x, position.y));
            }
        }
        for gap in gaps_in(message) {
            note_gap(&mut self.counts, &gap);
        }
    }

    pub fn line(self, name: &str, bytes: u64, blake3: String, cut: u64) -> (ManifestLine, BTreeMap<TopicEntry, u64>) {
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
