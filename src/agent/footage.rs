//! Frames of a log or scene, decoded and held in memory, so that settings can be tried on the same frames again and again.

use std::path::{Path, PathBuf};
use std::time::Instant;

use super::checkpoint::Checkpoint;
use super::prelude::Prelude;
use super::replay::{Progress, ReplayError, scene_beginning, scene_settings, segment_checkpoint, setup_error};
use super::setup::{Eyes, Setup, SetupError};
use super::stages::{NotSeen, view};
use super::tagger::Tagger;
use crate::config::Settings;
use crate::geometry::{Field, Lens, Pose2};
use crate::localization::LocalizerState;
use crate::recording::{Loss, missing_parts};
use crate::ros2::mcap_read::{LogMessage, Selection};
use crate::ros2::messages::FrameTag;
use crate::scene::Scene;
use crate::sensors::intake;
use crate::sensors::log::{self, LogError, LogSource};
use crate::sensors::scene::{self, SceneSource};
use crate::sensors::synchroniser::{Frame, InitialPose, RobotAt, Synchroniser};
use crate::vision::{Picture, Seen};

/// A filter follows from frame to frame, so that frames in a row are needed, and that many are enough to compare settings.
const MAX_FRAMES: usize = 300;
const MAX_FOOTAGE_BYTES: usize = 1 << 30;

#[derive(Clone, Debug)]
pub struct FootageOptions {
    /// An MCAP file, a folder of them, or a scene file (`.toml`).
    pub source: PathBuf,
    /// Also those with which the way to the first kept frame is tracked.
    pub settings: Settings,
    /// In place of what the log announces.
    pub initial: Option<Pose2>,
    /// Seconds after the log's first frame.
    pub from_s: f64,
    /// As long as memory allows, if nothing is said.
    pub for_s: Option<f64>,
}

pub struct Footage {
    settings: Settings,
    lens: Lens,
    field: Field,
    start: Start,
    shots: Vec<Shot>,
    /// Each shot starts at a pose of its own and knows nothing of the others.
    apart: bool,
    /// Frames had to be left out behind the last one.
    full: bool,
    losses: Vec<Loss>,
}

/// What is known of the robot's place before the first frame.
#[derive(Clone, Default)]
struct Start {
    state: LocalizerState,
    initial: Option<Pose2>,
}

/// One frame, ready to be looked at.
struct Shot {
    stamp_ns: i64,
    robot: RobotAt,
    picture: Result<Picture, NotSeen>,
}

/// What settings made of one frame.
#[derive(Clone, Debug)]
pub struct Attempt {
    /// With the time from the decoded image to the tag, as a replay states it.
    pub tag: FrameTag,
    /// There was something to look at: the time means something.
    pub seen: bool,
}

impl Footage {
    pub fn load(options: &FootageOptions, progress: Progress) -> Result<Self, ReplayError> {
        if options.source.extension().is_some_and(|ending| ending == "toml") {
            Self::of_scene(&scene::load(&options.source.to_string_lossy())?, options, progress)
        } else {
            Self::of_log(options, progress)
        }
    }

    /// `options.source` is only the scene's name.
    pub fn of_scene(scene: &Scene, options: &FootageOptions, progress: Progress) -> Result<Self, ReplayError> {
        let settings = scene_settings(scene, &options.settings);
        let mut source = SceneSource::new(scene);
        let (first, types) = scene_beginning(&mut source)?;
        let known = first.clone();
        let prelude =
            Prelude::read(&settings, &types, move |_| Box::new(known.clone().into_iter().map(Ok::<_, LogError>)))
                .map_err(|error| setup_error(&options.source, error))?;
        let messages = first.into_iter().map(Ok).chain(source.map(|message| message.map_err(ReplayError::from)));
        let mut keeper = Keeper::new(options, settings, prelude, None)?;
        keeper.take_all(messages, &mut |done| progress(done, Some(scene.frame_count())))?;
        keeper.finish(&options.source)
    }

