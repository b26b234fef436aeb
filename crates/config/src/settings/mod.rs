//! What a robot's config file says (`config/robot.toml`); the command line uses the same keys.
//!
//! Everything has a default that works: an empty file is a good config.

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
use super::{ConfigError, field_seen_from, lens_seen_from};
use realitysim_localization::MotionModel;

pub use camera::{BodyMaskFile, CameraSettings};
pub use filter::{FilterConfig, LEAST_BUDGET_MS, MotionSource};
pub use live::{CaptureSettings, MountSettings, SerialPortSettings, SerialSettings};
pub use names::{FrameNames, HeadSettings, Topics};
pub use recording::RecordingSettings;
pub use thinning::{ThinningMode, ThinningSettings};
pub use views::ViewsSettings;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Goes into the name of the session.
    pub robot: String,
    /// A shipped field (`config/fields`) or the path of a field file.
    pub field: String,
    pub topics: Topics,
    pub frames: FrameNames,
    pub camera: CameraSettings,
    pub capture: CaptureSettings,
    pub serial: SerialSettings,
    pub mount: MountSettings,
    pub head: HeadSettings,
    pub filter: FilterConfig,
    pub motion: MotionModel,
    pub recording: RecordingSettings,
    pub views: ViewsSettings,
}

impl Settings {
    /// Paths in the file start at its own folder.
    pub fn load(path: &str) -> Result<Self, ConfigError> {
        let source = read(path)?;
        Ok(Self::parse(&source.text, &source.name)?.seen_from(Path::new(path)))
    }

    /// What a file at `path` means by its paths.
    pub fn seen_from(mut self, path: &Path) -> Self {
        self.field = field_seen_from(path, &self.field);
        self.camera.lens = self.camera.lens.map(|lens| lens_seen_from(path, &lens));
        for BodyMaskFile { png, .. } in &mut self.camera.body_mask {
            *png = path.parent().unwrap_or(Path::new("")).join(&png).display().to_string();
        }
        self
    }

    /// `name` is for messages.
    pub fn parse(text: &str, name: &str) -> Result<Self, ConfigError> {
        let file = || name.to_owned();
        let settings: Self =
            toml::from_str(text).map_err(|error| ConfigError::Syntax { file: file(), message: in_words(&error) })?;
        settings.check().map_err(|error| ConfigError::Value { file: file(), message: error })?;
        Ok(settings)
    }

    /// Says which key is impossible, and what would be possible.
    pub fn check(&self) -> Result<(), String> {
        self.filter.check()?;
        motion::check(&self.motion)?;
        self.camera.check()?;
        let named =
            !self.robot.is_empty() && self.robot.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
        if !named || self.robot.starts_with('.') {
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

fn within(key: &str, value: f64, low: f64, high: f64) -> Result<(), String> {
    // NaN fails both comparisons.
    if value >= low && value <= high { Ok(()) } else { Err(format!("{key} is {value}: it must be {low} to {high}")) }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            robot: "robot".into(),
            field: "kid-2009".into(),
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
        // Key by key, so that none is left out; only what has no default cannot stand there.
        let stated: toml::Table = toml::from_str(text).expect("TOML");
        assert_eq!(stated, toml::Table::try_from(Settings::default()).expect("a table"));
    }

    #[test]
    fn an_unknown_or_impossible_key_is_named() {
        let said = |text: &str| Settings::parse(text, "robot.toml").expect_err("refused").to_string();
        assert!(said("[filter]\nparticels = 5").contains("particels"));
        assert!(said("[filter]\nparticles = 0").contains("filter.particles is 0: it must be 1 to"));
        assert!(said("[motion]\nturn_share = nan").contains("motion.turn_share is NaN"));
        assert!(said("robot = \"../x\"").contains("robot is \"../x\""));
        assert!(said("[filter]\nmodel = \"gaus\"").contains("gaus"));
    }

    #[test]
    fn settings_survive_a_round_trip() {
        let text = toml::to_string(&Settings::default()).expect("writable");
        assert_eq!(Settings::parse(&text, "x").expect("readable"), Settings::default());
    }
}
