//! Made-up walks with known truth: a scene file becomes a trajectory, sensor messages and camera images.
//!
//! Pure: everything is a function of file, field and lens. [`Scene::truth`] is the robot's pose at any time,
//! [`Scene::events`] what its sensors send, [`Renderer`] what its camera sees.

mod check;
mod consistency;
pub mod effects;
mod error_spans;
mod events;
pub mod file;
mod key_lines;
mod motion;
mod per_frame;
mod ranges;
mod render;
mod stream;
mod truth;
mod view_overlay;

pub use check::SceneError;
pub use effects::{Effect, Joints, Role};
pub use events::{Events, Imu, InitialPoseEstimate, Odometry, SceneEvent, SceneEventKind};
pub use file::{InitialPose, Route, SceneFile};
pub use ranges::Drawn;
pub use render::{Figures, Renderer};
pub use truth::{Mount, Truth, Twist};
pub use view_overlay::{StageError, ViewOverlay};

use effects::{
    CalibrationError, CameraFault, Carrying, Crowd, ExposureHunting, ImageProcessing, Optics, SunPatches, SwayModel,
    Turf, WornLines,
};
use glam::DVec2;
use motion::Motion;
use per_frame::Changing;
use ranges::Per;
use realitysim_geometry::{Field, FieldDimensions, Lens, LensParameters};

/// The stamp of every scene's first event, in nanoseconds since 1970: a fixed day, so that recordings repeat.
pub const START_STAMP_NS: i64 = 1_760_000_000_000_000_000;

/// Fine enough for a walk among others.
const WAY_EVERY_S: f64 = 0.5;

/// A checked scene.
#[derive(Clone, Debug)]
pub struct Scene {
    file: SceneFile,
    field: Field,
    lens: Lens,
    announced_lens: LensParameters,
    motion: Motion,
    sway: Option<SwayModel>,
    carrying: Option<Carrying>,
    crowd: Option<Crowd>,
    turf: Option<Turf>,
    worn_lines: Option<WornLines>,
    sun_patches: Option<SunPatches>,
    optics: Option<Optics>,
    exposure_hunting: Option<ExposureHunting>,
    image_processing: Option<ImageProcessing>,
    calibration_error: Option<CalibrationError>,
    camera_fault: Option<CameraFault>,
    /// As it is in the first frame; [`Scene::at_frame`] for the others.
    changing: Changing,
}

impl Scene {
    /// `field` and `lens` are what the file's names `scene.field` and `camera.lens` stand for.
    pub fn build(file: SceneFile, field: FieldDimensions, lens: LensParameters) -> Result<Self, SceneError> {
        let places = file.places.clone();
        Self::checked(file, field, lens).map_err(|error| error.at(&places))
    }

    fn checked(file: SceneFile, field: FieldDimensions, lens: LensParameters) -> Result<Self, SceneError> {
        let field = Field::new(field)?;
        let lens = Lens::new(lens)?;
        // Before what was drawn: a message has the number that stands in the file.
        check::ranges(&file, |file| Self::assemble(file, field.clone(), lens.clone()).map(drop))?;
        consistency::do_something(&file.effects)?;
        let template = file.template.clone();
        Self::assemble(file, field, lens).map_err(|error| match &template {
            Some(template) => error.with(template, |range| template.value(range, 0)),
            None => error,
        })
    }

    fn assemble(file: SceneFile, field: Field, lens: Lens) -> Result<Self, SceneError> {
        check::check(&file, &field)?;
        let motion = Motion::new(&file.route);
        check::duration(motion.duration())?;
        let mut scene = Self {
            file,
            field,
            announced_lens: lens.parameters().clone(),
            lens,
            motion,
            sway: None,
            carrying: None,
            crowd: None,
            turf: None,
            worn_lines: None,
            sun_patches: None,
            optics: None,
            exposure_hunting: None,
            image_processing: None,
            calibration_error: None,
            camera_fault: None,
            changing: Changing::default(),
        };
        for (index, effect) in scene.file.effects.clone().iter().enumerate() {
            scene.add(&format!("effect[{index}]"), effect)?;
        }
        check::duration(scene.duration_s())?;
        consistency::times(&scene.file, scene.duration_s())?;
        Ok(scene)
    }

    /// The same walk with only the first effects of its file: what each of them does and costs by itself.
    pub fn with_first_effects(&self, count: usize) -> Result<Self, SceneError> {
        let mut file = self.file.clone();
        file.effects.truncate(count);
        Self::build(file, self.field.dimensions().clone(), self.lens.parameters().clone())
    }

    /// The same walk on lines of which `left`, 0 to 1, is there, in the patches of its worn lines; none if it has no worn lines.
    pub fn with_paint(&self, left: f64) -> Result<Option<Self>, SceneError> {
        let mut file = self.file.clone();
        let worn = |effect: &Effect| matches!(effect, Effect::WornLines(_));
        let Some(index) = file.effects.iter().position(worn) else { return Ok(None) };
        if left >= 1.0 {
            // An effect that does nothing is refused.
            file.effects.remove(index);
        } else if let Effect::WornLines(effect) = &mut file.effects[index] {
            effect.share = 1.0 - left;
        }
        Self::build(file, self.field.dimensions().clone(), self.lens.parameters().clone()).map(Some)
    }

