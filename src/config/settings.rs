//! What a robot's config file says (`config/robot.toml`); the command line uses the same keys.
//!
//! Everything has a default that works: an empty file is a good config.

use serde::{Deserialize, Serialize};

use super::ConfigError;
use super::live::{CaptureSettings, MountSettings, SerialSettings};
use super::source::read;
use super::thinning::ThinningSettings;

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

/// Where each measurement comes from, and where tags go.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Topics {
    /// `sensor_msgs/CompressedImage` or `sensor_msgs/Image`.
    pub image: String,
    pub camera_info: String,
    pub imu: String,
    pub odometry: String,
    pub joints: String,
    pub tf: String,
    pub tf_static: String,
    pub initial_pose: String,
    /// For judging only: never an input.
    pub ground_truth: String,
}

/// REP 105 names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameNames {
    pub map: String,
    pub odom: String,
    pub base_footprint: String,
    pub base_link: String,
    pub camera_link: String,
    /// If the transforms do not know it: the `frame_id` of the images.
    pub camera_optical: String,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraSettings {
    /// A lens file (`config/cameras`) in place of the log's camera_info.
    pub lens: Option<String>,
    /// Full angle of view, in place of what the lens file states; camera_info states none.
    pub fov_deg: Option<f64>,
    /// Dark pixels of these PNGs hide the robot's own body.
    pub body_mask: Vec<BodyMaskFile>,
}

/// The first mask whose ranges hold the head is used; without ranges it fits every head pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyMaskFile {
    pub png: String,
    pub pan_deg: Option<[f64; 2]>,
    pub tilt_deg: Option<[f64; 2]>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HeadSettings {
    pub pan_joint: String,
    pub tilt_joint: String,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Model {
    #[default]
    Gauss,
    Distance,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Formula {
    #[default]
    Corrected,
    Paper,
}

/// Where the step between two frames comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionSource {
    #[default]
    Odometry,
    /// Nothing is known but how fast the robot can be.
    RandomWalk,
}

/// Which instructions the kernel uses; the result is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SimdPath {
    /// The fastest that this processor has.
    #[default]
    Auto,
    Scalar,
    Sse2,
    Avx2,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FilterConfig {
    pub model: Model,
    pub formula: Formula,
    /// N of the paper.
    pub particles: usize,
    /// T of the paper.
    pub iterations: usize,
    /// Fewer particles and iterations where fewer do: [`Self::particles`] and [`Self::iterations`] are the most.
    pub adaptive: bool,
    /// The least, while adaptive.
    pub particles_min: usize,
    /// From the decoded image to the tag; what is over is saved by fewer particles. 0: no limit.
    pub budget_ms: f64,
    /// About how many points stand for all lines of the field.
    pub line_points: usize,
    /// Scale of the exponent of Eq. 1 and 2; each formula has its own default.
    pub alpha: Option<f64>,
    pub seed: u64,
    pub motion: MotionSource,
    pub simd: SimdPath,
    /// Particles at the start, around the initial pose.
    pub initial_xy_m: f64,
    pub initial_yaw_deg: f64,
    /// Noise between the iterations of a frame; each adds `jitter_shrink` of the one before.
    pub jitter_xy_m: f64,
    pub jitter_yaw_deg: f64,
    pub jitter_shrink: f64,
    /// Half the side of the robot-centred ground table; 0: seven times the camera's height, 3 to 8 m.
    pub range_m: f64,
    /// Expected error of roll and pitch; what it moves far counts less.
    pub tilt_sigma_deg: f64,
    /// How far the distance model looks for white.
    pub nearest_reach_m: f64,
    /// Images are looked at in a copy that is this many times smaller; 0: as the lens demands.
    pub image_reduction: usize,
    /// A tag is valid when at least this share of the expected line contrast is found ...
    pub valid_share: f64,
    /// ... on at least this much certain line, in units of 10 cm ...
    pub valid_points: f64,
    /// ... and the particles are this close together.
    pub valid_spread_m: f64,
    /// Whether the pose is refined by least squares; without it the best particle is the tag.
    pub refinement: bool,
    /// A refined pose is valid up to this standard deviation along its longer axis.
    pub valid_refined_m: f64,
    /// ... and with at least this share of the line seen where the field has one.
    pub valid_explained: f64,
}

/// How wrong a step of odometry can be. Walking robots slip: 10 to 30 % is normal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionModel {
    /// Error of the distance walked, as a share of it.
    pub distance_share: f64,
    /// Error of the turn, as a share of it.
    pub turn_share: f64,
    /// Error of the direction, radians for each metre walked.
    pub turn_rad_per_m: f64,
    /// What is added each second even when standing.
    pub drift_m_per_sqrt_s: f64,
    pub drift_rad_per_sqrt_s: f64,
    /// With `motion = "random_walk"`: how fast the robot is.
    pub walk_m_per_s: f64,
    pub turn_rad_per_s: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingSettings {
    /// A segment ends after this time ...
    pub segment_s: u64,
    /// ... or this size, whichever comes first.
    pub segment_mb: u64,
    /// How often what was written is forced onto the disk.
    pub sync_interval_ms: u64,
    /// Memory for frames that wait for the disk; 0: twice what comes in `doctor`'s worst stall.
    pub queue_mb: u64,
    /// Beside it, for odometry, attitude and tags alone.
    pub reserve_mb: u64,
    /// Frames are no longer recorded with less than this free on the disk ...
    pub floor_mb: u64,
    /// ... or less than this share of it.
    pub floor_percent: f64,
    /// The most that a session may take; 0: no limit.
    pub session_mb: u64,
    /// The most that all sessions may take; 0: no limit.
    pub total_mb: u64,
    pub thinning: ThinningSettings,
}

/// How images of a database are chosen for a view, and when one is the answer itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ViewsSettings {
    /// At most so many images make a view.
    pub sources: usize,
    /// A stored image this near is given out as it is, if lens and size are those asked for ...
    pub stored_within_m: f64,
    /// ... and it looks the same way up to this angle.
    pub stored_within_deg: f64,
    /// What a metre counts when the nearest images are looked for ...
    pub metre_counts: f64,
    /// ... a radian between viewing directions ...
    pub direction_counts: f64,
    /// ... and a radian of roll.
    pub roll_counts: f64,
    /// Whether the goals of the field file stood there when the images were taken.
    pub goals: bool,
    /// Memory for decoded images.
    pub cache_mb: u64,
}

