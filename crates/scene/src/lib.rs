//! Simulated walks with known ground truth: a scene file becomes a trajectory, sensor messages and camera images.
//!
//! [`SceneFile`] is the parsed file, [`Scene::build`] checks it against a field and a lens. [`Scene::truth`] gives the
//! true pose of robot and camera at any time, [`Scene::events`] iterates over the messages of the sensors, and
//! [`Renderer`] draws the images of the camera. [`ViewOverlay`] applies the effects of a scene to images that something
//! else has made. Each imperfection is one [`Effect`]; an effect that the file does not list changes nothing.
//!
//! The crate is pure: every result is a function of scene file, field and lens. Random numbers come from the seed in the file.
//!
//! ```rust
//! use realitysim_config::{load_field, load_lens};
//! use realitysim_scene::{Renderer, Scene, SceneFile};
//!
//! let file = SceneFile::from_toml(
//!     r#"
//!     scene = { title = "A walk", task = "An example", seed = 1, field = "kid-2009" }
//!     camera = { lens = "fisheye-640", rate_hz = 10.0, torso_height_m = 0.38, mount_xyz_m = [0.04, 0.0, 0.11], mount_pitch_deg = 17.0 }
//!     route = { kind = "walk", waypoints = [[-2.0, 0.0], [2.0, 0.0]], speed_m_s = 0.25, turn_deg_s = 30.0 }
//!     "#,
//! )?;
//! let (field, lens) = (load_field(&file.scene.field)?, load_lens(&file.camera.lens)?.lens);
//! let scene = Scene::build(file, field, lens.parameters().clone())?;
//! assert_eq!(scene.frame_count(), 161); // 16 s at 10 Hz, both ends included
//!
//! let mut rgb = Vec::new();
//! Renderer::new(&scene).render(0, &mut rgb);
//! assert_eq!(rgb.len(), 3 * lens.width() as usize * lens.height() as usize);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod check;
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
    CalibrationError, CameraFault, Crowd, ExposureHunting, ImageProcessing, Interruption, Optics, SunPatches,
    SwayModel, Turf, WornLines,
};
use glam::DVec2;
use motion::Motion;
use per_frame::Changing;
use ranges::Per;
use realitysim_geometry::{Field, FieldDimensions, Lens, LensParameters, Pose2};

/// Stamp of the first event of every scene, nanoseconds since 1970. It is fixed so that recordings can be repeated.
pub const START_STAMP_NS: i64 = 1_760_000_000_000_000_000;

/// Interval at which the robot's path is sampled to keep random figures away from it, seconds.
const PATH_INTERVAL_S: f64 = 0.5;

/// A scene that has been checked: the file with its field, its lens, its motion and its effects.
#[derive(Clone, Debug)]
pub struct Scene {
    file: SceneFile,
    field: Field,
    lens: Lens,
    announced_lens: LensParameters,
    motion: Motion,
    sway: Option<SwayModel>,
    interruption: Option<Interruption>,
    crowd: Option<Crowd>,
    turf: Option<Turf>,
    worn_lines: Option<WornLines>,
    sun_patches: Option<SunPatches>,
    optics: Option<Optics>,
    exposure_hunting: Option<ExposureHunting>,
    image_processing: Option<ImageProcessing>,
    calibration_error: Option<CalibrationError>,
    camera_fault: Option<CameraFault>,
    /// Effects whose numbers may differ from frame to frame, as in the first frame. [`Scene::at_frame`] gives the others.
    changing: Changing,
}

impl Scene {
    /// Checks a scene file and prepares its motion and effects.
    ///
    /// `field` and `lens` are what the names `scene.field` and `camera.lens` of the file stand for. The error names the
    /// key that is wrong, with its line in the file where known.
    pub fn build(file: SceneFile, field: FieldDimensions, lens: LensParameters) -> Result<Self, SceneError> {
        let key_lines = file.key_lines.clone();
        Self::checked(file, field, lens).map_err(|error| error.with_line(&key_lines))
    }

    fn checked(file: SceneFile, field: FieldDimensions, lens: LensParameters) -> Result<Self, SceneError> {
        let field = Field::new(field)?;
        let lens = Lens::new(lens)?;
        // The ends of ranges are checked before the drawn values, so that a message has the number that is in the file.
        check::check_ranges(&file, |file| Self::assemble(file, field.clone(), lens.clone()).map(drop))?;
        effects::check_effects_do_something(&file.effects)?;
        let template = file.template.clone();
        Self::assemble(file, field, lens).map_err(|error| match &template {
            Some(template) => error.with_drawn_values(template, |range| template.value(range, 0)),
            None => error,
        })
    }

    fn assemble(file: SceneFile, field: Field, lens: Lens) -> Result<Self, SceneError> {
        check::check(&file, &field)?;
        let motion = Motion::new(&file.route);
        check::check_duration(motion.duration())?;
        let mut scene = Self {
            file,
            field,
            announced_lens: lens.parameters().clone(),
            lens,
            motion,
            sway: None,
            interruption: None,
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
            effect.add_to(&mut scene, &format!("effect[{index}]"))?;
        }
        check::check_duration(scene.duration_s())?;
        effects::check_times(&scene.file.effects, scene.duration_s())?;
        Ok(scene)
    }

