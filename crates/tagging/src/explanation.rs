//! Explains the tag of one frame of a log or scene: what was seen, and the evidence for and against the pose.
//!
//! The frames before it are tagged as a replay without a time budget tags them, but without the poses that a replay predicts
//! in long gaps between frames.

use std::path::PathBuf;

use super::checkpoint::Checkpoint;
use super::error::ReplayError;
use super::open_input::{self, OpenLog};
use super::perception_pool::decode_picture;
use super::replay::Progress;
use super::setup::Setup;
use super::tagger::Tagger;
use realitysim_config::Settings;
use realitysim_geometry::{Field, Isometry, Lens, Pose2};
use realitysim_localization::filter::always;
use realitysim_localization::{Evidence, LocalizerState, Rejection};
use realitysim_log_input::synchroniser::{Frame, InitialPose, Synchroniser};
use realitysim_log_input::{InputSource, measurement, scene_source};
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::FrameTag;
use realitysim_vision::{Observations, Picture};

/// The frame to explain.
#[derive(Clone, Debug)]
pub struct ExplainOptions {
    /// An MCAP file, a folder of them, or a scene file (`.toml`).
    pub source: PathBuf,
    /// Settings of the agent.
    pub settings: Settings,
    /// Pose of `base_footprint` in `map` to start at, in place of what the log announces.
    pub initial: Option<Pose2>,
    /// Number of the frame, counted from 0. The frames before it are tagged first.
    pub frame: u64,
}

/// The tag of one frame, and what it follows from.
pub struct Explanation {
    /// The tag.
    pub tag: FrameTag,
    /// The lens.
    pub lens: Lens,
    /// The field.
    pub field: Field,
    /// The tag's pose of `camera_link` in `map`.
    pub map_from_camera: Isometry,
    /// Picture and evidence; `None` if the image could not be used.
    pub sight: Option<Sight>,
}

/// A frame's picture, and the evidence found in it.
pub struct Sight {
    /// The picture.
    pub picture: Picture,
    /// The evidence for and against the tag.
    pub evidence: Evidence,
}

/// Explains the tag of one frame. Errors are those of a replay, or that there is no such frame.
pub fn explain(options: &ExplainOptions, progress: Progress) -> Result<Explanation, ReplayError> {
    if InputSource::is_scene(&options.source) {
        let scene = scene_source::load(&options.source)?;
        let (setup, messages) = open_input::scene(&scene, &options.source, &options.settings)?;
        return ReplayToFrame::new(options, setup, None).through(messages, progress);
    }
    let OpenLog { setup, mut messages, checkpoint, .. } = open_input::log(&options.source, &options.settings)?;
    ReplayToFrame::new(options, setup, checkpoint)
        .through(messages.by_ref().map(|message| message.map_err(ReplayError::from)), progress)
}

/// A replay up to the frame.
struct ReplayToFrame<'a> {
    options: &'a ExplainOptions,
    setup: Setup,
    synchroniser: Synchroniser,
    tagger: Tagger,
    seen: Observations,
    frames: u64,
}

impl<'a> ReplayToFrame<'a> {
    /// Starts from the checkpoint of a capture's segment if there is one.
    fn new(options: &'a ExplainOptions, setup: Setup, checkpoint: Option<Checkpoint>) -> Self {
        let (state, known) = match checkpoint {
            Some(checkpoint) => (checkpoint.tagger, checkpoint.synchroniser),
            None => (LocalizerState::default(), setup.synchroniser.clone()),
        };
        let mut synchroniser = Synchroniser::new(setup.settings.frames.clone(), known);
        synchroniser.expect(setup.expected);
        let mut tagger = Tagger::new(&setup.settings, setup.field.clone(), setup.eyes.vision.lens(), state);
        if let Some(map_from_footprint) = options.initial {
            tagger.start_at(&InitialPose { map_from_footprint, xy_m: None, yaw_rad: None });
        }
        Self { options, setup, synchroniser, tagger, seen: Observations::default(), frames: 0 }
    }

    fn through(
        mut self,
        messages: impl Iterator<Item = Result<LogMessage, ReplayError>>,
        progress: Progress,
    ) -> Result<Explanation, ReplayError> {
        for message in messages {
            let message = message?;
            if message.channel.topic == self.setup.topics.ground_truth {
                continue;
            }
            match measurement::read(&message, &self.setup.topics, &self.setup.settings.head) {
                Ok(measurement::Measurement::InitialPose { .. }) if self.options.initial.is_some() => {}
                Ok(input) => self.synchroniser.push(&message, input),
                // A replay reports messages that cannot be read.
                Err(_) => {}
            }
            if let Some(explanation) = self.process_ready_frames(progress) {
                return Ok(explanation);
            }
        }
        self.synchroniser.finish();
        let source = self.options.source.display();
        self.process_ready_frames(progress).ok_or_else(|| {
            let told = format!(
                "{source}: there is no frame {}; they are 0 to {}",
                self.options.frame,
                self.frames.saturating_sub(1)
            );
            ReplayError::NoFrame(if self.frames == 0 { format!("{source}: there is none") } else { told })
        })
    }

    /// Tags the frames whose measurements are complete; returns the explanation once the wanted frame is reached.
    fn process_ready_frames(&mut self, progress: Progress) -> Option<Explanation> {
        while let Some(frame) = self.synchroniser.pop() {
            let is_asked_for = self.frames == self.options.frame;
            self.frames += 1;
            progress(self.frames, Some(self.options.frame + 1));
            if is_asked_for {
                return Some(self.explain(&frame));
            }
            self.track(&frame);
        }
        None
    }

    /// Tags a frame before the wanted one.
    fn track(&mut self, frame: &Frame) {
        match self.look(frame) {
            Ok(_) => self.tagger.tag(frame.stamp_ns, &frame.robot, &self.seen, &mut always),
            Err(reason) => self.tagger.tag_blind(frame.stamp_ns, &frame.robot, reason),
        };
    }

    /// Looks at a frame's image; what it shows goes into `seen`.
    fn look(&mut self, frame: &Frame) -> Result<Picture, Rejection> {
        let Ok(place) = &frame.robot.place else { return Err(Rejection::NoTransform) };
        let vision = &self.setup.eyes.vision;
        let picture = decode_picture(&frame.message, vision.lens()).map_err(|unseen| unseen.rejection())?;
        let body = self.setup.eyes.body(frame.robot.head);
        vision.look_again(&picture, &place.footprint_from_optical, body, &mut self.seen);
        Ok(picture)
    }

    fn explain(&mut self, frame: &Frame) -> Explanation {
        let (mut tag, sight) = match self.look(frame) {
            Ok(picture) => {
                let (tag, evidence) = self.tagger.explain(frame.stamp_ns, &frame.robot, &self.seen);
                (tag, Some(Sight { picture, evidence }))
            }
            Err(reason) => (self.tagger.tag_blind(frame.stamp_ns, &frame.robot, reason), None),
        };
        tag.sequence = self.options.frame;
        Explanation {
            map_from_camera: Isometry::from(tag.pose.pose),
            tag,
            lens: self.setup.eyes.vision.lens().clone(),
            field: self.setup.field.clone(),
            sight,
        }
    }
}