impl Settings {
    pub fn load(path: &str) -> Result<Self, ConfigError> {
        let source = read(path)?;
        Self::parse(&source.text, &source.name)
    }

    /// `name` is for messages.
    pub fn parse(text: &str, name: &str) -> Result<Self, ConfigError> {
        let file = || name.to_owned();
        let settings: Self = toml::from_str(text)
            .map_err(|error| ConfigError::Syntax { file: file(), message: error.to_string().trim_end().to_owned() })?;
        settings.check().map_err(|error| ConfigError::Value { file: file(), message: error })?;
        Ok(settings)
    }

    /// Says which key is impossible, and what would be possible.
    pub fn check(&self) -> Result<(), String> {
        let within = |key: &str, value: f64, low: f64, high: f64| {
            // NaN fails both comparisons.
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(format!("{key} is {value}: it must be {low} to {high}"))
            }
        };
        let f = &self.filter;
        within("filter.particles", f.particles as f64, 1.0, (1 << 20) as f64)?;
        within("filter.iterations", f.iterations as f64, 1.0, 1000.0)?;
        within("filter.particles_min", f.particles_min as f64, 1.0, (1 << 20) as f64)?;
        if f.budget_ms != 0.0 {
            within("filter.budget_ms", f.budget_ms, 0.1, 10_000.0)?;
        }
        within("filter.line_points", f.line_points as f64, 10.0, 100_000.0)?;
        if let Some(alpha) = f.alpha {
            within("filter.alpha (its size)", alpha.abs(), 1e-9, 1e12)?;
        }
        within("filter.initial_xy_m", f.initial_xy_m, 0.0, 100.0)?;
        within("filter.initial_yaw_deg", f.initial_yaw_deg, 0.0, 360.0)?;
        within("filter.jitter_xy_m", f.jitter_xy_m, 0.0, 10.0)?;
        within("filter.jitter_yaw_deg", f.jitter_yaw_deg, 0.0, 180.0)?;
        within("filter.jitter_shrink", f.jitter_shrink, 0.0, 1.0)?;
        if f.range_m != 0.0 {
            within("filter.range_m", f.range_m, 0.5, 50.0)?;
        }
        within("filter.tilt_sigma_deg", f.tilt_sigma_deg, 0.0, 45.0)?;
        within("filter.nearest_reach_m", f.nearest_reach_m, 0.02, 5.0)?;
        within("filter.image_reduction", f.image_reduction as f64, 0.0, 8.0)?;
        within("filter.valid_share", f.valid_share, 0.0, 1.0)?;
        within("filter.valid_points", f.valid_points, 0.0, 1e6)?;
        within("filter.valid_spread_m", f.valid_spread_m, 0.0, 100.0)?;
        within("filter.valid_refined_m", f.valid_refined_m, 0.0, 100.0)?;
        within("filter.valid_explained", f.valid_explained, 0.0, 1.0)?;
        let m = &self.motion;
        for (key, value) in [
            ("motion.distance_share", m.distance_share),
            ("motion.turn_share", m.turn_share),
            ("motion.turn_rad_per_m", m.turn_rad_per_m),
            ("motion.drift_m_per_sqrt_s", m.drift_m_per_sqrt_s),
            ("motion.drift_rad_per_sqrt_s", m.drift_rad_per_sqrt_s),
            ("motion.walk_m_per_s", m.walk_m_per_s),
            ("motion.turn_rad_per_s", m.turn_rad_per_s),
        ] {
            within(key, value, 0.0, 100.0)?;
        }
        if let Some(fov) = self.camera.fov_deg {
            within("camera.fov_deg", fov, 1.0, 360.0)?;
        }
        for (index, mask) in self.camera.body_mask.iter().enumerate() {
            for (key, range) in [("pan_deg", mask.pan_deg), ("tilt_deg", mask.tilt_deg)] {
                if range.is_some_and(|[low, high]| low.is_nan() || high.is_nan() || low > high) {
                    return Err(format!(
                        "camera.body_mask[{index}].{key}: the first number must not exceed the second"
                    ));
                }
            }
        }
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
        within("recording.segment_s", self.recording.segment_s as f64, 1.0, 86_400.0)?;
        within("recording.segment_mb", self.recording.segment_mb as f64, 1.0, 65_536.0)?;
        within("recording.queue_mb", self.recording.queue_mb as f64, 0.0, 16_384.0)?;
        within("recording.reserve_mb", self.recording.reserve_mb as f64, 1.0, 4096.0)?;
        within("recording.floor_mb", self.recording.floor_mb as f64, 0.0, 1e9)?;
        within("recording.floor_percent", self.recording.floor_percent, 0.0, 100.0)?;
        within("recording.session_mb", self.recording.session_mb as f64, 0.0, 1e9)?;
        within("recording.total_mb", self.recording.total_mb as f64, 0.0, 1e9)?;
        within("recording.sync_interval_ms", self.recording.sync_interval_ms as f64, 10.0, 60_000.0)?;
        self.recording.thinning.check()?;
        let v = &self.views;
        within("views.sources", v.sources as f64, 1.0, 16.0)?;
        within("views.stored_within_m", v.stored_within_m, 0.0, 1.0)?;
        within("views.stored_within_deg", v.stored_within_deg, 0.0, 10.0)?;
        within("views.metre_counts", v.metre_counts, 0.001, 1000.0)?;
        within("views.direction_counts", v.direction_counts, 0.0, 1000.0)?;
        within("views.roll_counts", v.roll_counts, 0.0, 1000.0)?;
        within("views.cache_mb", v.cache_mb as f64, 1.0, 65_536.0)
    }
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

