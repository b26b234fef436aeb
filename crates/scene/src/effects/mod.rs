//! The effects that make a scene imperfect, one per file. An effect that the scene file does not list changes nothing.
//!
//! Every effect draws from its own random stream, so that adding one never changes what another does.

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

use super::SceneError;
use super::check::refuse;
use super::ranges::Range;
use realitysim_geometry::Field;

/// One `[[effect]]` of the scene file. The key `kind` selects the variant.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Effect {
    /// The torso rocks with the gait.
    GaitSway(GaitSway),
    /// The head pans and tilts.
    HeadMotion(HeadMotion),
    /// Somebody carries the robot to another pose.
    Kidnapping(Kidnapping),
    /// The robot is pushed over and stands up again.
    Fall(Fall),
    /// The light differs from even, white daylight.
    Light(Light),
    /// A window in the wall is brighter than the sensor can measure.
    BrightWindow(BrightWindow),
    /// Robots, people and other figures stand or walk around.
    Obstacles(Obstacles),
    /// The ground is artificial turf instead of flat carpet.
    Turf(Turf),
    /// The paint of the lines is worn.
    WornLines(WornLines),
    /// Patches of sunlight lie on the floor.
    SunPatches(SunPatches),
    /// Exposure takes time, and rows are read one after the other.
    Shutter(Shutter),
    /// The lens scatters light and has lateral chromatic aberration.
    Optics(Optics),
    /// The automatic exposure swings.
    ExposureHunting(ExposureHunting),
    /// The image sensor adds noise.
    SensorNoise(SensorNoise),
    /// The camera interpolates a colour mosaic and sharpens the image.
    ImageProcessing(ImageProcessing),
    /// The camera is unplugged for a while.
    CameraFault(CameraFault),
    /// The odometry has errors.
    OdometryError(OdometryError),
    /// The IMU has errors.
    ImuError(ImuError),
    /// The announced lens and mount differ from the true ones.
    CalibrationError(CalibrationError),
    /// The serial line loses or corrupts messages.
    SerialNoise(SerialNoise),
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

/// Effects and their keys whose values may differ from frame to frame.
///
/// These are values that nothing else is built on and no clock depends on. The path of a camera or a figure is
/// continuous, paint stays as it is, a lens is announced once, and a fault begins once.
const MAY_CHANGE: [(&str, &[&str]); 8] = [
    ("head_motion", &["encoder_noise_deg"]),
    ("light", &["gain", "gradient_per_m", "colour", "camera_gain"]),
    ("bright_window", &["brightness", "glare", "sun_gain"]),
    ("shutter", &["exposure_ms"]),
    ("sensor_noise", &["read_noise_dn", "shot_noise_factor"]),
    ("odometry_error", &["scale_percent", "noise_m_per_m"]),
    ("imu_error", &["roll_bias_deg", "pitch_bias_deg", "noise_deg", "gyro_noise_deg_s"]),
    ("serial_noise", &["lost_share", "corrupt_share"]),
];

/// Returns an error if the value cannot be drawn for each frame. The error names the keys that can.
pub(super) fn check_may_change(range: &Range) -> Result<(), SceneError> {
    let allowed = MAY_CHANGE.iter().find(|(kind, _)| *kind == range.kind).map_or(&[][..], |(_, keys)| keys);
    // For an element of a list, the key of the list counts.
    let key = range.name.split('[').next().unwrap_or_default();
    if allowed.contains(&key) {
        return Ok(());
    }
    let can = if allowed.is_empty() { "nothing".to_owned() } else { format!("only {}", allowed.join(", ")) };
    let expected = format!("of {} {can} can change with every frame; say per = \"episode\"", range.kind);
    Err(refuse(&range.key, "drawn per frame", expected))
}

/// Effects that act on the same thing, in the order in which they apply. All other effects are independent of each other.
///
/// The first chain is the motion of the camera: gait, head, and what interrupts both. The second is the image: turf, paint,
/// sunlight on it, light of the hall, the window and its sunlight, figures in front of all that, shutter, lens, exposure,
/// sensor, and processing in the camera. The third is the yaw: measured by the odometry and reported by the IMU, too.
const CHAINS: [&[&str]; 3] = [
    &["gait_sway", "head_motion", "kidnapping", "fall"],
    &[
        "turf",
        "worn_lines",
        "sun_patches",
        "light",
        "bright_window",
        "obstacles",
        "shutter",
        "optics",
        "exposure_hunting",
        "sensor_noise",
        "image_processing",
    ],
    &["odometry_error", "imu_error"],
];

/// Physical stage at which an effect acts. A scene file lists effects in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Motion,
    World,
    Exposure,
    Sensor,
    Wire,
}

