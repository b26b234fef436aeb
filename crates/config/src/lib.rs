//! Settings from files: parsed, checked once, then plain data.
//!
//! `parse_*` take text and a name for messages; `load_*` take a path or the name of a file shipped in `config/`.

mod error;
pub mod fields;
pub mod lenses;
pub mod plain_file;
pub mod settings;
mod source;
pub mod wording;

pub use error::{ConfigError, LensFileError};
pub use fields::{field_file, field_names, field_seen_from, load_field, parse_field};
pub use lenses::{
    LensFile, LensFormat, LensWanted, VisualMeshPose, lens_file, lens_from_camera_info, lens_names, lens_seen_from,
    load_lens, load_lens_for_image, parse_lens,
};
pub use settings::{
    BodyMaskFile, CameraSettings, CaptureSettings, FilterConfig, FrameNames, HeadSettings, LEAST_BUDGET_MS,
    MotionSource, MountSettings, RecordingSettings, SerialPortSettings, SerialSettings, Settings, ThinningMode,
    ThinningSettings, Topics, ViewsSettings,
};
