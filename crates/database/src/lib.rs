//! The image database: images that stay where they were recorded, found by the pose of their camera.
//!
//! The rim around [`realitysim_views`]: files, a memory map, decoded images. [`ImageDatabase`] answers requests; [`add`],
//! [`remove`], [`rebuild`] and [`verify`] keep the database, which a gallery may be reading meanwhile. Formats:
//! docs/formats.md.

mod build;
mod catalogue;
mod coverage;
mod error;
mod goals;
mod image_circle;
mod image_database;
mod index;
mod input_files;
mod kd_tree;
mod leave_one_out;
mod lit_pixels;
mod masks;
mod pixels;
mod record;
mod source_selection;
mod sources;
mod vignetting;

pub use build::{Added, Checked, Stats, add, rebuild, remove, stats, verify};
pub use catalogue::{Catalogue, Source, SourceKind, TagLimits};
pub use coverage::{coverage, coverage_picture};
pub use error::DatabaseError;
pub use image_database::{ImageDatabase, ViewQuery, ViewResult};
pub use index::{Index, Neighbour, write_index};
pub use kd_tree::Metric;
pub use leave_one_out::leave_one_out;
pub use record::Record;
