//! What has happened so far: for `/diagnostics` while the agent runs, for the report at its end.

use std::collections::BTreeMap;

use super::report::{Quantiles, quantiles};
use super::stages::NotSeen;
use crate::recording::Counts;
use crate::ros2::messages::{DiagnosticArray, DiagnosticStatus, FrameTag, KeyValue};
use crate::sensors::log::DIAGNOSTICS_NAME;
use crate::sensors::scene::header;
use crate::sensors::synchroniser::Frame;

#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Why tags are invalid, and how many.
    pub invalid: BTreeMap<String, u64>,
    /// Messages whose bytes are not what their type says.
    pub bad_messages: u64,
    /// First image of which nothing could be seen, and why.
    pub first_bad_image: Option<String>,
    milliseconds: Vec<f32>,
}

impl Tally {
    pub fn note_tag(&mut self, tag: &FrameTag) {
        self.milliseconds.push(tag.elapsed_ms as f32);
        if !tag.valid {
            *self.invalid.entry(tag.reason.clone()).or_default() += 1;
        }
    }

    pub fn note_unseen(&mut self, frame: &Frame, unseen: &NotSeen, sequence: u64) {
        self.first_bad_image.get_or_insert_with(|| {
            let what = match unseen {
                NotSeen::Decode(error) => error.to_string(),
                NotSeen::Size { image, lens } => {
                    format!("{} x {} pixels, but the lens has {} x {}", image[0], image[1], lens[0], lens[1])
                }
                NotSeen::NoPlace => match &frame.robot.place {
                    Err(error) => error.to_string(),
                    Ok(_) => String::new(),
                },
            };
            format!("{}, frame {sequence}: {what}", frame.message.channel.topic)
        });
    }

    pub fn filter_ms(&mut self) -> Quantiles {
        quantiles(&mut self.milliseconds)
    }

    pub fn diagnostics(&self, log_time_ns: i64, robot: &str, counts: &Counts) -> DiagnosticArray {
        let value = |key: &str, value: u64| KeyValue { key: key.to_owned(), value: value.to_string() };
        let mut values = vec![
            value("frames_captured", counts.captured),
            value("frames_written", counts.written),
            value("frames_tagged", counts.tagged),
            value("frames_valid", counts.valid),
            value("bad_messages", self.bad_messages),
        ];
        values.extend(counts.dropped.iter().map(|(cause, count)| value(&format!("dropped_{cause}"), *count)));
        let conserved = counts.is_conserved();
        let status = DiagnosticStatus {
            level: if conserved { DiagnosticStatus::OK } else { DiagnosticStatus::ERROR },
            name: format!("{DIAGNOSTICS_NAME}recorder"),
            message: if conserved { "captured = written + dropped" } else { "frames are unaccounted for" }.to_owned(),
            hardware_id: robot.to_owned(),
            values,
        };
        DiagnosticArray { header: header(log_time_ns, ""), status: vec![status] }
    }
}
