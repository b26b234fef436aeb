//! Frames of a log or scene, decoded and held in memory, so that settings can be tried on the same frames repeatedly.

mod collector;

use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Instant;

use super::budget::{Budget, Decisions};
use super::error::ReplayError;
use super::open_input::{self, OpenLog};
use super::perception_pool::{PerceptionError, decode_picture};
use super::replay::Progress;
use super::setup::{FramePerception, SetupError};
use super::tagger::Tagger;
use collector::FrameCollector;
use realitysim_config::Settings;
use realitysim_geometry::{Field, Isometry, Lens, Pose2};
use realitysim_localization::LocalizerState;
use realitysim_localization::refinement::Refiner;
use realitysim_localization::refinement::line_measurement::Response;
use realitysim_log_input::synchroniser::{Frame, InitialPose, RobotState};
use realitysim_log_input::{InputSource, scene_source};
use realitysim_recording::Loss;
use realitysim_ros2::messages::FrameTag;
use realitysim_scene::Scene;
use realitysim_vision::{Observations, Picture};

/// Which frames to hold.
#[derive(Clone, Debug)]
pub struct FrameCacheOptions {
    /// An MCAP file, a folder of them, or a scene file (`.toml`).
    pub source: PathBuf,
    /// Settings of the source; frames before the window are tracked with them.
    pub settings: Settings,
    /// Pose of `base_footprint` in `map` to start at, in place of what the log announces.
    pub initial: Option<Pose2>,
    /// Start of the window, seconds after the log's first frame.
    pub from_s: f64,
    /// Length of the window, seconds; `None` is as long as memory allows.
    pub for_s: Option<f64>,
}

/// Consecutive frames in memory, with the pose known before the first of them.
pub struct FrameCache {
    settings: Settings,
    lens: Lens,
    field: Field,
    start: Start,
    frames: Vec<CachedFrame>,
    /// Whether each frame starts at a pose of its own and nothing is carried over from the others.
    apart: bool,
    /// Whether later frames of the window had to be left out.
    full: bool,
    losses: Vec<Loss>,
}

/// What is known of the robot's pose before the first frame.
#[derive(Clone, Default)]
struct Start {
    state: LocalizerState,
    initial: Option<Pose2>,
}

/// One frame with its decoded picture.
struct CachedFrame {
    stamp_ns: i64,
    robot: RobotState,
    picture: Result<Picture, PerceptionError>,
}

/// Function from a frame's index and picture to the picture that is used in its place.
pub type Redrawing<'a> = dyn Fn(usize, &Picture) -> Picture + Sync + 'a;

/// Assumptions that replace what the source of the frames says. The default replaces nothing.
#[derive(Clone, Copy, Default)]
pub struct Claims<'a> {
    /// Another field.
    pub field: Option<&'a Field>,
    /// Another lens, for pictures of the same size.
    pub lens: Option<&'a Lens>,
    /// How much higher the camera is taken to be than the source says, metres.
    pub higher_m: f64,
    /// Whether the pose at the start is taken to be unknown.
    pub start_is_unknown: bool,
    /// Makes the pictures that are used in place of the recorded ones.
    pub picture: Option<&'a Redrawing<'a>>,
}

/// The result of one frame with some settings.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The tag, with the time from the decoded image to the tag as a replay states it.
    pub tag: FrameTag,
    /// Whether the image could be used. Otherwise the time means nothing.
    pub seen: bool,
}

impl FrameCache {
    /// Loads frames from a log or a scene.
    ///
    /// Fails as a replay does, and if there is no frame in the window.
    pub fn load(options: &FrameCacheOptions, progress: Progress) -> Result<Self, ReplayError> {
        if InputSource::is_scene(&options.source) {
            Self::of_scene(&scene_source::load(&options.source)?, options, progress)
        } else {
            Self::of_log(options, progress)
        }
    }

    /// Loads frames from a scene. `options.source` is only its name for error texts.
    pub fn of_scene(scene: &Scene, options: &FrameCacheOptions, progress: Progress) -> Result<Self, ReplayError> {
        let (setup, messages) = open_input::scene(scene, &options.source, &options.settings)?;
        let mut keeper = FrameCollector::new(options, setup, None);
        keeper.take_all(messages, &mut |done| progress(done, Some(scene.frame_count())))?;
        keeper.finish(&options.source)
    }

