//! Begin and end of a session while the recorder runs.

use crossbeam_channel::bounded;
use serde_json::{Value, json};

use super::event_loop::LiveRecorder;
use super::messages::{Messages, initial_pose, transforms};
use super::notifications::Announced;
use super::status::RecorderState;
use super::{RecordError, RecordOptions};
use crate::geometry::{LensParameters, Pose2};
use crate::log_input::measurement::{self, Measurement};
use crate::log_input::synchroniser::{Expected, Synchroniser, SynchroniserState};
use crate::recording::{LiveInfo, Writing, robot_id};
use crate::ros2::mcap_read::LogMessage;
use crate::ros2::messages::{CameraInfo, Header, TFMessage};
use crate::tagging::log_scan::StreamInfo;
use crate::tagging::pipeline::{Pipeline, Recorded, Recording};
use crate::tagging::setup::{Setup, SetupError};
use crate::tagging::warm_start::{InitialState, last_state};
use crate::tagging::warnings::AttitudeSource;

/// Tags that can wait between the pipeline and the event loop.
const MAX_TAGS: usize = 256;
/// Distance beyond the carpet's edge that an announced pose may have, metres: a robot may start beside the carpet.
const OFF_CARPET_TOLERANCE_M: f64 = 1.0;

impl LiveRecorder<'_> {
    /// Begins a session, unless one is under way. Its first messages are the constant transforms and the calibration.
    pub(super) fn begin_session(&mut self, say: &mut dyn FnMut(&str)) -> Result<(), RecordError> {
        if self.session.is_some() {
            return Ok(());
        }
        let now_ns = self.now_ns();
        let (setup, constants) = setup(self.options, &self.lens, now_ns, self.heard)?;
        self.carpet_half_m = Some(setup.field.carpet_half_extent());
        // A session after the first goes on from where that one ended, so the pose announced for the start does not hold.
        let is_first = !core::mem::replace(&mut self.had_session, true);
        if !is_first {
            self.status.begin_session();
        }
        let warm = match self.between.take() {
            Some(between) => Some(between.kept()),
            None if self.options.warm_start => last_state(&self.options.captures).unwrap_or_else(|error| {
                say(&format!("{error}; the filter begins without it"));
                None
            }),
            None => None,
        };
        let (send, tags) = bounded(MAX_TAGS);
        let bytes_per_s = self.options.settings.capture.bytes_per_s((self.lens.width, self.lens.height));
        let recording = Recording {
            captures: self.options.captures.clone(),
            source: None,
            threads: self.options.threads,
            live: Some(LiveInfo {
                robot_id: Some(robot_id()),
                utc_offset_ns: self.clock_ns,
                camera_delay_ns: (self.options.settings.capture.delay_ms * 1e6) as i64,
                camera: json!(self.status.camera),
            }),
            tags: Some(send),
            writing: Writing::Behind { bytes_per_s },
        };
        self.session = Some(Pipeline::new(setup, InitialState { warm, ..InitialState::default() }, recording));
        self.tags = Some(tags);
        self.status.state = RecorderState::Recording;
        let [transforms, info] = constants;
        self.log(transforms)?;
        self.log(info)?;
        if let Some(initial) = self.options.initial.as_ref().filter(|_| is_first) {
            self.log_initial_pose(initial)?;
        }
        self.announced = Announced::default();
        Ok(())
    }

    /// Takes an announced pose at any time after the first session has begun, and returns the answer for its sender.
    pub(super) fn take_announced_pose(&mut self, place: &Pose2) -> Result<Value, RecordError> {
        let Some(half) = self.carpet_half_m else {
            return Ok(json!({ "error": "no session has begun: the place is named with --initial" }));
        };
        if place.x.abs() > half.x + OFF_CARPET_TOLERANCE_M || place.y.abs() > half.y + OFF_CARPET_TOLERANCE_M {
            let what = format!(
                "{},{} is not on the field: its carpet reaches {:.2} m from the centre in x and {:.2} m in y",
                place.x, place.y, half.x, half.y
            );
            return Ok(json!({ "error": what, "usage": true }));
        }
        self.log_initial_pose(place)?;
        Ok(json!({ "place": [place.x, place.y, place.yaw.to_degrees()] }))
    }

    /// Logs the announced pose as a message on the topic of initial poses.
    fn log_initial_pose(&mut self, place: &Pose2) -> Result<(), RecordError> {
        let message = initial_pose(self.now_ns(), place, &self.names.frames);
        let message = self.messages.message(&self.names.topics.initial_pose.clone(), false, &message);
        self.log(message)
    }

    /// Ends the session and completes its capture as far as the disk allows; `sessions repair` can do the rest later.
    pub(super) fn end_session(&mut self, say: &mut dyn FnMut(&str)) {
        self.refresh_status();
        self.status.state = RecorderState::Stopped;
        let Some(session) = self.session.take() else { return };
        let (recorded, ended, between) = session.pause();
        self.between = Some(between);
        // Tags of frames that were still being looked at.
        self.forward_tags();
        if let Some(Recorded { session, counts, recorder, warnings, .. }) = recorded {
            for warning in warnings {
                say(&format!("warning: {warning}"));
            }
            if let Some(session) = session {
                say(&format!("recorded {}", session.display()));
                self.status.session = Some(session);
            }
            self.status.counts = counts;
            self.status.recorder = recorder;
        }
        if let Err(error) = ended {
            say(&format!(
                "the session is not whole: {error}; the next start or `realitysim sessions repair` finishes it"
            ));
            self.status.unfinished = Some(error.to_string());
        }
    }
}

/// Makes the setup that a replay would read from a log beginning with these constants (transforms, calibration); returns
/// both.
pub(super) fn setup(
    options: &RecordOptions,
    lens: &LensParameters,
    now_ns: i64,
    expected: Expected,
) -> Result<(Setup, [LogMessage; 2]), RecordError> {
    let settings = &options.settings;
    let height = settings.mount.torso_height_m.ok_or(RecordError::NoMount)?;
    let topics = settings.topics.clone();
    let constants: TFMessage = transforms(now_ns, height, &settings.mount, &settings.frames);
    let info: CameraInfo = CameraInfo::of_lens(lens, Header::at(now_ns, &settings.frames.camera_optical));
    let mut messages = Messages::default();
    let constants = messages.message(&topics.tf_static, true, &constants);
    let calibration = messages.message(&topics.camera_info, true, &info);
    let mut synchroniser = Synchroniser::new(settings.frames.clone(), SynchroniserState::default());
    if let Ok(input @ Measurement::Transforms { .. }) = measurement::read(&constants, &topics, &settings.head) {
        synchroniser.push(&constants, input);
    }
    synchroniser.check_mount(false).map_err(SetupError::from)?;
    let attitude = AttitudeSource { topic: topics.imu.clone(), all: vec![topics.imu.clone()] };
    let prelude = StreamInfo {
        topics,
        camera_info: Some(info),
        image_size: Some([lens.width, lens.height]),
        synchroniser: synchroniser.state().clone(),
        expected,
        attitude,
        choices: Vec::new(),
        warnings: Vec::new(),
    };
    Ok((Setup::new(settings.clone(), prelude)?, [constants, calibration]))
}
