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
pub use effects::{Effect, Role};
pub use events::{Events, Imu, InitialPoseEstimate, Odometry, SceneEvent, SceneEventKind};
pub use file::{InitialPose, Route, SceneFile};
pub use render::Renderer;
pub use truth::{Mount, Truth, Twist};

use crate::geometry::{Field, FieldDimensions, Lens, LensParameters};
use effects::{ImuError, NoiseModel, OdometryError, SwayModel};
use motion::Motion;

/// The stamp of every scene's first event, in nanoseconds since 1970: a fixed day, so that recordings repeat.
pub const START_STAMP_NS: i64 = 1_760_000_000_000_000_000;

/// A checked scene.
#[derive(Clone, Debug)]
pub struct Scene {
    file: SceneFile,
    field: Field,
    lens: Lens,
    motion: Motion,
    sway: Option<SwayModel>,
    odometry_error: Option<OdometryError>,
    imu_error: Option<ImuError>,
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
        let seed = file.scene.seed;
        let (mut sway, mut odometry_error, mut imu_error, mut noise) = (None, None, None, None);
        for effect in &file.effects {
            match effect {
                Effect::GaitSway(effect) => sway = Some(effect.model(seed, motion.duration())),
                Effect::SensorNoise(effect) => noise = Some(effect.model(seed)),
                Effect::OdometryError(effect) => odometry_error = Some(effect.clone()),
                Effect::ImuError(effect) => imu_error = Some(effect.clone()),
            }
        }
        Ok(Self { file, field, lens, motion, sway, odometry_error, imu_error, noise })
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

    /// Seconds from the first event to the last pose.
    pub fn duration_s(&self) -> f64 {
        self.motion.duration()
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
