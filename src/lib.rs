//! Reality Sim: real camera images for any pose on the field.
//!
//! This crate is the program: its commands ([`cli`]), the live recorder ([`live`]), the check of a robot's devices ([`doctor`]), the
//! load test of the recorder ([`soak`]), the playback to devices ([`playback`]) and messages for viewers ([`viewer_messages`]). The libraries are crates of their own under
//! `crates/`; they are re-exported here under their short names.

#[cfg(feature = "catalogue")]
pub use realitysim_catalogue as catalogue;
#[cfg(feature = "query")]
pub use realitysim_catalogue_query as catalogue_query;
pub use realitysim_config as config;
pub use realitysim_database as database;
pub use realitysim_devices as devices;
pub use realitysim_evaluation as evaluation;
pub use realitysim_geometry as geometry;
pub use realitysim_labels as labels;
pub use realitysim_localization as localization;
pub use realitysim_log_input as log_input;
pub use realitysim_recording as recording;
#[cfg(feature = "remote")]
pub use realitysim_remote as remote;
pub use realitysim_ros2 as ros2;
pub use realitysim_scene as scene;
pub use realitysim_service as service;
pub use realitysim_tagging as tagging;
pub use realitysim_views as views;
pub use realitysim_vision as vision;

pub mod cli;
pub mod doctor;
pub mod live;
pub mod playback;
pub mod soak;
pub mod viewer_messages;
