//! Settings, field and lens files: parsed, checked once, then plain data.
//!
//! [`Settings`] is the config of a robot, [`load_field`] gives the dimensions of a field, and [`load_lens`] the lens of a
//! camera from any of four file formats. Functions called `load_*` take a path, or the name of a file that is shipped in
//! `config/` and built into the program. Functions called `parse_*` take text, and a name that error messages show. Errors
//! ([`ConfigError`]) name the file and the key, and say what would be right. [`plain_file`] opens any file that a user names.
//!
//! ```rust
//! use realitysim_config::{Settings, load_field, load_lens};
//!
//! let settings = Settings::parse("field = 'kid-2020'\n[filter]\nparticles = 400", "robot.toml")?;
//! assert_eq!(settings.filter.particles, 400);
//! assert_eq!(settings.filter.iterations, 5, "a key that is not given keeps its default");
//!
//! let field = load_field(&settings.field)?;
//! assert_eq!([field.length_m, field.width_m], [9.0, 6.0]);
//! let lens = load_lens("fisheye-640")?.lens;
//! assert_eq!([lens.width(), lens.height()], [640, 480]);
//!
//! let error = Settings::parse("[filter]\nparticels = 400", "robot.toml").unwrap_err();
//! assert!(error.to_string().contains("did you mean `particles`?"));
//! # Ok::<(), realitysim_config::ConfigError>(())
//! ```

pub mod boards;
mod error;
pub mod fields;
pub mod lenses;
pub mod plain_file;
pub mod settings;
mod source;
pub mod wording;

pub use boards::{load_board, parse_board};
pub use error::{ConfigError, LensFileError};
pub use fields::{
    check_field_size, field_file, field_names, field_seen_from, load_field, load_field_of_size, parse_field,
};
pub use lenses::{
    LensFile, LensFormat, LensWanted, VisualMeshPose, camera_calibration_yaml, lens_file, lens_from_camera_info,
    lens_names, lens_seen_from, lens_text, load_lens, load_lens_for_image, parse_lens,
};
pub use settings::{
    BodyMaskFile, CameraSettings, CaptureSettings, FilterConfig, FrameNames, HeadSettings, MIN_BUDGET_MS, MotionSource,
    MountSettings, RecordingSettings, SerialPortSettings, SerialSettings, Settings, ThinningMode, ThinningSettings,
    Topics, ViewsSettings,
};
