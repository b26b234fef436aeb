//! The scene file (`replay/scenes/*.toml`) as plain data. [`Scene::build`](super::Scene::build) checks its values.

use core::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use toml::de::DeTable;

use super::effects::Effect;
use super::key_lines::KeyLines;
use super::ranges::{Range, Template};
use super::{SceneError, error_spans};
use realitysim_config::wording::in_words;

/// The contents of a scene file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// `[scene]`: title, seed, field and announced start.
    pub scene: SceneSection,
    /// `[camera]`: lens, rate and mount.
    pub camera: CameraSection,
    /// `[route]`: where the robot goes.
    pub route: Route,
    /// `[odometry]`: rate of odometry messages. Without it no odometry is sent.
    pub odometry: Option<RateSection>,
    /// `[imu]`: rate of IMU messages. Without it no IMU data is sent.
    pub imu: Option<RateSection>,
    /// `[[effect]]`: imperfections in physical order, from what moves the robot to what sensors and wires add.
    #[serde(default, rename = "effect")]
    pub effects: Vec<Effect>,
    /// Lines of the keys, if the file was read from a text.
    #[serde(skip)]
    pub(super) key_lines: KeyLines,
    /// Text of the file with its ranges, if it was read from a text.
    #[serde(skip)]
    pub(super) template: Option<Template>,
}

/// The section `[scene]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSection {
    /// Title of the scene, for people.
    pub title: String,
    /// Reason why the scene exists, for people.
    pub task: String,
    /// Seed of every random number of the scene.
    pub seed: u64,
    /// Name of the field. The caller finds its dimensions.
    pub field: String,
    /// Pose that the robot is toml_error at the start.
    #[serde(default)]
    pub initial_pose: InitialPose,
}

/// The section `[camera]`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSection {
    /// Name of the lens. The caller finds its parameters.
    pub lens: String,
    /// Images per second.
    pub rate_hz: f64,
    /// Quality of JPEG images, 1 to 100. Without it the images are sent raw.
    pub jpeg_quality: Option<u8>,
    /// Height of `base_link` above `base_footprint` when the robot stands upright, metres.
    pub torso_height_m: f64,
    /// Position of `camera_link` in `base_link`, metres.
    pub mount_xyz_m: [f64; 3],
    /// Pitch of the camera in the torso, degrees. Above 0 the camera looks down.
    pub mount_pitch_deg: f64,
}

/// The section `[route]`: how the robot moves over the field.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Route {
    /// The robot walks along waypoints.
    Walk(Walk),
    /// The robot stands at one pose after the other.
    Still(Still),
}

/// A walk from waypoint to waypoint. Corners are rounded as far as `turn_deg_s` demands.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    /// Waypoints [x, y] in `map`, metres.
    pub waypoints: Vec<[f64; 2]>,
    /// Walking speed, m/s.
    pub speed_m_s: f64,
    /// Turn rate at corners, degrees per second.
    pub turn_deg_s: f64,
    /// Yaw at the start in `map`, degrees. Without it the robot starts facing the second waypoint.
    pub start_yaw_deg: Option<f64>,
    /// Time that the robot stands at each waypoint but the first, seconds. It then turns on the spot, and rounds no corner.
    #[serde(default)]
    pub stand_s: f64,
}

/// Standing at one pose after the other. The robot is carried in between, which odometry does not notice.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Still {
    /// Poses [x in m, y in m, yaw in degrees] in `map`.
    pub poses: Vec<[f64; 3]>,
    /// Time at each pose, seconds.
    pub hold_s: f64,
}

/// The section `[odometry]` or `[imu]`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateSection {
    /// Messages per second.
    pub rate_hz: f64,
}

/// The pose that is announced at the start: `"exact"`, `"none"` or a table with an error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum InitialPose {
    /// The true pose is announced.
    #[default]
    Exact,
    /// No pose is announced.
    None,
    /// The true pose plus an error is announced.
    Off(PoseError),
}

/// Error that is added to the true pose at the start.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseError {
    /// Error along x of `map`, metres.
    pub x_m: f64,
    /// Error along y of `map`, metres.
    pub y_m: f64,
    /// Error of the yaw, degrees.
    pub yaw_deg: f64,
}

impl SceneFile {
    /// Whether the file has an effect of this name.
    pub(super) fn lists(&self, effect: &str) -> bool {
        self.effects.iter().any(|listed| listed.name() == effect)
    }

    /// Reads a scene file. Numbers that the text leaves open (`{ uniform = [..], per = .. }`) are drawn from its seed.
    ///
    /// An error states the line and what would be right. Values are checked later, by [`Scene::build`](super::Scene::build).
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        let (key_lines, template) = {
            let table = DeTable::parse(text).map_err(toml_error)?;
            let key_lines = KeyLines::find(text, table.get_ref());
            let template = Template::new(text, table.get_ref(), &key_lines)?;
            (key_lines, template)
        };
        let text = template.fill(|range| template.value(range, 0));
        let file: Self = toml::from_str(&text).map_err(|error| toml_error(error_spans::locate(error, &text)))?;
        Ok(Self { key_lines, template: Some(template), ..file })
    }

    /// Reads the effects again with `value` in place of each range.
    pub(super) fn effects_with(template: &Template, value: impl Fn(&Range) -> f64) -> Result<Vec<Effect>, SceneError> {
        Ok(toml::from_str::<Self>(&template.fill(value)).map_err(toml_error)?.effects)
    }

    /// The text with every value that was drawn once per episode filled in. Ranges that are drawn for each frame stay.
    ///
    /// `None` for a file that was not read from a text.
    pub fn resolved(&self) -> Option<String> {
        Some(self.template.as_ref()?.fill_per_episode())
    }

    /// Line of the text, from 1, that has the key (for example `camera.lens`) or the nearest table or list around it.
    pub fn line(&self, key: &str) -> Option<usize> {
        self.key_lines.line(key)
    }
}

fn toml_error(error: toml::de::Error) -> SceneError {
    SceneError::Toml(in_words(&error))
}

/// Written by hand because an untagged enum could not report which key of the table is wrong.
impl<'de> Deserialize<'de> for InitialPose {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Forms;
        const EXPECTED: &str = "initial_pose: \"exact\", \"none\" or { x_m = .., y_m = .., yaw_deg = .. }";
        impl<'de> Visitor<'de> for Forms {
            type Value = InitialPose;

            fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
                formatter.write_str(EXPECTED)
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<InitialPose, E> {
                match name {
                    "exact" => Ok(InitialPose::Exact),
                    "none" => Ok(InitialPose::None),
                    other => Err(E::custom(format_args!("initial_pose is \"{other}\", expected {EXPECTED}"))),
                }
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<InitialPose, A::Error> {
                PoseError::deserialize(MapAccessDeserializer::new(map)).map(InitialPose::Off)
            }
        }
        deserializer.deserialize_any(Forms)
    }
}
