//! The scene file (`replay/scenes/*.toml`) as plain data. [`Scene::build`](super::Scene::build) checks it.

use core::fmt;

use serde::de::value::MapAccessDeserializer;
use serde::de::{Error, MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use toml::de::DeTable;

use super::effects::Effect;
use super::key_lines::Places;
use super::ranges::{Range, Template};
use super::{SceneError, error_spans};
use realitysim_config::wording::in_words;

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    pub scene: SceneSection,
    pub camera: CameraSection,
    pub route: Route,
    /// Without it no odometry is sent.
    pub odometry: Option<RateSection>,
    /// Without it no IMU data is sent.
    pub imu: Option<RateSection>,
    /// In physical order: what moves the robot before what a sensor adds.
    #[serde(default, rename = "effect")]
    pub effects: Vec<Effect>,
    /// Of a file that was read from a text.
    #[serde(skip)]
    pub(super) places: Places,
    /// Its text.
    #[serde(skip)]
    pub(super) template: Option<Template>,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSection {
    /// For people.
    pub title: String,
    /// Why the scene exists.
    pub task: String,
    pub seed: u64,
    /// Name of the field; the caller finds its dimensions.
    pub field: String,
    #[serde(default)]
    pub initial_pose: InitialPose,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSection {
    /// Name of the lens; the caller finds its parameters.
    pub lens: String,
    pub rate_hz: f64,
    /// Without it the images are handed over raw.
    pub jpeg_quality: Option<u8>,
    /// Height of `base_link` above `base_footprint`, robot upright.
    pub torso_height_m: f64,
    /// `camera_link` in `base_link`.
    pub mount_xyz_m: [f64; 3],
    /// Above 0 the camera looks down.
    pub mount_pitch_deg: f64,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Route {
    Walk(Walk),
    Still(Still),
}

/// From waypoint to waypoint; corners are rounded as far as `turn_deg_s` demands.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    /// [x, y] in `map`.
    pub waypoints: Vec<[f64; 2]>,
    pub speed_m_s: f64,
    pub turn_deg_s: f64,
    /// Without it the robot starts facing the second waypoint.
    pub start_yaw_deg: Option<f64>,
}

/// Standing at one pose after the other; the robot is carried in between, which odometry does not notice.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Still {
    /// [x in m, y in m, yaw in degrees] in `map`.
    pub poses: Vec<[f64; 3]>,
    pub hold_s: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RateSection {
    pub rate_hz: f64,
}

/// What is announced as the robot's pose at the start: `"exact"`, `"none"` or the truth plus an error.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum InitialPose {
    #[default]
    Exact,
    None,
    Off(PoseError),
}

/// Added to the true pose: x and y in `map`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseError {
    pub x_m: f64,
    pub y_m: f64,
    pub yaw_deg: f64,
}

impl SceneFile {
    /// Numbers that the text leaves open are drawn.
    pub fn from_toml(text: &str) -> Result<Self, SceneError> {
        let (places, template) = {
            let table = DeTable::parse(text).map_err(told)?;
            let places = Places::of(text, table.get_ref());
            let template = Template::new(text, table.get_ref(), &places)?;
            (places, template)
        };
        let text = template.filled(|range| template.value(range, 0));
        let file: Self = toml::from_str(&text).map_err(|error| told(error_spans::nearer(error, &text)))?;
        Ok(Self { places, template: Some(template), ..file })
    }

    /// The effects with other numbers in place of what the file leaves open.
    pub(super) fn effects_with(template: &Template, value: impl Fn(&Range) -> f64) -> Result<Vec<Effect>, SceneError> {
        Ok(toml::from_str::<Self>(&template.filled(value)).map_err(told)?.effects)
    }

    /// The text with every number that was drawn once; ranges that are drawn for each frame stay. None of a file that
    /// was not read from a text.
    pub fn resolved(&self) -> Option<String> {
        Some(self.template.as_ref()?.filled_for_the_episode())
    }

    /// In which line of its text a key stands, for example `camera.lens`.
    pub fn line(&self, key: &str) -> Option<usize> {
        self.places.line(key)
    }
}

fn told(error: toml::de::Error) -> SceneError {
    SceneError::Toml(in_words(&error))
}

/// By hand, because an untagged enum could not say which key of the table is wrong.
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