impl Effect {
    /// Name of the effect, as `kind` in the scene file.
    pub fn name(&self) -> &'static str {
        match self {
            Effect::GaitSway(_) => "gait_sway",
            Effect::HeadMotion(_) => "head_motion",
            Effect::Kidnapping(_) => "kidnapping",
            Effect::Fall(_) => "fall",
            Effect::BrightWindow(_) => "bright_window",
            Effect::Shutter(_) => "shutter",
            Effect::CameraFault(_) => "camera_fault",
            Effect::SerialNoise(_) => "serial_noise",
            Effect::Light(_) => "light",
            Effect::Obstacles(_) => "obstacles",
            Effect::WornLines(_) => "worn_lines",
            Effect::ImageProcessing(_) => "image_processing",
            Effect::ExposureHunting(_) => "exposure_hunting",
            Effect::Optics(_) => "optics",
            Effect::SunPatches(_) => "sun_patches",
            Effect::Turf(_) => "turf",
            Effect::SensorNoise(_) => "sensor_noise",
            Effect::OdometryError(_) => "odometry_error",
            Effect::ImuError(_) => "imu_error",
            Effect::CalibrationError(_) => "calibration_error",
        }
    }

    /// Role of the effect, if the file states one.
    pub fn role(&self) -> Option<Role> {
        match self {
            Effect::GaitSway(effect) => effect.role,
            Effect::HeadMotion(effect) => effect.role,
            Effect::Kidnapping(effect) => effect.role,
            Effect::Fall(effect) => effect.role,
            Effect::BrightWindow(effect) => effect.role,
            Effect::Shutter(effect) => effect.role,
            Effect::CameraFault(effect) => effect.role,
            Effect::SerialNoise(effect) => effect.role,
            Effect::Light(effect) => effect.role,
            Effect::Obstacles(effect) => effect.role,
            Effect::WornLines(effect) => effect.role,
            Effect::ImageProcessing(effect) => effect.role,
            Effect::ExposureHunting(effect) => effect.role,
            Effect::Optics(effect) => effect.role,
            Effect::SunPatches(effect) => effect.role,
            Effect::Turf(effect) => effect.role,
            Effect::SensorNoise(effect) => effect.role,
            Effect::OdometryError(effect) => effect.role,
            Effect::ImuError(effect) => effect.role,
            Effect::CalibrationError(effect) => effect.role,
        }
    }

    /// Whether the effect changes pixels of a frame for a given camera pose. Other effects cost no rendering time.
    pub fn acts_on_image(&self) -> bool {
        match self {
            Effect::Light(_)
            | Effect::BrightWindow(_)
            | Effect::Obstacles(_)
            | Effect::Turf(_)
            | Effect::WornLines(_)
            | Effect::SunPatches(_)
            | Effect::Shutter(_)
            | Effect::Optics(_)
            | Effect::ExposureHunting(_)
            | Effect::SensorNoise(_)
            | Effect::ImageProcessing(_) => true,
            Effect::GaitSway(_)
            | Effect::HeadMotion(_)
            | Effect::Kidnapping(_)
            | Effect::Fall(_)
            | Effect::CameraFault(_)
            | Effect::OdometryError(_)
            | Effect::ImuError(_)
            | Effect::CalibrationError(_)
            | Effect::SerialNoise(_) => false,
        }
    }

    /// If the effect does nothing with its values: what it would need in order to do something.
    pub(super) fn lacks(&self) -> Option<&'static str> {
        let (does_nothing, needed) = match self {
            Effect::GaitSway(effect) => (effect.is_still(), "an amplitude above 0"),
            Effect::HeadMotion(effect) => {
                (effect.is_still() && effect.encoder_noise_deg == 0.0, "an amplitude or encoder_noise_deg above 0")
            }
            Effect::Light(effect) => {
                (effect.is_daylight(), "a gain or camera_gain other than 1, a gradient or a colour other than white")
            }
            Effect::WornLines(effect) => (effect.share == 0.0, "a share above 0"),
            Effect::SunPatches(effect) => {
                (effect.gain == 1.0 || effect.share == 0.0, "a gain above 1 and a share above 0")
            }
            Effect::Optics(effect) => (effect.is_perfect(), "stray_light or lateral_colour_px above 0"),
            Effect::ExposureHunting(effect) => (effect.amplitude == 0.0, "an amplitude above 0"),
            Effect::ImageProcessing(effect) => (effect.has_no_effect(), "colour_filter, or sharpening above 0"),
            Effect::SensorNoise(effect) => (
                effect.read_noise_dn == 0.0 && effect.shot_noise_factor == 0.0,
                "read_noise_dn or shot_noise_factor above 0",
            ),
            Effect::OdometryError(effect) => {
                (effect.has_no_effect(), "at least one of its keys other than 0, or freeze, missing or jump")
            }
            Effect::ImuError(effect) => (effect.has_no_effect(), "at least one of its keys other than 0"),
            Effect::CalibrationError(effect) => (effect.has_no_effect(), "at least one of its keys other than 0"),
            Effect::SerialNoise(effect) => {
                (effect.lost_share == 0.0 && effect.corrupt_share == 0.0, "lost_share or corrupt_share above 0")
            }
            Effect::Kidnapping(_)
            | Effect::Fall(_)
            | Effect::BrightWindow(_)
            | Effect::Obstacles(_)
            | Effect::Turf(_)
            | Effect::Shutter(_)
            | Effect::CameraFault(_) => (false, ""),
        };
        does_nothing.then_some(needed)
    }

    /// Whether the effect moves the camera while a frame is exposed.
    pub(super) fn moves_camera(&self) -> bool {
        match self {
            Effect::GaitSway(effect) => !effect.is_still(),
            Effect::HeadMotion(effect) => !effect.is_still(),
            _ => false,
        }
    }

    fn stage(&self) -> Stage {
        match self {
            Effect::GaitSway(_) | Effect::HeadMotion(_) | Effect::Kidnapping(_) | Effect::Fall(_) => Stage::Motion,
            Effect::Turf(_)
            | Effect::WornLines(_)
            | Effect::SunPatches(_)
            | Effect::Light(_)
            | Effect::BrightWindow(_)
            | Effect::Obstacles(_) => Stage::World,
            Effect::Shutter(_) | Effect::Optics(_) | Effect::ExposureHunting(_) => Stage::Exposure,
            Effect::SensorNoise(_)
            | Effect::ImageProcessing(_)
            | Effect::OdometryError(_)
            | Effect::ImuError(_)
            | Effect::CalibrationError(_) => Stage::Sensor,
            Effect::CameraFault(_) | Effect::SerialNoise(_) => Stage::Wire,
        }
    }

    /// Checks the values of the effect. `key` is its key in the file, for example `effect[1]`.
    fn check(&self, key: &str, field: &Field) -> Result<(), SceneError> {
        match self {
            Effect::GaitSway(effect) => effect.check(key),
            Effect::HeadMotion(effect) => effect.check(key),
            Effect::Kidnapping(effect) => effect.check(key, field),
            Effect::Fall(effect) => effect.check(key),
            Effect::BrightWindow(effect) => effect.check(key),
            Effect::Shutter(effect) => effect.check(key),
            Effect::CameraFault(effect) => effect.check(key),
            Effect::SerialNoise(effect) => effect.check(key),
            Effect::Light(effect) => effect.check(key),
            Effect::Obstacles(effect) => effect.check(key, field),
            Effect::WornLines(effect) => effect.check(key),
            Effect::ImageProcessing(effect) => effect.check(key),
            Effect::ExposureHunting(effect) => effect.check(key),
            Effect::Optics(effect) => effect.check(key),
            Effect::SunPatches(effect) => effect.check(key),
            Effect::Turf(effect) => effect.check(key),
            Effect::SensorNoise(effect) => effect.check(key),
            Effect::OdometryError(effect) => effect.check(key),
            Effect::ImuError(effect) => effect.check(key),
            Effect::CalibrationError(effect) => effect.check(key),
        }
    }
}

