//! The effects that make a scene imperfect, one per file. An effect that the scene file does not list changes nothing.
//!
//! A kind of effect is one file in this folder, which implements `EffectKind`, and one line in the `registry!`. Every effect draws from its own random stream, so that adding one never changes what another does.

mod bright_window;
mod calibration_error;
mod camera_fault;
mod exposure_hunting;
mod fall;
mod gait_sway;
mod head_motion;
mod image_processing;
mod imu_error;
mod kidnapping;
mod light;
mod obstacles;
mod odometry_error;
mod optics;
mod sensor_noise;
mod serial_noise;
mod shutter;
mod sun_patches;
mod turf;
mod worn_lines;

pub use bright_window::{BrightWindow, Wall};
pub use calibration_error::CalibrationError;
pub use camera_fault::CameraFault;
pub use exposure_hunting::ExposureHunting;
pub use fall::{Direction, Fall};
pub use gait_sway::GaitSway;
pub use head_motion::{HeadMotion, Joints};
pub use image_processing::ImageProcessing;
pub use imu_error::ImuError;
pub use kidnapping::Kidnapping;
pub use light::Light;
pub use obstacles::{Figure, FigureShape, Obstacles};
pub use odometry_error::{Jump, OdometryError, Span};
pub use optics::Optics;
pub use sensor_noise::SensorNoise;
pub use serial_noise::SerialNoise;
pub use shutter::Shutter;
pub use sun_patches::SunPatches;
pub use turf::Turf;
pub use worn_lines::WornLines;

pub(super) use fall::Tumble;
pub(super) use gait_sway::{Sway, SwayModel};
pub(super) use kidnapping::Interruption;
pub(super) use light::LightModel;
pub(super) use obstacles::{Crowd, Member};
pub(super) use sensor_noise::NoiseModel;
pub(super) use serial_noise::DeliveryOutcome;

use serde::Deserialize;

use super::check::refuse;
use super::file::SceneFile;
use super::per_frame::Changing;
use super::ranges::Range;
use super::{Scene, SceneError};
use realitysim_geometry::Field;

