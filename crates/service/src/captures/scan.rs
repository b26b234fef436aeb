//! Reads a capture once: its tags, and where each image lies.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::path::PathBuf;

use serde_json::{Value, json};

use super::{is_being_recorded, last_part, unreadable};
use crate::HttpProblem;
use realitysim_geometry::{Field, Lens};
use realitysim_log_input::decode;
use realitysim_log_input::log::{self, LogSource};
use realitysim_recording::{ACTIVE, Session, SessionInfo, losses, read_info};
use realitysim_ros2::mcap_read::{LogMessage, Selection};
use realitysim_ros2::messages::{DiagnosticArray, DiagnosticStatus, FrameTag, Message};
use realitysim_ros2::topics::{DIAGNOSTICS, DIAGNOSTICS_PREFIX, FRAME_TAG};
use realitysim_tagging::cut::start_ns;

/// What was read of a capture.
pub(in super::super) struct Capture {
    pub(super) name: String,
    /// Sizes of the segments when they were read: a recording that goes on is read again.
    segments: BTreeMap<String, u64>,
    pub(super) info: SessionInfo,
    pub(super) field: Field,
    pub(super) lens: Lens,
    /// The session's folder.
    pub(super) folder: PathBuf,
    /// Log time of the first message.
    pub(super) start_ns: i64,
    /// Files of the capture, to which places refer.
    pub(super) files: Vec<PathBuf>,
    pub(super) frames: Vec<FrameEntry>,
    /// Reasons of invalid tags, to which frames refer.
    reasons: Vec<String>,
    marks: Vec<Event>,
    gaps: Vec<Event>,
    /// What is lost of the capture.
    lost: Vec<String>,
    /// Number of frames beyond [`MAX_FRAMES`], which are not shown.
    left_out: u64,
}

/// A tagged frame.
#[derive(Clone, Debug)]
pub(super) struct FrameEntry {
    pub(super) stamp_ns: i64,
    /// Time at which the tag was written.
    pub(super) log_time_ns: i64,
    pub(super) valid: bool,
    pub(super) ambiguous: bool,
    /// Index of the reason; that of a valid tag is empty.
    pub(super) reason: u16,
    /// Position and heading in `map`, metres and degrees.
    place: [f32; 3],
    sigma_m: f32,
    /// Share of the expected line places that fit.
    fitting: f32,
    rms_px: f32,
    explained: f32,
    /// Where the tag lies.
    pub(super) tag: Option<Place>,
    /// Where the image lies; `None` if it was thinned, lost, or is compressed once more.
    pub(super) image: Option<Place>,
}

/// Where the bytes of a message lie.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) file: u32,
    pub(super) offset: u64,
    pub(super) length: u32,
    /// Whether they are a `sensor_msgs/CompressedImage` rather than an `Image`; of no meaning for a tag.
    pub(super) is_compressed: bool,
}

/// Something that happened at a time.
struct Event {
    log_time_ns: i64,
    what: String,
}

/// Largest number of frames of a capture that are shown: two hours at 30 Hz. Each takes some 120 bytes.
const MAX_FRAMES: usize = 1 << 18;
/// Largest number of reasons that are told apart; there are less than thirty.
const MAX_REASONS: usize = 256;
/// Largest number of marks, and of gaps.
const MAX_EVENTS: usize = 4096;
/// Length of the parts of a capture that are judged, seconds.
const PART_S: f64 = 60.0;
/// Smallest share of valid tags of a part that is not called bad.
const GOOD_SHARE: f64 = 0.8;