/// Checks the values of all effects, that each kind is listed once, and that they are in physical order.
pub(super) fn check(effects: &[Effect], field: &Field) -> Result<(), SceneError> {
    for (index, effect) in effects.iter().enumerate() {
        let key = format!("effect[{index}]");
        effect.check(&key, field)?;
        let before = &effects[..index];
        if before.iter().any(|other| other.name() == effect.name()) {
            let expected = "an effect of this kind is listed already; each kind acts once";
            return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
        }
        for chain in CHAINS {
            let place = |effect: &Effect| chain.iter().position(|name| *name == effect.name());
            let Some(own) = place(effect) else { continue };
            if let Some(later) = before.iter().find(|other| place(other) > Some(own) && other.stage() == effect.stage())
            {
                let expected = format!("it applies before {}: list {}, in this order", later.name(), chain.join(", "));
                return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
            }
        }
        if before.iter().any(|other| other.stage() > effect.stage()) {
            let expected = "list effects in physical order: what moves the robot (gait_sway, head_motion, kidnapping, \
                            fall), then what it sees (turf, worn_lines, sun_patches, light, bright_window, obstacles), \
                            then how it is exposed (shutter, optics, exposure_hunting), then what sensors add \
                            (sensor_noise, image_processing, odometry_error, imu_error, calibration_error), then \
                            what the wires do (camera_fault, serial_noise)";
            return Err(refuse(format_args!("{key}.kind"), effect.name(), expected));
        }
    }
    Ok(())
}

/// Transition from 0 to 1 for `x` from 0 to 1, without a jump in velocity or acceleration ("smootherstep").
fn ease(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (10.0 + x * (6.0 * x - 15.0))
}