/// Makes the enum of all effects and the table of their kinds.
///
/// A line states the type, the name in the file, the stage, the subject, and the keys whose values may differ from frame to
/// frame (`per = "frame"`). These are values that nothing else is built on and no clock depends on: the path of a camera or
/// a figure is continuous, paint stays as it is, a lens is announced once, and a fault begins once.
macro_rules! registry {
    ($($(#[$meaning:meta])* $kind:ident, $name:literal, $stage:ident, $subject:ident, $per_frame:expr;)*) => {
        /// One `[[effect]]` of the scene file. The key `kind` selects the variant.
        #[derive(Clone, Debug, PartialEq, Deserialize)]
        #[serde(tag = "kind")]
        pub enum Effect {
            $($(#[$meaning])* #[serde(rename = $name)] $kind($kind),)*
        }

        /// All kinds in the order in which they apply.
        const KINDS: &[Kind] = &[$(
            Kind { name: $name, stage: Stage::$stage, subject: Subject::$subject, per_frame_keys: &$per_frame },
        )*];

        impl Effect {
            /// Name of the effect, as `kind` in the scene file.
            pub fn name(&self) -> &'static str {
                match self { $(Effect::$kind(_) => $name,)* }
            }

            fn kind(&self) -> &dyn EffectKind {
                match self { $(Effect::$kind(effect) => effect,)* }
            }
        }
    };
}

registry! {
    /// The torso rocks with the gait.
    GaitSway, "gait_sway", Motion, CameraMotion, [];
    /// The head pans and tilts.
    HeadMotion, "head_motion", Motion, CameraMotion, ["encoder_noise_deg"];
    /// Somebody carries the robot to another pose.
    Kidnapping, "kidnapping", Motion, CameraMotion, [];
    /// The robot is pushed over and stands up again.
    Fall, "fall", Motion, CameraMotion, [];
    /// The ground is artificial turf instead of flat carpet.
    Turf, "turf", World, Image, [];
    /// The paint of the lines is worn.
    WornLines, "worn_lines", World, Image, [];
    /// Patches of sunlight lie on the floor.
    SunPatches, "sun_patches", World, Image, [];
    /// The light differs from even, white daylight.
    Light, "light", World, Image, ["gain", "gradient_per_m", "colour", "camera_gain"];
    /// A window in the wall is brighter than the sensor can measure.
    BrightWindow, "bright_window", World, Image, ["brightness", "glare", "sun_gain"];
    /// Robots, people and other figures stand or walk around.
    Obstacles, "obstacles", World, Image, [];
    /// Exposure takes time, and rows are read one after the other.
    Shutter, "shutter", Exposure, Image, ["exposure_ms"];
    /// The lens scatters light and has lateral chromatic aberration.
    Optics, "optics", Exposure, Image, [];
    /// The automatic exposure swings.
    ExposureHunting, "exposure_hunting", Exposure, Image, [];
    /// The image sensor adds noise.
    SensorNoise, "sensor_noise", Sensor, Image, ["read_noise_dn", "shot_noise_factor"];
    /// The camera interpolates a colour mosaic and sharpens the image.
    ImageProcessing, "image_processing", Sensor, Image, [];
    /// The odometry has errors.
    OdometryError, "odometry_error", Sensor, Yaw, ["scale_percent", "noise_m_per_m"];
    /// The IMU has errors.
    ImuError, "imu_error", Sensor, Yaw, ["roll_bias_deg", "pitch_bias_deg", "noise_deg", "gyro_noise_deg_s"];
    /// The announced lens and mount differ from the true ones.
    CalibrationError, "calibration_error", Sensor, Calibration, [];
    /// The camera is unplugged for a while.
    CameraFault, "camera_fault", Wire, CameraWire, [];
    /// The serial line loses or corrupts messages.
    SerialNoise, "serial_noise", Wire, SerialWire, ["lost_share", "corrupt_share"];
}

/// What every kind of effect implements.
trait EffectKind {
    /// Why the scene has this effect, if the file says so.
    fn role(&self) -> Option<Role>;

    /// Checks the values. `key` is the key of the effect in the file, for example `effect[1]`.
    fn check(&self, key: &str, field: &Field) -> Result<(), SceneError>;

    /// Checks the values against the rest of the file.
    fn check_in(&self, _key: &str, _file: &SceneFile) -> Result<(), SceneError> {
        Ok(())
    }

    /// Fails with a sentence if the scene lacks what the effect acts on, so that it would change nothing.
    fn needs(&self, _file: &SceneFile) -> Result<(), &'static str> {
        Ok(())
    }

    /// What the effect would need in order to do something, if it does nothing with its values.
    fn lacks(&self) -> Option<&'static str> {
        None
    }

    /// The keys of the times at which its faults begin, with the times, seconds since the start of the scene.
    fn begins(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Whether it moves the camera while a frame is exposed.
    fn moves_camera(&self) -> bool {
        false
    }

    /// Adds the effect to a scene, which has all that come before it in physical order.
    fn add_to(&self, scene: &mut Scene, _key: &str) -> Result<(), SceneError> {
        let seed = scene.file.scene.seed;
        self.set_in(&mut scene.changing, seed);
        Ok(())
    }

    /// Sets the values of one frame. Kinds whose values never change within a scene do nothing.
    fn set_in(&self, _changing: &mut Changing, _seed: u64) {}
}

/// Facts about a kind of effect that hold for all its values: a line of the `registry!`.
struct Kind {
    name: &'static str,
    stage: Stage,
    subject: Subject,
    per_frame_keys: &'static [&'static str],
}

/// Physical stage at which an effect acts. A scene file lists effects in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Motion,
    World,
    Exposure,
    Sensor,
    Wire,
}

/// The thing that an effect acts on. Effects on the same thing apply in the order of the `registry!`; effects on different
/// things are independent of each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Subject {
    /// The motion of the camera: gait, head, and what interrupts both.
    CameraMotion,
    /// The image: turf, paint, sunlight on it, light of the hall, the window and its sunlight, figures in front of all that,
    /// shutter, lens, exposure, sensor, and processing in the camera.
    Image,
    /// The yaw: measured by the odometry and reported by the IMU, too.
    Yaw,
    Calibration,
    CameraWire,
    SerialWire,
}

/// The reason why an effect is in a scene. It is for people only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The task of the scene needs the effect.
    Base,
    /// The effect only keeps the scene from being too clean.
    Filler,
}

impl Effect {
    /// Role of the effect, if the file states one.
    pub fn role(&self) -> Option<Role> {
        self.kind().role()
    }

    /// Whether the effect changes pixels of a frame for a given camera pose. Other effects cost no rendering time.
    pub fn acts_on_image(&self) -> bool {
        KINDS[self.rank()].subject == Subject::Image
    }

    /// Adds the effect to a scene, which has all that come before it in physical order.
    pub(super) fn add_to(&self, scene: &mut Scene, key: &str) -> Result<(), SceneError> {
        self.kind().add_to(scene, key)
    }

    /// Whether the effect moves the camera while a frame is exposed.
    fn moves_camera(&self) -> bool {
        self.kind().moves_camera()
    }

    /// Sets the values of one frame.
    pub(super) fn set_in(&self, changing: &mut Changing, seed: u64) {
        self.kind().set_in(changing, seed);
    }

    /// Place of the kind in the order in which effects apply.
    fn rank(&self) -> usize {
        KINDS.iter().position(|kind| kind.name == self.name()).unwrap_or_default()
    }
}