    fn of_log(options: &FootageOptions, progress: Progress) -> Result<Self, ReplayError> {
        let files = log::files_of(&options.source)?;
        let surveys = log::surveys(&files)?;
        let types = log::topic_types(&surveys);
        let all = files.clone();
        let prelude =
            Prelude::read(&options.settings, &types, move |selection| Box::new(LogSource::new(all.clone(), selection)))
                .map_err(|error| setup_error(&options.source, error))?;
        let images = surveys.iter().flat_map(|survey| &survey.topics).filter(|t| t.topic == prelude.topics.image);
        let total = images.map(|topic| topic.messages).sum();
        let checkpoint = segment_checkpoint(&files, &surveys)?;
        let mut keeper = Keeper::new(options, options.settings.clone(), prelude, checkpoint)?;
        let mut source = LogSource::new(files, Selection::All);
        let messages = source.by_ref().map(|message| message.map_err(ReplayError::from));
        keeper.take_all(messages, &mut |done| progress(done, Some(total)))?;
        let mut footage = keeper.finish(&options.source)?;
        missing_parts(&options.source).into_iter().for_each(|loss| loss.join(&mut footage.losses));
        for (file, damage) in source.damage() {
            Loss::of_damage(file, damage).join(&mut footage.losses);
        }
        Ok(footage)
    }

    /// The same frames, each on its own: tracking starts anew at each, at the pose given for it.
    pub fn apart(mut self, starts: &[InitialPose]) -> Self {
        for (shot, start) in self.shots.iter_mut().zip(starts) {
            shot.robot.initial_pose = Some(*start);
        }
        self.start = Start::default();
        self.apart = true;
        self
    }