impl Default for Topics {
    fn default() -> Self {
        Self {
            image: "/camera/image/compressed".into(),
            camera_info: "/camera/camera_info".into(),
            imu: "/imu/data".into(),
            odometry: "/odom".into(),
            joints: "/joint_states".into(),
            tf: "/tf".into(),
            tf_static: "/tf_static".into(),
            initial_pose: "/initialpose".into(),
            ground_truth: "/ground_truth/camera_pose".into(),
        }
    }
}

impl Default for FrameNames {
    fn default() -> Self {
        Self {
            map: "map".into(),
            odom: "odom".into(),
            base_footprint: "base_footprint".into(),
            base_link: "base_link".into(),
            camera_link: "camera_link".into(),
            camera_optical: "camera_optical_frame".into(),
        }
    }
}

impl Default for HeadSettings {
    fn default() -> Self {
        Self { pan_joint: "head_pan".into(), tilt_joint: "head_tilt".into() }
    }
}

impl Default for FilterConfig {
    fn default() -> Self {
        Self {
            model: Model::Gauss,
            formula: Formula::Corrected,
            particles: 800,
            iterations: 5,
            adaptive: true,
            particles_min: 100,
            budget_ms: 0.0,
            line_points: 350,
            alpha: None,
            seed: 1,
            motion: MotionSource::Odometry,
            simd: SimdPath::Auto,
            initial_xy_m: 0.15,
            initial_yaw_deg: 5.0,
            jitter_xy_m: 0.04,
            jitter_yaw_deg: 1.5,
            jitter_shrink: 0.6,
            range_m: 0.0,
            tilt_sigma_deg: 0.7,
            nearest_reach_m: 0.25,
            image_reduction: 0,
            valid_share: 0.35,
            valid_points: 8.0,
            valid_spread_m: 0.25,
            refinement: true,
            valid_refined_m: 0.04,
            valid_explained: 0.7,
        }
    }
}

impl Default for MotionModel {
    fn default() -> Self {
        Self {
            distance_share: 0.25,
            turn_share: 0.2,
            turn_rad_per_m: 0.2,
            drift_m_per_sqrt_s: 0.04,
            drift_rad_per_sqrt_s: 0.035,
            walk_m_per_s: 0.4,
            turn_rad_per_s: 1.0,
        }
    }
}

impl Default for ViewsSettings {
    fn default() -> Self {
        Self {
            sources: 4,
            stored_within_m: 0.005,
            stored_within_deg: 0.25,
            metre_counts: 1.0,
            direction_counts: 0.5,
            roll_counts: 0.3,
            goals: true,
            cache_mb: 512,
        }
    }
}

impl Default for RecordingSettings {
    fn default() -> Self {
        Self {
            segment_s: 60,
            segment_mb: 256,
            sync_interval_ms: 500,
            queue_mb: 0,
            reserve_mb: 64,
            floor_mb: 512,
            floor_percent: 5.0,
            session_mb: 0,
            total_mb: 0,
            thinning: ThinningSettings::default(),
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
        let text = include_str!("../../config/robot.toml");
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
