//! Statistics of a run: for `/diagnostics` while the agent runs, and for the report at its end.

use std::collections::BTreeMap;

use super::filter_stats::FilterStats;
use super::perception_pool::PerceptionError;
use realitysim_log_input::synchroniser::{Frame, RobotState};
use realitysim_recording::Counts;
use realitysim_ros2::cdr::CdrError;
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::{DiagnosticArray, DiagnosticStatus, FrameTag, Header, KeyValue};
use realitysim_ros2::topics::DIAGNOSTICS_PREFIX;

/// Counts of tags and of messages that could not be used.
#[derive(Clone, Debug, Default)]
pub struct RunStats {
    /// Number of tags made, which the other counts of tags are parts of. The recorder counts only those that the disk has
    /// kept.
    pub tags: u64,
    /// Number of invalid tags by reason.
    pub invalid: BTreeMap<String, u64>,
    /// The first frame with each reason, counted from 0.
    pub first_invalid: BTreeMap<String, u64>,
    /// Number of messages, other than frames, that do not decode as their type.
    pub bad_messages: u64,
    /// Description of the first image that could not be used.
    pub first_bad_image: Option<String>,
    /// Times and particles of the frames.
    pub effort: FilterStats,
    /// Number of poses predicted while no frame came.
    pub predicted: u64,
    /// Number of frames for which the tilt of the torso was not measured.
    pub without_tilt: u64,
    /// Number of particle weights that were NaN or +inf.
    pub unusable_weights: u64,
    /// Number of measurements with physically impossible numbers.
    pub impossible_measurements: u64,
    /// Number of measurements that came too late to be sorted in.
    pub late_measurements: u64,
    /// Number of frames after which the localizer started from nothing because a number was not finite.
    pub begun_anew: u64,
}

impl RunStats {
    /// Counts a tag.
    pub fn note_tag(&mut self, robot: &RobotState, tag: &FrameTag, budget_ms: f64) {
        self.tags += 1;
        self.effort.note(tag, budget_ms);
        self.without_tilt += u64::from(robot.place.as_ref().is_ok_and(|place| !place.tilt_is_measured));
        if !tag.valid {
            *self.invalid.entry(tag.reason.clone()).or_default() += 1;
            self.first_invalid.entry(tag.reason.clone()).or_insert(tag.sequence);
        }
    }

    /// Remembers why a frame's image could not be used, if it is the first one.
    pub fn note_unseen(&mut self, frame: &Frame, unseen: &PerceptionError, sequence: u64) {
        self.first_bad_image.get_or_insert_with(|| {
            let what = match unseen {
                PerceptionError::Decode(error) => error.to_string(),
                PerceptionError::Size { image, lens } => {
                    format!("{} x {} pixels, but the lens has {} x {}", image[0], image[1], lens[0], lens[1])
                }
                PerceptionError::NoPlace => match &frame.robot.place {
                    Err(error) => error.to_string(),
                    Ok(_) => String::new(),
                },
            };
            format!("{}, frame {sequence}: {what}", frame.message.channel.topic)
        });
    }

    /// Remembers a frame whose stamp cannot be read, if it is the first image that cannot be used.
    pub fn note_bad_frame(&mut self, message: &LogMessage, error: &CdrError) {
        let LogMessage { channel, log_time_ns, .. } = message;
        self.first_bad_image
            .get_or_insert_with(|| format!("{}, frame logged at {log_time_ns} ns: {error}", channel.topic));
    }

    /// Diagnostics of the recorder since the start, and of localization since the last call.
    ///
    /// `conserved` says whether every captured frame is accounted for.
    pub fn diagnostics(
        &mut self,
        log_time_ns: i64,
        robot: &str,
        counts: &Counts,
        conserved: bool,
        budget_ms: f64,
    ) -> DiagnosticArray {
        let value = |key: &str, value: u64| KeyValue { key: key.to_owned(), value: value.to_string() };
        let mut values = vec![
            value("frames_captured", counts.captured),
            value("frames_written", counts.written),
            value("frames_tagged", counts.tagged),
            value("frames_valid", counts.valid),
            value("frames_thinned", counts.thinned),
            value("bad_messages", self.bad_messages),
            value("late_measurements", self.late_measurements),
            value("impossible_measurements", self.impossible_measurements),
            value("unusable_weights", self.unusable_weights),
            value("begun_anew", self.begun_anew),
        ];
        let causes = [("dropped", &counts.dropped), ("untagged", &counts.untagged), ("lost", &counts.lost)];
        for (what, causes) in causes {
            values.extend(causes.iter().map(|(cause, count)| value(&format!("{what}_{cause}"), *count)));
        }
        let recorder = DiagnosticStatus {
            level: if conserved { DiagnosticStatus::OK } else { DiagnosticStatus::ERROR },
            name: format!("{DIAGNOSTICS_PREFIX}recorder"),
            message: if conserved { "captured = written + thinned + dropped" } else { "frames are unaccounted for" }
                .to_owned(),
            hardware_id: robot.to_owned(),
            values,
        };
        let localization = self.effort.diagnostics(robot, budget_ms);
        DiagnosticArray { header: Header::at(log_time_ns, ""), status: vec![recorder, localization] }
    }
}