    /// Effects come in physical order, so that each finds what it builds on.
    fn add(&mut self, key: &str, effect: &Effect) -> Result<(), SceneError> {
        let seed = self.file.scene.seed;
        match effect {
            Effect::GaitSway(effect) => self.sway = Some(effect.model(seed, self.motion.duration())),
            Effect::Kidnapping(effect) => self.carrying = Some(effect.model(key, &self.motion, &self.field)?),
            Effect::Fall(effect) => self.carrying = Some(effect.model(key, &self.motion, &self.field)?),
            Effect::CameraFault(effect) => self.camera_fault = Some(effect.clone()),
            Effect::Obstacles(effect) => self.crowd = Some(effect.model(seed, &self.field, &self.way())),
            Effect::WornLines(effect) => self.worn_lines = Some(effect.clone()),
            Effect::ImageProcessing(effect) => self.image_processing = Some(effect.clone()),
            Effect::ExposureHunting(effect) => self.exposure_hunting = Some(effect.clone()),
            Effect::Optics(effect) => self.optics = Some(effect.clone()),
            Effect::SunPatches(effect) => self.sun_patches = Some(effect.clone()),
            Effect::Turf(effect) => self.turf = Some(effect.clone()),
            Effect::CalibrationError(effect) => {
                self.announced_lens = effect.lens(key, self.lens.parameters())?;
                self.calibration_error = Some(effect.clone());
            }
            other => self.changing.add(other, seed),
        }
        Ok(())
    }

    /// What was drawn once for the whole scene.
    pub fn drawn(&self) -> Vec<Drawn> {
        self.file.template.as_ref().map_or_else(Vec::new, |template| template.drawn(Per::Episode, 0))
    }

    /// What was drawn for one frame.
    pub fn drawn_for(&self, frame: u64) -> Vec<Drawn> {
        self.file.template.as_ref().map_or_else(Vec::new, |template| template.drawn(Per::Frame, frame))
    }

    /// Names of the effects that mean the same on any image, and of the others: those need to know where the camera
    /// stood, or act on something else.
    pub fn effects_on_images(&self) -> (Vec<&'static str>, Vec<&'static str>) {
        let on_any = |effect: &&Effect| match effect {
            Effect::Light(light) => light.gradient_per_m == [0.0; 2],
            Effect::SensorNoise(_) => true,
            _ => false,
        };
        let (on_any, others): (Vec<&Effect>, Vec<&Effect>) = self.file.effects.iter().partition(on_any);
        let names = |effects: Vec<&Effect>| effects.into_iter().map(Effect::name).collect();
        (names(on_any), names(others))
    }

    /// Those that a view made of recorded images can have: [`ViewOverlay`].
    pub fn effects_on_views(&self) -> Vec<&'static str> {
        let figures = self.crowd.is_some().then_some("obstacles");
        figures.into_iter().chain(self.effects_on_images().0).collect()
    }

    /// RGB of any size, as if it were this frame; without such an effect not a bit changes.
    pub fn apply_to_image(&self, frame: u64, pixels: &mut [u8]) {
        let (on_any, _) = self.effects_on_images();
        let now = self.at_frame(frame);
        if let Some(light) = now.light.filter(|_| on_any.contains(&"light")) {
            light.apply(pixels);
        }
        if let Some(noise) = &now.noise {
            noise.apply(frame, pixels);
        }
    }

    /// Where the robot comes by.
    fn way(&self) -> Vec<DVec2> {
        let count = (self.duration_s() / WAY_EVERY_S) as usize;
        let place = |index: usize| self.travel(index as f64 * WAY_EVERY_S).map_from_base_footprint;
        (0..=count).map(place).map(|pose| DVec2::new(pose.x, pose.y)).collect()
    }

    pub fn file(&self) -> &SceneFile {
        &self.file
    }

    pub fn field(&self) -> &Field {
        &self.field
    }

    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// What the robot is told about its lens.
    pub fn announced_lens(&self) -> &LensParameters {
        &self.announced_lens
    }

    /// What the robot is told about its mount.
    pub fn announced_mount(&self) -> Mount {
        let mount = self.mount();
        self.calibration_error.as_ref().map_or(mount, |error| error.mount(&mount))
    }

    /// Seconds from the first event to the last pose.
    pub fn duration_s(&self) -> f64 {
        self.motion.duration() + self.carrying.as_ref().map_or(0.0, Carrying::duration)
    }

    pub fn frame_count(&self) -> u64 {
        events::Clock::new(self.file.camera.rate_hz, self.duration_s()).count()
    }

    /// When the camera takes this frame, in seconds since the start.
    pub fn frame_time_s(&self, index: u64) -> f64 {
        events::Clock::new(self.file.camera.rate_hz, self.duration_s()).time(index)
    }

    /// The last frame that is due by this time; before the first one, that.
    fn frame_at(&self, time: f64) -> u64 {
        events::Clock::new(self.file.camera.rate_hz, self.duration_s()).last_by(time)
    }

    /// How much of this frame arrives, if not all of it.
    pub fn torn(&self, index: u64) -> Option<f64> {
        let [time, next] = [index, index + 1].map(|index| self.frame_time_s(index));
        self.camera_fault.as_ref()?.arrives(time, next, self.file.scene.seed, index)
    }

    /// Whether it tells how its head is turned.
    pub fn has_joints(&self) -> bool {
        self.file.imu.is_some() && self.changing.head.is_some()
    }

    /// Everything the robot receives, in time order.
    pub fn events(&self) -> Events<'_> {
        Events::new(self)
    }
}
