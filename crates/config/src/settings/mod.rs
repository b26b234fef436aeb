//! The settings of a robot, as in `config/robot.toml`; the command line uses the same keys.
//!
//! Every key has a default that works, so an empty file is a valid config. docs/reference/formats.md lists keys, ranges and meanings.

mod camera;
mod filter;
mod live;
mod motion;
mod names;
mod recording;
mod thinning;
mod views;

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::source::read;
use super::wording::in_words;
use super::{ConfigError, check_field_size, field_seen_from, lens_seen_from, load_field_of_size};
use realitysim_geometry::FieldDimensions;
use realitysim_localization::MotionModel;

pub use camera::{BodyMaskFile, CameraSettings};
pub use filter::{FilterConfig, MIN_BUDGET_MS, MotionSource};
pub use live::{CaptureSettings, MountSettings, SerialPortSettings, SerialSettings};
pub use names::{FrameNames, HeadSettings, Topics};
pub use recording::RecordingSettings;
pub use thinning::{ThinningMode, ThinningSettings};
pub use views::ViewsSettings;

/// All settings of a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Name of the robot, which becomes part of the name of each session's folder.
    pub robot: String,
    /// Name of a shipped field (`config/fields`), or path of a field file.
    pub field: String,
    /// Length and width of the field between the centres of its lines, metres, where they were measured and differ from
    /// those of `field`.
    pub field_size_m: Option<[f64; 2]>,
    /// Topics of the measurements.
    pub topics: Topics,
    /// Names of the coordinate frames.
    pub frames: FrameNames,
    /// Lens and body masks.
    pub camera: CameraSettings,
    /// How a live camera is operated.
    pub capture: CaptureSettings,
    /// Serial ports of microcontrollers.
    pub serial: SerialSettings,
    /// Where the camera is mounted on the robot.
    pub mount: MountSettings,
    /// Joints of the head.
    pub head: HeadSettings,
    /// How frames are located.
    pub filter: FilterConfig,
    /// Errors of odometry.
    pub motion: MotionModel,
    /// How sessions are recorded.
    pub recording: RecordingSettings,
    /// How views are made of a database.
    pub views: ViewsSettings,
}

impl Settings {
    /// Loads and checks a config file. Relative paths in it start at its own folder.
    pub fn load(path: &str) -> Result<Self, ConfigError> {
        let source = read(path)?;
        Ok(Self::parse(&source.text, &source.name)?.seen_from(Path::new(path)))
    }

    /// Resolves the relative paths of a config file at `path`: they start at its folder.
    pub fn seen_from(mut self, path: &Path) -> Self {
        self.field = field_seen_from(path, &self.field);
        self.camera.lens = self.camera.lens.map(|lens| lens_seen_from(path, &lens));
        for BodyMaskFile { png, .. } in &mut self.camera.body_mask {
            *png = path.parent().unwrap_or(Path::new("")).join(&png).display().to_string();
        }
        self
    }

    /// Parses and checks the text of a config file. Error messages show `name`.
    pub fn parse(text: &str, name: &str) -> Result<Self, ConfigError> {
        let file = || name.to_owned();
        let settings: Self =
            toml::from_str(text).map_err(|error| ConfigError::Syntax { file: file(), message: in_words(&error) })?;
        settings.check().map_err(|error| ConfigError::Value { file: file(), message: error })?;
        Ok(settings)
    }

    /// Loads the field: `field`, with touchlines and goal lines at `field_size_m` if that is given.
    pub fn field_dimensions(&self) -> Result<FieldDimensions, ConfigError> {
        load_field_of_size(&self.field, self.field_size_m)
    }

    /// Whether the text of a config file names a field. Text that is no TOML names none.
    ///
    /// The default field is a guess, and only its user knows whether it is right.
    pub fn names_field(text: &str) -> bool {
        toml::from_str::<toml::Table>(text).is_ok_and(|table| table.contains_key("field"))
    }

    /// Checks every value that has a range.
    ///
    /// # Errors
    ///
    /// The message names the first key that is out of its range, and the range.
    pub fn check(&self) -> Result<(), String> {
        if let Some(size_m) = self.field_size_m {
            check_field_size(size_m).map_err(|error| format!("field_size_m is {error}"))?;
        }
        self.filter.check()?;
        motion::check(&self.motion)?;
        self.camera.check()?;
        let is_valid_name =
            !self.robot.is_empty() && self.robot.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
        if !is_valid_name || self.robot.starts_with('.') {
            return Err(format!(
                "robot is {:?}: use letters, digits, - and _: it becomes part of a folder's name",
                self.robot
            ));
        }
        self.capture.check()?;
        self.serial.check()?;
        self.mount.check()?;
        self.recording.check()?;
        self.views.check()
    }
}

/// Checks that a number lies between two bounds, both included.
fn check_range(key: &str, value: f64, low: f64, high: f64) -> Result<(), String> {
    // NaN fails both comparisons, so it is refused.
    if value >= low && value <= high { Ok(()) } else { Err(format!("{key} is {value}: it must be {low} to {high}")) }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            robot: "robot".into(),
            field: "kid-2009".into(),
            field_size_m: None,
            topics: Topics::default(),
            frames: FrameNames::default(),
            camera: CameraSettings::default(),
            capture: CaptureSettings::default(),
            serial: SerialSettings::default(),
            mount: MountSettings::default(),
            head: HeadSettings::default(),
            filter: FilterConfig::default(),
            motion: MotionModel::default(),
            recording: RecordingSettings::default(),
            views: ViewsSettings::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_file_is_a_good_config() {
        assert_eq!(Settings::parse("", "x").expect("defaults"), Settings::default());
        Settings::default().check().expect("possible defaults");
    }

    #[test]
    fn the_shipped_config_states_every_default() {
        let text = include_str!("../../../../config/robot.toml");
        assert_eq!(Settings::parse(text, "robot.toml").expect("a good config"), Settings::default());
        // The tables agree key by key, so none is left out; only keys without a default cannot be in the file.
        let stated: toml::Table = toml::from_str(text).expect("TOML");
        assert_eq!(stated, toml::Table::try_from(Settings::default()).expect("a table"));
    }

    #[test]
    fn an_unknown_or_impossible_key_is_named() {
        let error_of = |text: &str| Settings::parse(text, "robot.toml").expect_err("refused").to_string();
        assert!(error_of("[filter]\nparticels = 5").contains("particels"));
        assert!(error_of("[filter]\nparticles = 0").contains("filter.particles is 0: it must be 1 to"));
        assert!(error_of("[motion]\nturn_share = nan").contains("motion.turn_share is NaN"));
        assert!(error_of("robot = \"../x\"").contains("robot is \"../x\""));
        assert!(error_of("[filter]\nmodel = \"gaus\"").contains("gaus"));
    }

    #[test]
    fn settings_survive_a_round_trip() {
        let text = toml::to_string(&Settings::default()).expect("writable");
        assert_eq!(Settings::parse(&text, "x").expect("readable"), Settings::default());
    }
}