/// Returns an error if the value cannot be drawn for each frame. The error names the keys that can.
pub(super) fn check_may_change(range: &Range) -> Result<(), SceneError> {
    let kind = KINDS.iter().find(|kind| kind.name == range.kind);
    let allowed = kind.map_or(&[][..], |kind| kind.per_frame_keys);
    // For an element of a list, the key of the list counts.
    let key = range.name.split('[').next().unwrap_or_default();
    if allowed.contains(&key) {
        return Ok(());
    }
    let can = if allowed.is_empty() { "nothing".to_owned() } else { format!("only {}", allowed.join(", ")) };
    let expected = format!("of {} {can} can change with every frame; say per = \"episode\"", range.kind);
    Err(refuse(&range.key, "drawn per frame", expected))
}

/// Checks the values of all effects, that each kind is listed once, and that they are in physical order.
pub(super) fn check(effects: &[Effect], field: &Field) -> Result<(), SceneError> {
    for (index, effect) in effects.iter().enumerate() {
        let key = format!("effect[{index}]");
        effect.kind().check(&key, field)?;
        let before = &effects[..index];
        if before.iter().any(|other| other.name() == effect.name()) {
            let expected = "an effect of this kind is listed already; each kind acts once";
            return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
        }
        let Kind { stage, subject, .. } = KINDS[effect.rank()];
        let same = |kind: &&Kind| kind.stage == stage && kind.subject == subject;
        let later = before.iter().find(|other| other.rank() > effect.rank() && same(&&KINDS[other.rank()]));
        if let Some(later) = later {
            let order: Vec<&str> = KINDS.iter().filter(|kind| kind.subject == subject).map(|kind| kind.name).collect();
            let expected = format!("it applies before {}: list {}, in this order", later.name(), order.join(", "));
            return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
        }
        if before.iter().any(|other| KINDS[other.rank()].stage > stage) {
            let of = |stage: Stage| {
                let names: Vec<&str> = KINDS.iter().filter(|kind| kind.stage == stage).map(|kind| kind.name).collect();
                names.join(", ")
            };
            let expected = format!(
                "list effects in physical order: what moves the robot ({}), then what it sees ({}), then how it is exposed \
                 ({}), then what sensors add ({}), then what the wires do ({})",
                of(Stage::Motion),
                of(Stage::World),
                of(Stage::Exposure),
                of(Stage::Sensor),
                of(Stage::Wire)
            );
            return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
        }
    }
    Ok(())
}

/// Checks that each effect has what it acts on, and that effects and the rest of the file do not contradict each other.
pub(super) fn check_in(file: &SceneFile) -> Result<(), SceneError> {
    for (index, effect) in file.effects.iter().enumerate() {
        let refused = |expected| refuse(format_args!("effect[{index}].kind"), effect.name(), expected);
        effect.kind().needs(file).map_err(refused)?;
    }
    let mut keyed = file.effects.iter().enumerate();
    keyed.try_for_each(|(index, effect)| effect.kind().check_in(&format!("effect[{index}]"), file))
}

/// Checks that no fault begins after `end`, the end of the scene in seconds.
pub(super) fn check_times(effects: &[Effect], end: f64) -> Result<(), SceneError> {
    for (index, effect) in effects.iter().enumerate() {
        if let Some((key, time)) = effect.kind().begins().into_iter().find(|(_, time)| *time >= end) {
            let expected = format!("below {end:.2} s, where the scene ends");
            return Err(refuse(format_args!("effect[{index}].{key}"), time, expected));
        }
    }
    Ok(())
}

/// Checks that every effect changes something with its values.
///
/// This is not checked at the ends of ranges, which may be values that change nothing.
pub(super) fn check_effects_do_something(effects: &[Effect]) -> Result<(), SceneError> {
    for (index, effect) in effects.iter().enumerate() {
        if let Some(needed) = effect.kind().lacks() {
            let value = format!("a {} of nothing", effect.name());
            let expected = format!("it does nothing: leave the entry out, or have {needed}");
            return Err(refuse(format_args!("effect[{index}]"), value, expected));
        }
    }
    Ok(())
}

/// What several kinds need.
const NEEDS_WALK: &str = "it needs a route that is walked, this one stands still";
const NEEDS_ODOMETRY_OR_IMU: &str = "it needs the section [odometry] or [imu], both are absent";

/// Fails with `otherwise` unless the condition holds.
fn require(holds: bool, otherwise: &'static str) -> Result<(), &'static str> {
    if holds { Ok(()) } else { Err(otherwise) }
}

/// Transition from 0 to 1 for `x` from 0 to 1, without a jump in velocity or acceleration ("smootherstep").
fn ease(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}
