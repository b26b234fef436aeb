//! Settings from files: parsed, checked once, then plain data.
//!
//! `parse_*` take text and a name for messages; `load_*` take a path or the name of a file shipped in `config/`.

mod error;
pub mod fields;
pub mod lenses;
mod live;
pub mod settings;
mod source;
mod thinning;

pub use error::{ConfigError, LensFileError};
pub use fields::{field_names, load_field, parse_field};
pub use lenses::{
    LensFile, LensFormat, LensWanted, VisualMeshPose, lens_from_camera_info, lens_names, load_lens,
    load_lens_for_image, parse_lens,
};
pub use live::{CaptureSettings, MountSettings, SerialPortSettings, SerialSettings};
pub use settings::{
    BodyMaskFile, CameraSettings, FilterConfig, Formula, FrameNames, HeadSettings, Model, MotionModel, MotionSource,
    RecordingSettings, Settings, SimdPath, Topics, ViewsSettings,
};
pub use thinning::{ThinningMode, ThinningSettings};