impl Capture {
    /// Reads the capture of a session. What is damaged is left out and named.
    pub(super) fn read(session: &Session) -> Result<Self, HttpProblem> {
        let failed = |error: &dyn std::fmt::Display| unreadable(&without_folder(&error.to_string(), session));
        let info = read_info(&session.folder).map_err(|error| failed(&error))?;
        let field = Field::new(info.field.clone()).map_err(|error| failed(&error))?;
        let lens = Lens::new(info.lens.clone()).map_err(|error| failed(&error))?;
        let files = log::files_of(&session.folder).map_err(|error| failed(&error))?;
        let mut capture = Self {
            name: session.name.clone(),
            segments: session.segments.clone(),
            info,
            field,
            lens,
            folder: session.folder.clone(),
            start_ns: start_ns(&session.folder).map_err(|error| failed(&error))?,
            files,
            frames: Vec::new(),
            reasons: vec![String::new()],
            marks: Vec::new(),
            gaps: Vec::new(),
            lost: Vec::new(),
            left_out: 0,
        };
        let topic = capture.info.settings.topics.image.clone();
        let mut log =
            LogSource::with_outputs(capture.files.clone(), Selection::topics([&topic, FRAME_TAG, DIAGNOSTICS]));
        let mut images: HashMap<i64, VecDeque<Place>> = HashMap::new();
        while let Some(message) = log.next().transpose().map_err(|error| failed(&error))? {
            let place = capture.place_of(&message, &log);
            match message.channel.topic.as_str() {
                FRAME_TAG => capture.add_tag(&message, place),
                DIAGNOSTICS => capture.add_events(&message),
                _ => {
                    if let (Ok(stamp_ns), Some(place)) = (decode::stamp_ns(&message), place) {
                        images.entry(stamp_ns).or_default().push_back(place);
                    }
                }
            }
        }
        for frame in &mut capture.frames {
            frame.image = images.get_mut(&frame.stamp_ns).and_then(VecDeque::pop_front);
        }
        let lost = losses(&session.folder, log.damage());
        let mut lost: Vec<String> = lost.iter().map(|loss| without_folder(&loss.to_string(), session)).collect();
        if is_being_recorded(session) {
            // The segment that is being written has no end yet, which is no loss.
            lost.retain(|loss| !loss.contains(ACTIVE));
            lost.insert(0, "it is being recorded".to_owned());
        }
        capture.lost = lost;
        Ok(capture)
    }

    /// Returns whether this was read of a session as it is now.
    pub(super) fn is_of(&self, session: &Session) -> bool {
        self.name == session.name && self.segments == session.segments
    }

    fn place_of(&self, message: &LogMessage, log: &LogSource) -> Option<Place> {
        let (path, offset) = log.place()?;
        let file = self.files.iter().position(|file| file == path)? as u32;
        let is_compressed = message.channel.type_name == "sensor_msgs/msg/CompressedImage";
        Some(Place { file, offset, length: message.data.len() as u32, is_compressed })
    }

    fn add_tag(&mut self, message: &LogMessage, place: Option<Place>) {
        let Ok(tag) = FrameTag::decode(&message.data) else { return };
        if self.frames.len() == MAX_FRAMES {
            self.left_out += 1;
            return;
        }
        let at = &tag.pose.pose.position;
        let reason = self.reason(&tag.reason);
        self.frames.push(FrameEntry {
            stamp_ns: tag.header.stamp.to_nanoseconds(),
            log_time_ns: message.log_time_ns,
            valid: tag.valid,
            ambiguous: tag.ambiguous,
            reason,
            place: [at.x as f32, at.y as f32, tag.yaw.to_degrees() as f32],
            sigma_m: tag.pose.sigma_xy_m() as f32,
            fitting: tag.lines_fitting as f32 / tag.lines_expected.max(1) as f32,
            rms_px: tag.lines_rms_px as f32,
            explained: tag.lines_explained as f32,
            tag: place,
            image: None,
        });
    }

    fn reason(&mut self, reason: &str) -> u16 {
        let known = self.reasons.iter().position(|known| known == reason);
        let index = known.unwrap_or_else(|| {
            if self.reasons.len() < MAX_REASONS {
                self.reasons.push(reason.to_owned());
            }
            self.reasons.len() - 1
        });
        index as u16
    }

    /// Adds the marks and gaps of a report.
    fn add_events(&mut self, message: &LogMessage) {
        let Ok(report) = DiagnosticArray::decode(&message.data) else { return };
        for status in &report.status {
            let events = match status.name.strip_prefix(DIAGNOSTICS_PREFIX) {
                Some("mark") => &mut self.marks,
                Some("gap") => &mut self.gaps,
                _ => continue,
            };
            if events.len() < MAX_EVENTS {
                events.push(Event { log_time_ns: message.log_time_ns, what: words(status) });
            }
        }
    }

