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
use realitysim_log_input::synchroniser::{Frame, InitialPose};
use realitysim_log_input::{FrameAssembler, InputSource, scene_source};
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
    assembler: FrameAssembler,
    tagger: Tagger,
    seen: Observations,
}

impl<'a> ReplayToFrame<'a> {
    /// Starts from the checkpoint of a capture's segment if there is one.
    fn new(options: &'a ExplainOptions, setup: Setup, checkpoint: Option<Checkpoint>) -> Self {
        let (state, known) = checkpoint.map_or_else(
            || (LocalizerState::default(), None),
            |checkpoint| (checkpoint.tagger, Some(checkpoint.synchroniser)),
        );
        let assembler = setup.assembler(known, options.initial.is_some());
        let mut tagger = Tagger::new(&setup.settings, setup.field.clone(), setup.perception.vision.lens(), state);
        if let Some(map_from_footprint) = options.initial {
            tagger.start_at(&InitialPose { map_from_footprint, xy_m: None, yaw_rad: None });
        }
        Self { options, setup, assembler, tagger, seen: Observations::default() }
    }

    fn through(
        self,
        messages: impl Iterator<Item = Result<LogMessage, ReplayError>>,
        progress: Progress,
    ) -> Result<Explanation, ReplayError> {
        let Self { options, setup, mut assembler, tagger, seen } = self;
        let mut tracking = Tracking { setup, tagger, seen };
        let mut frames = 0;
        for frame in assembler.frames_of(messages) {
            let frame = frame?;
            frames += 1;
            progress(frames, Some(options.frame + 1));
            if frames == options.frame + 1 {
                return Ok(tracking.explain(options.frame, &frame));
            }
            tracking.track(&frame);
        }
        let source = options.source.display();
        Err(ReplayError::NoFrame(match frames {
            0 => format!("{source}: there is none"),
            _ => format!("{source}: there is no frame {}; they are 0 to {}", options.frame, frames - 1),
        }))
    }
}

/// The filter on its way to the wanted frame.
struct Tracking {
    setup: Setup,
    tagger: Tagger,
    seen: Observations,
}

impl Tracking {
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
        let vision = &self.setup.perception.vision;
        let picture = decode_picture(&frame.message, vision.lens()).map_err(|unseen| unseen.rejection())?;
        let body = self.setup.perception.body(frame.robot.head);
        vision.look_again(&picture, &place.footprint_from_optical, body, &mut self.seen);
        Ok(picture)
    }

    /// Tags the wanted frame and keeps what led to the tag. `number` counts frames from 0.
    fn explain(&mut self, number: u64, frame: &Frame) -> Explanation {
        let (mut tag, sight) = match self.look(frame) {
            Ok(picture) => {
                let (tag, evidence) = self.tagger.explain(frame.stamp_ns, &frame.robot, &self.seen);
                (tag, Some(Sight { picture, evidence }))
            }
            Err(reason) => (self.tagger.tag_blind(frame.stamp_ns, &frame.robot, reason), None),
        };
        tag.sequence = number;
        Explanation {
            map_from_camera: Isometry::from(tag.pose.pose),
            tag,
            lens: self.setup.perception.vision.lens().clone(),
            field: self.setup.field.clone(),
            sight,
        }
    }
}