    /// As the source wants them: a scene names its own field.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    pub fn field(&self) -> &Field {
        &self.field
    }

    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    pub fn stamps_ns(&self) -> impl Iterator<Item = i64> + '_ {
        self.shots.iter().map(|shot| shot.stamp_ns)
    }

    pub fn frames(&self) -> usize {
        self.shots.len()
    }

    /// Memory ended before the frames did.
    pub fn is_cut(&self) -> bool {
        self.full
    }

    /// What of the source could not be used.
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// Tags every frame with these settings, in one thread.
    pub fn try_out(&self, settings: &Settings, progress: &mut dyn FnMut(usize)) -> Result<Vec<Attempt>, SetupError> {
        let eyes = Eyes::new(settings, &self.lens, self.field.line_width())?;
        let mut tracking = self.start.tagger(settings, &self.field, &self.lens);
        let mut seen = Seen::default();
        let mut attempts = Vec::with_capacity(self.shots.len());
        for (index, shot) in self.shots.iter().enumerate() {
            if self.apart {
                let mut own = settings.clone();
                own.filter.seed = settings.filter.seed.wrapping_add(index as u64);
                tracking = self.start.tagger(&own, &self.field, &self.lens);
            }
            attempts.push(shot.tag(&eyes, &mut tracking, &mut seen));
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

impl Shot {
    fn new(frame: Frame, lens: &Lens) -> Self {
        let picture = if frame.robot.place.is_ok() { view(&frame.message, lens) } else { Err(NotSeen::NoPlace) };
        Self { stamp_ns: frame.stamp_ns, robot: frame.robot, picture }
    }

    fn bytes(&self) -> usize {
        let of = |picture: &Picture| picture.luma.len() + picture.chroma.blue.len() + picture.chroma.red.len();
        self.picture.as_ref().map_or(0, of)
    }

    /// `seen` is only room to work in.
    fn tag(&self, eyes: &Eyes, tagger: &mut Tagger, seen: &mut Seen) -> Attempt {
        let Self { stamp_ns, robot, picture } = self;
        let start = Instant::now();
        let (mut tag, is_seen) = match (picture, &robot.place) {
            (Ok(picture), Ok(place)) => {
                eyes.vision.look_again(picture, &place.footprint_from_optical, eyes.body(robot.head), seen);
                (tagger.tag(*stamp_ns, robot, seen), true)
            }
            (Err(unseen), _) => (tagger.tag_blind(*stamp_ns, robot, unseen.reason()), false),
            (_, Err(_)) => (tagger.tag_blind(*stamp_ns, robot, NotSeen::NoPlace.reason()), false),
        };
        tag.elapsed_ms = start.elapsed().as_secs_f64() * 1e3;
        Attempt { tag, seen: is_seen }
    }
}

/// Takes messages and keeps the frames of the window; those before it are tracked, so that the first kept one is not
/// met without a pose.
struct Keeper {
    setup: Setup,
    synchroniser: Synchroniser,
    start: Start,
    lead_in: Option<Tagger>,
    seen: Seen,
    from_ns: i64,
    for_ns: Option<i64>,
    first_ns: Option<i64>,
    last_ns: i64,
    shots: Vec<Shot>,
    bytes: usize,
    frames: u64,
    full: bool,
    past: bool,
    bad_messages: u64,
}

impl Keeper {
    fn new(
        options: &FootageOptions,
        settings: Settings,
        prelude: Prelude,
        checkpoint: Option<Checkpoint>,
    ) -> Result<Self, ReplayError> {
        let setup = Setup::new(settings, prelude).map_err(|error| setup_error(&options.source, error))?;
        let (state, known) = match checkpoint {
            Some(checkpoint) => (checkpoint.tagger, checkpoint.synchroniser),
            None => (LocalizerState::default(), setup.synchroniser.clone()),
        };
        let start = Start { state, initial: options.initial };
        let mut synchroniser = Synchroniser::new(setup.settings.frames.clone(), known);
        synchroniser.expect(setup.expected);
        let nanoseconds = |seconds: f64| (seconds * 1e9) as i64;
        Ok(Self {
            setup,
            synchroniser,
            start,
            lead_in: None,
            seen: Seen::default(),
            from_ns: nanoseconds(options.from_s),
            for_ns: options.for_s.map(nanoseconds),
            first_ns: None,
            last_ns: i64::MIN,
            shots: Vec::new(),
            bytes: 0,
            frames: 0,
            full: false,
            past: false,
            bad_messages: 0,
        })
    }

    fn take_all(
        &mut self,
        messages: impl Iterator<Item = Result<LogMessage, ReplayError>>,
        progress: &mut dyn FnMut(u64),
    ) -> Result<(), ReplayError> {
        for message in messages {
            let message = message?;
            if message.channel.topic == self.setup.topics.ground_truth {
                continue;
            }
            match intake::read(&message, &self.setup.topics, &self.setup.settings.head) {
                Ok(intake::Input::InitialPose { .. }) if self.start.initial.is_some() => {}
                Ok(input) => self.synchroniser.push(&message, input),
                Err(_) => self.bad_messages += 1,
            }
            self.take_known(progress);
            if self.past {
                return Ok(());
            }
        }
        self.synchroniser.finish();
        self.take_known(progress);
        Ok(())
    }

    fn take_known(&mut self, progress: &mut dyn FnMut(u64)) {
        while let Some(frame) = self.synchroniser.pop() {
            self.frames += 1;
            self.take(frame);
            progress(self.frames);
        }
    }

    fn take(&mut self, frame: Frame) {
        self.last_ns = frame.stamp_ns;
        let since_ns = frame.stamp_ns.saturating_sub(*self.first_ns.get_or_insert(frame.stamp_ns));
        if since_ns < self.from_ns {
            let Setup { settings, field, eyes, .. } = &self.setup;
            let lens = eyes.vision.lens();
            let tagger = self.lead_in.get_or_insert_with(|| self.start.tagger(settings, field, lens));
            Shot::new(frame, lens).tag(eyes, tagger, &mut self.seen);
            return;
        }
        self.past |= self.for_ns.is_some_and(|length_ns| since_ns - self.from_ns >= length_ns);
        if self.past {
            return;
        }
        if self.shots.len() >= MAX_FRAMES || self.bytes >= MAX_FOOTAGE_BYTES {
            (self.full, self.past) = (true, true);
            return;
        }
        let shot = Shot::new(frame, self.setup.eyes.vision.lens());
        self.bytes += shot.bytes();
        self.shots.push(shot);
    }

    fn losses(&self, source: &Path) -> Vec<Loss> {
        let mut losses = Vec::new();
        if self.bad_messages > 0 {
            let what = format!("{} messages are not what their type says", self.bad_messages);
            Loss::new(source, what).join(&mut losses);
        }
        let broken = || self.shots.iter().filter_map(|shot| shot.picture.as_ref().err());
        if let Some(NotSeen::Decode(error)) = broken().find(|unseen| matches!(unseen, NotSeen::Decode(_))) {
            Loss::new(source, format!("images do not decode, the first because {error}")).join(&mut losses);
        }
        losses
    }

    fn finish(self, source: &Path) -> Result<Footage, ReplayError> {
        if self.shots.is_empty() {
            let told = match self.first_ns {
                None => "there is none".to_owned(),
                Some(first_ns) => {
                    let length_s = self.last_ns.saturating_sub(first_ns) as f64 * 1e-9;
                    format!("the last one comes {length_s:.1} s after the first, which is before the window begins")
                }
            };
            return Err(ReplayError::NoFrame(format!("{}: {told}", source.display())));
        }
        let losses = self.losses(source);
        let start = match self.lead_in {
            Some(tagger) => Start { state: tagger.state(), initial: None },
            None => self.start,
        };
        let Setup { settings, field, eyes, .. } = self.setup;
        Ok(Footage {
            lens: eyes.vision.lens().clone(),
            settings,
            field,
            start,
            shots: self.shots,
            apart: false,
            full: self.full,
            losses,
        })
    }
}