    /// Returns all tags as JSON, column by column, with times in seconds since the first.
    pub(super) fn columns(&self) -> Value {
        let first_ns = self.frames.first().map_or(0, |frame| frame.stamp_ns);
        let seconds = |ns: i64| round(ns.saturating_sub(first_ns) as f64 * 1e-9, 1e3);
        let column = |of: &dyn Fn(&FrameEntry) -> Value| self.frames.iter().map(of).collect::<Vec<Value>>();
        let number = |value: f32, steps: f64| json!(round(f64::from(value), steps));
        let events = |events: &[Event]| {
            let event = |event: &Event| json!({ "t_s": seconds(event.log_time_ns), "what": event.what });
            events.iter().map(event).collect::<Vec<Value>>()
        };
        json!({
            "name": self.name,
            "robot": self.info.robot,
            "started": self.info.started,
            "field": self.field.dimensions(),
            "lens": self.lens.parameters(),
            "first_ns": first_ns.to_string(),
            "begins_s": self.frames.first().map_or(0.0, |frame| self.seconds_from_start(frame)),
            "reasons": self.reasons,
            "t_s": column(&|frame| json!(seconds(frame.stamp_ns))),
            "valid": column(&|frame| json!(u8::from(frame.valid))),
            "ambiguous": column(&|frame| json!(u8::from(frame.ambiguous))),
            "reason": column(&|frame| json!(frame.reason)),
            "x": column(&|frame| number(frame.place[0], 1e3)),
            "y": column(&|frame| number(frame.place[1], 1e3)),
            "yaw_deg": column(&|frame| number(frame.place[2], 1e1)),
            "sigma_m": column(&|frame| number(frame.sigma_m, 1e4)),
            "fitting": column(&|frame| number(frame.fitting, 1e3)),
            "rms_px": column(&|frame| number(frame.rms_px, 1e2)),
            "explained": column(&|frame| number(frame.explained, 1e3)),
            "image": column(&|frame| json!(u8::from(frame.image.is_some()))),
            "marks": events(&self.marks),
            "gaps": events(&self.gaps),
            "bad": self.bad_parts(first_ns),
            "lost": self.lost,
            "left_out": self.left_out,
        })
    }

    /// Seconds from the first message of the capture to the tag of a frame, as `realitysim log cut` counts them.
    pub(super) fn seconds_from_start(&self, frame: &FrameEntry) -> f64 {
        round(frame.log_time_ns.saturating_sub(self.start_ns) as f64 * 1e-9, 1e3)
    }

    /// Returns the minutes in which too few tags are valid.
    fn bad_parts(&self, first_ns: i64) -> Vec<Value> {
        let mut parts: BTreeMap<i64, [u32; 2]> = BTreeMap::new();
        for frame in &self.frames {
            let part = (frame.stamp_ns.saturating_sub(first_ns) as f64 * 1e-9 / PART_S) as i64;
            let [valid, all] = parts.entry(part).or_default();
            *valid += u32::from(frame.valid);
            *all += 1;
        }
        let share = |[valid, all]: [u32; 2]| f64::from(valid) / f64::from(all);
        let bad = parts.into_iter().filter(|(_, counts)| share(*counts) < GOOD_SHARE);
        bad.map(|(part, counts)| {
            let from_s = part as f64 * PART_S;
            json!({ "from_s": from_s, "to_s": from_s + PART_S, "valid_share": round(share(counts), 1e3) })
        })
        .collect()
    }
}

/// Rounds to a number of steps in one. A number that is not finite becomes 0, since JSON has none.
fn round(value: f64, steps: f64) -> f64 {
    if value.is_finite() { libm::round(value * steps) / steps } else { 0.0 }
}

/// What a status says, with the event that it reports.
fn words(status: &DiagnosticStatus) -> String {
    let event = status.values.iter().find(|pair| pair.key == "event").map(|pair| pair.value.as_str());
    match event {
        Some(event) if event != "mark" => format!("{event}: {}", status.message),
        _ => status.message.clone(),
    }
}

/// A message without the folder of this machine.
fn without_folder(message: &str, session: &Session) -> String {
    message.replace(&session.folder.display().to_string(), &last_part(&session.folder))
}