    fn of_log(options: &FrameCacheOptions, progress: Progress) -> Result<Self, ReplayError> {
        let OpenLog { setup, mut messages, checkpoint, frames, lost, .. } =
            open_input::log(&options.source, &options.settings)?;
        let mut keeper = FrameCollector::new(options, setup, checkpoint);
        let read = messages.by_ref().map(|message| message.map_err(ReplayError::from));
        keeper.take_all(read, &mut |done| progress(done, Some(frames)))?;
        let mut cache = keeper.finish(&options.source)?;
        lost.into_iter().for_each(|loss| loss.join(&mut cache.losses));
        for (file, damage) in messages.damage() {
            Loss::of_damage(file, damage).join(&mut cache.losses);
        }
        Ok(cache)
    }

    /// The same frames, each on its own: tracking starts over at each frame, at the pose given for it.
    pub fn apart(mut self, starts: &[InitialPose]) -> Self {
        for (frame, start) in self.frames.iter_mut().zip(starts) {
            (frame.robot.initial_pose, frame.robot.anchor) = (Some(*start), None);
        }
        self.start = Start::default();
        self.apart = true;
        self
    }

    /// The settings of the source, in which a scene has set its own field.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The field of the source.
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// The lens of the source.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// Stamps of the frames, nanoseconds.
    pub fn stamps_ns(&self) -> impl Iterator<Item = i64> + '_ {
        self.frames.iter().map(|frame| frame.stamp_ns)
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Whether frames of the window were left out because of the limits on memory.
    pub fn is_cut(&self) -> bool {
        self.full
    }

    /// Parts of the source that could not be used.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// How strongly lines and the carpet beside them stand out in the images, measured from the true poses.
    ///
    /// `truth` holds stamps in nanoseconds, in order, and poses of `camera_link` in `map`. Frames without a true pose are
    /// left out.
    pub fn responses(&self, truth: &[(i64, Isometry)]) -> Result<Vec<Response>, SetupError> {
        let perception = FramePerception::new(&self.settings, &self.lens, self.field.line_width())?;
        let refiner = Refiner::new(&self.field, &self.lens);
        let mut seen = Observations::default();
        let mut responses = Vec::new();
        for CachedFrame { robot, picture, stamp_ns } in &self.frames {
            let (Ok(picture), Ok(place)) = (picture, &robot.place) else { continue };
            let Ok(at) = truth.binary_search_by_key(stamp_ns, |(stamp, _)| *stamp) else { continue };
            perception.vision.look_again(
                picture,
                &place.footprint_from_optical,
                perception.body(robot.head),
                &mut seen,
            );
            responses.extend(refiner.responses(&seen.image, &(truth[at].1 * Isometry::link_from_optical())));
        }
        Ok(responses)
    }

    /// Contrast of the best lines in view and noise of plain carpet for each frame that shows lines, as shares of the
    /// carpet's brightness.
    pub fn contrasts(&self) -> Result<Vec<[f64; 2]>, SetupError> {
        let perception = FramePerception::new(&self.settings, &self.lens, self.field.line_width())?;
        let mut seen = Observations::default();
        let mut contrasts = Vec::new();
        for CachedFrame { robot, picture, .. } in &self.frames {
            let (Ok(picture), Ok(place)) = (picture, &robot.place) else { continue };
            perception.vision.look_again(
                picture,
                &place.footprint_from_optical,
                perception.body(robot.head),
                &mut seen,
            );
            let found = [seen.image.full_contrast(), seen.image.noise()].map(f64::from);
            contrasts.extend(found.iter().all(|value| value.is_finite()).then_some(found));
        }
        Ok(contrasts)
    }

    /// Tags every frame with these settings, in one thread.
    pub fn try_out(&self, settings: &Settings, progress: &mut dyn FnMut(usize)) -> Result<Vec<Trial>, SetupError> {
        self.try_out_claiming(settings, &Claims::default(), progress)
    }