    /// The same walk with only the first `count` effects of its file, to measure what each effect does and costs.
    pub fn with_first_effects(&self, count: usize) -> Result<Self, SceneError> {
        let mut file = self.file.clone();
        file.effects.truncate(count);
        Self::build(file, self.field.dimensions().clone(), self.lens.parameters().clone())
    }

    /// The same walk with worn lines of which the share `left` (0 to 1) of the paint remains, in the same patches.
    /// `None` if the scene has no effect `worn_lines`.
    pub fn with_paint(&self, left: f64) -> Result<Option<Self>, SceneError> {
        let mut file = self.file.clone();
        let worn = |effect: &Effect| matches!(effect, Effect::WornLines(_));
        let Some(index) = file.effects.iter().position(worn) else { return Ok(None) };
        if left >= 1.0 {
            // The check refuses an effect that does nothing, so the effect is removed.
            file.effects.remove(index);
        } else if let Effect::WornLines(effect) = &mut file.effects[index] {
            effect.share = 1.0 - left;
        }
        Self::build(file, self.field.dimensions().clone(), self.lens.parameters().clone()).map(Some)
    }

    /// Values that were drawn once for the whole scene.
    pub fn drawn(&self) -> Vec<Drawn> {
        self.file.template.as_ref().map_or_else(Vec::new, |template| template.drawn(Per::Episode, 0))
    }

    /// Values that were drawn for one frame.
    pub fn drawn_for(&self, frame: u64) -> Vec<Drawn> {
        self.file.template.as_ref().map_or_else(Vec::new, |template| template.drawn(Per::Frame, frame))
    }

    /// Names of the effects that can be applied to any image, and names of the others.
    ///
    /// The others depend on the pose of the camera or do not act on images.
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

    /// Names of the effects that [`ViewOverlay`] can apply to a view made of recorded images.
    pub fn effects_on_views(&self) -> Vec<&'static str> {
        let figures = self.crowd.is_some().then_some("obstacles");
        figures.into_iter().chain(self.effects_on_images().0).collect()
    }

    /// Applies the effects that suit any image ([`Scene::effects_on_images`]) to RGB pixels, as in frame `frame`.
    ///
    /// The image may have any size. Without such an effect no bit changes.
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

    /// Positions of the robot in `map` every [`PATH_INTERVAL_S`], metres.
    fn sampled_path(&self) -> Vec<DVec2> {
        let count = (self.duration_s() / PATH_INTERVAL_S) as usize;
        let pose_at = |index: usize| self.travel(index as f64 * PATH_INTERVAL_S).map_from_base_footprint;
        (0..=count).map(pose_at).map(|pose| DVec2::new(pose.x, pose.y)).collect()
    }

    /// The scene file, with drawn values in place of ranges.
    pub fn file(&self) -> &SceneFile {
        &self.file
    }

    /// The soccer field that the robot walks on.
    pub fn field(&self) -> &Field {
        &self.field
    }

    /// The true lens, which the images are rendered through.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The lens parameters that the robot is told: the true ones unless the scene has a calibration error.
    pub fn announced_lens(&self) -> &LensParameters {
        &self.announced_lens
    }

    /// The static transforms that the robot is told: the true ones unless the scene has a calibration error.
    pub fn announced_mount(&self) -> Mount {
        let mount = self.mount();
        self.calibration_error.as_ref().map_or(mount, |error| error.mount(&mount))
    }

    /// Duration of the scene, seconds: the route plus the time of a kidnapping or fall.
    pub fn duration_s(&self) -> f64 {
        self.motion.duration() + self.interruption.as_ref().map_or(0.0, Interruption::duration)
    }

    /// The times at which the robot stands at a waypoint of its walk ([`file::Walk::stand_s`]): begin and end, seconds along the route,
    /// and the pose of `base_footprint` in `map`.
    pub fn stands(&self) -> Vec<(f64, f64, Pose2)> {
        self.motion.stands().collect()
    }

    /// Number of frames that the camera takes, whether or not they arrive.
    pub fn frame_count(&self) -> u64 {
        events::Clock::new(self.file.camera.rate_hz, self.duration_s()).count()
    }

    /// Time at which the camera takes this frame, seconds since the start.
    pub fn frame_time_s(&self, index: u64) -> f64 {
        events::Clock::new(self.file.camera.rate_hz, self.duration_s()).time(index)
    }

    /// Index of the last frame that is due by `time` (seconds since the start), or 0 before the first frame.
    fn frame_at(&self, time: f64) -> u64 {
        events::Clock::new(self.file.camera.rate_hz, self.duration_s()).last_by(time)
    }

    /// Share of this frame's data that arrives, 0 to 1, if a camera fault cuts the frame off.
    pub fn torn(&self, index: u64) -> Option<f64> {
        let [time, next] = [index, index + 1].map(|index| self.frame_time_s(index));
        self.camera_fault.as_ref()?.arriving_share(time, next, self.file.scene.seed, index)
    }

    /// Whether the robot sends joint angles of its head.
    pub fn has_joints(&self) -> bool {
        self.file.imu.is_some() && self.changing.head.is_some()
    }

    /// All events that the robot receives, in order of time.
    pub fn events(&self) -> Events<'_> {
        Events::new(self)
    }
}
