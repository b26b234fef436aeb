//! Made-up walks with known truth: a scene file becomes a trajectory, sensor messages and camera images.
//!
//! Pure: everything is a function of file, field and lens. [`Scene::truth`] is the robot's pose at any time,
//! [`Scene::events`] what its sensors send, [`Renderer`] what its camera sees.

mod check;
pub mod effects;
mod events;
pub mod file;
mod motion;
mod render;
mod stream;
mod truth;

pub use check::SceneError;
pub use effects::{Effect, Joints, Role};
pub use events::{Events, Imu, InitialPoseEstimate, Odometry, SceneEvent, SceneEventKind};
pub use file::{InitialPose, Route, SceneFile};
pub use render::Renderer;
pub use truth::{Mount, Truth, Twist};

use crate::geometry::{Field, FieldDimensions, Lens, LensParameters};
use effects::{
    CalibrationError, Carrying, Crowd, HeadMotion, ImuError, LightModel, NoiseModel, OdometryError, SwayModel,
    WornLines,
};
use glam::DVec2;
use motion::Motion;

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
    head: Option<HeadMotion>,
    carrying: Option<Carrying>,
    light: Option<LightModel>,
    crowd: Option<Crowd>,
    odometry_error: Option<OdometryError>,
    imu_error: Option<ImuError>,
    worn_lines: Option<WornLines>,
    calibration_error: Option<CalibrationError>,
    noise: Option<NoiseModel>,
}

impl Scene {
    /// `field` and `lens` are what the file's names `scene.field` and `camera.lens` stand for.
    pub fn build(file: SceneFile, field: FieldDimensions, lens: LensParameters) -> Result<Self, SceneError> {
        let field = Field::new(field)?;
        let lens = Lens::new(lens)?;
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
            head: None,
            carrying: None,
            light: None,
            crowd: None,
            odometry_error: None,
            imu_error: None,
            worn_lines: None,
            calibration_error: None,
            noise: None,
        };
        for (index, effect) in scene.file.effects.clone().iter().enumerate() {
            scene.add(&format!("effect[{index}]"), effect)?;
        }
        check::duration(scene.duration_s())?;
        Ok(scene)
    }

    /// Effects come in physical order, so that each finds what it builds on.
    fn add(&mut self, key: &str, effect: &Effect) -> Result<(), SceneError> {
        let seed = self.file.scene.seed;
        match effect {
            Effect::GaitSway(effect) => self.sway = Some(effect.model(seed, self.motion.duration())),
            Effect::HeadMotion(effect) => self.head = Some(effect.clone()),
            Effect::Kidnapping(effect) => self.carrying = Some(effect.model(key, &self.motion, &self.field)?),
            Effect::Light(effect) => self.light = Some(effect.model()),
            Effect::Obstacles(effect) => self.crowd = Some(effect.model(seed, &self.field, &self.way())),
            Effect::OdometryError(effect) => self.odometry_error = Some(effect.clone()),
            Effect::ImuError(effect) => self.imu_error = Some(effect.clone()),
            Effect::WornLines(effect) => self.worn_lines = Some(effect.clone()),
            Effect::CalibrationError(effect) => {
                self.announced_lens = effect.lens(key, self.lens.parameters())?;
                self.calibration_error = Some(effect.clone());
            }
            Effect::SensorNoise(effect) => {
                let amplified = self.light.as_ref().map_or(1.0, |light| light.camera_gain());
                self.noise = Some(effect.model(seed, amplified));
            }
        }
        Ok(())
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

    /// Everything the robot receives, in time order.
    pub fn events(&self) -> Events<'_> {
        Events::new(self)
    }
}
