//! One frame of a log or scene: what was seen in it, and what speaks for and against its tag.
//!
//! The frames before it are tagged as a replay without a time budget tags them; poses that a replay predicts where no frame comes for
//! long are left out.

use std::path::PathBuf;

use super::checkpoint::Checkpoint;
use super::error::ReplayError;
use super::input_source::{self, OpenLog};
use super::perception_pool::view;
use super::replay::Progress;
use super::setup::Setup;
use super::tagger::Tagger;
use realitysim_config::Settings;
use realitysim_geometry::{Field, Isometry, Lens, Pose2};
use realitysim_localization::filter::always;
use realitysim_localization::{Evidence, LocalizerState, Rejection};
use realitysim_log_input::synchroniser::{Frame, InitialPose, Synchroniser};
use realitysim_log_input::{measurement, scene_source};
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_ros2::messages::FrameTag;
use realitysim_vision::{Observations, Picture};

#[derive(Clone, Debug)]
pub struct ExplainOptions {
    /// An MCAP file, a folder of them, or a scene file (`.toml`).
    pub source: PathBuf,
    pub settings: Settings,
    /// In place of what the log announces.
    pub initial: Option<Pose2>,
    /// Counted from 0; all before it are tagged as a replay tags them.
    pub frame: u64,
}

/// The tag of one frame, and what it follows from.
pub struct Explanation {
    pub tag: FrameTag,
    pub lens: Lens,
    pub field: Field,
    /// Of `camera_link`, in the tag.
    pub map_from_camera: Isometry,
    /// Where something could be seen.
    pub sight: Option<Sight>,
}

/// The frame's picture, and what was made of it.
pub struct Sight {
    pub picture: Picture,
    pub evidence: Evidence,
}

/// Errors are those of a replay, or that there is no such frame.
pub fn explain(options: &ExplainOptions, progress: Progress) -> Result<Explanation, ReplayError> {
    if options.source.extension().is_some_and(|ending| ending == "toml") {
        let scene = scene_source::load(&options.source)?;
        let (setup, messages) = input_source::scene(&scene, &options.source, &options.settings)?;
        return Walk::new(options, setup, None).through(messages, progress);
    }
    let OpenLog { setup, mut messages, checkpoint, .. } = input_source::log(&options.source, &options.settings)?;
    Walk::new(options, setup, checkpoint)
        .through(messages.by_ref().map(|message| message.map_err(ReplayError::from)), progress)
}

/// The way to the frame.
struct Walk<'a> {
    options: &'a ExplainOptions,
    setup: Setup,
    synchroniser: Synchroniser,
    tagger: Tagger,
    seen: Observations,
    frames: u64,
}

impl<'a> Walk<'a> {
    /// From where a capture's segment begins, if there is a checkpoint.
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
                // What cannot be read is told by a replay.
                Err(_) => {}
            }
            if let Some(explanation) = self.go_on(progress) {
                return Ok(explanation);
            }
        }
        self.synchroniser.finish();
        let source = self.options.source.display();
        self.go_on(progress).ok_or_else(|| {
            let told = format!(
                "{source}: there is no frame {}; they are 0 to {}",
                self.options.frame,
                self.frames.saturating_sub(1)
            );
            ReplayError::NoFrame(if self.frames == 0 { format!("{source}: there is none") } else { told })
        })
    }

    fn go_on(&mut self, progress: Progress) -> Option<Explanation> {
        while let Some(frame) = self.synchroniser.pop() {
            let is_asked_for = self.frames == self.options.frame;
            self.frames += 1;
            progress(self.frames, Some(self.options.frame + 1));
            if is_asked_for {
                return Some(self.explained(&frame));
            }
            self.pass(&frame);
        }
        None
    }

    fn pass(&mut self, frame: &Frame) {
        match self.look(frame) {
            Ok(_) => self.tagger.tag(frame.stamp_ns, &frame.robot, &self.seen, &mut always),
            Err(reason) => self.tagger.tag_blind(frame.stamp_ns, &frame.robot, reason),
        };
    }

    fn look(&mut self, frame: &Frame) -> Result<Picture, Rejection> {
        let Ok(place) = &frame.robot.place else { return Err(Rejection::NoTransform) };
        let vision = &self.setup.eyes.vision;
        let picture = view(&frame.message, vision.lens()).map_err(|unseen| unseen.rejection())?;
        let body = self.setup.eyes.body(frame.robot.head);
        vision.look_again(&picture, &place.footprint_from_optical, body, &mut self.seen);
        Ok(picture)
    }

    fn explained(&mut self, frame: &Frame) -> Explanation {
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