    /// Like [`Self::try_out`], under other assumptions than those of the source.
    pub fn try_out_claiming(
        &self,
        settings: &Settings,
        claims: &Claims,
        progress: &mut dyn FnMut(usize),
    ) -> Result<Vec<Trial>, SetupError> {
        let (field, lens) = (claims.field.unwrap_or(&self.field), claims.lens.unwrap_or(&self.lens));
        let perception = FramePerception::new(settings, lens, field.line_width())?;
        let start = if claims.start_is_unknown { Start::default() } else { self.start.clone() };
        let mut tracking = start.tagger(settings, field, lens);
        let mut seen = Observations::default();
        let mut budget = Budget::new(settings.filter.budget_ms, Decisions::new());
        let mut attempts = Vec::with_capacity(self.frames.len());
        for (index, frame) in self.frames.iter().enumerate() {
            if self.apart {
                let mut own = settings.clone();
                own.filter.seed = settings.filter.seed.wrapping_add(index as u64);
                tracking = start.tagger(&own, field, lens);
            }
            attempts.push(frame.tag(index, claims, &perception, &mut tracking, &mut budget, &mut seen));
            progress(index + 1);
        }
        Ok(attempts)
    }
}

impl Start {
    fn tagger(&self, settings: &Settings, field: &Field, lens: &Lens) -> Tagger {
        let mut tagger = Tagger::new(settings, field.clone(), lens, self.state.clone());
        if let Some(map_from_footprint) = self.initial {
            tagger.start_at(&InitialPose { map_from_footprint, xy_m: None, yaw_rad: None });
        }
        tagger
    }
}

impl CachedFrame {
    fn new(frame: Frame, lens: &Lens) -> Self {
        let picture = if frame.robot.place.is_ok() {
            decode_picture(&frame.message, lens)
        } else {
            Err(PerceptionError::NoPlace)
        };
        Self { stamp_ns: frame.stamp_ns, robot: frame.robot, picture }
    }

    /// The robot's state with the assumptions applied.
    fn robot_as_claimed(&self, claims: &Claims) -> Cow<'_, RobotState> {
        if claims.higher_m == 0.0 && !claims.start_is_unknown {
            return Cow::Borrowed(&self.robot);
        }
        let mut robot = self.robot.clone();
        if let Ok(place) = &mut robot.place {
            for pose in [&mut place.footprint_from_link, &mut place.footprint_from_optical] {
                pose.translation.z += claims.higher_m;
            }
        }
        if claims.start_is_unknown {
            (robot.initial_pose, robot.anchor) = (None, None);
        }
        Cow::Owned(robot)
    }

    /// Bytes of the decoded picture.
    fn bytes(&self) -> usize {
        let of = |picture: &Picture| picture.luma.len() + picture.chroma.blue.len() + picture.chroma.red.len();
        self.picture.as_ref().map_or(0, of)
    }

    /// Looks at the frame and tags it. `seen` is a buffer.
    fn tag(
        &self,
        index: usize,
        claims: &Claims,
        perception: &FramePerception,
        tagger: &mut Tagger,
        budget: &mut Budget,
        seen: &mut Observations,
    ) -> Trial {
        let stamp_ns = &self.stamp_ns;
        let robot = &*self.robot_as_claimed(claims);
        let picture = match (&self.picture, claims.picture) {
            (Ok(picture), Some(change)) => Ok(Cow::Owned(change(index, picture))),
            (picture, _) => picture.as_ref().map(Cow::Borrowed),
        };
        let start = Instant::now();
        let (mut tag, is_seen) = match (&picture, &robot.place) {
            (Ok(picture), Ok(place)) => {
                perception.vision.look_again(picture, &place.footprint_from_optical, perception.body(robot.head), seen);
                let looked_ms = start.elapsed().as_secs_f64() * 1e3;
                let mut allowance = budget.frame(*stamp_ns, looked_ms);
                let tag = tagger.tag(*stamp_ns, robot, seen, &mut |weighed| allowance.has_time(weighed));
                budget.learn(&allowance);
                (tag, true)
            }
            (Err(unseen), _) => (tagger.tag_blind(*stamp_ns, robot, unseen.rejection()), false),
            (_, Err(_)) => (tagger.tag_blind(*stamp_ns, robot, PerceptionError::NoPlace.rejection()), false),
        };
        tag.elapsed_ms = start.elapsed().as_secs_f64() * 1e3;
        Trial { tag, seen: is_seen }
    }
}
