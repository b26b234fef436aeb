//! The catalogue: one table of all frames of many captures, for questions that span sessions.
//!
//! A row is a frame: where its bytes lie, its stamp, its pose and how well that is known ([`CatalogueRow`]). The rows of a session
//! are one Parquet file, `field=NAME/date=YYYY-MM-DD/robot=NAME/SESSION.parquet`, so that adding a session rewrites no other.
//! Rows with like poses share a row group, so that a query for a range of poses reads few of them. DuckDB, Polars and
//! pandas read the files as they are. [`rebuild`], [`add`] and [`update`] maintain a catalogue, [`show`] compares it with its captures. The
//! schema stands in docs/reference/formats.md.
//!
//! ```rust
//! use realitysim_catalogue::{CatalogueRow, FileHead, parquet_of_rows, read_rows};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let row = CatalogueRow { x_m: Some(1.25), y_m: Some(-0.5), yaw_deg: Some(90.0), valid: true, ..CatalogueRow::default() };
//! # let folder = tempfile::tempdir()?;
//! let path = folder.path().join("frames.parquet");
//! std::fs::write(&path, parquet_of_rows(&FileHead::default(), std::slice::from_ref(&row))?)?;
//! assert_eq!(read_rows(&path)?, [row]);
//! # Ok(())
//! # }
//! ```

mod blocks;
mod capture;
mod column;
mod error;
mod file;
mod partition;
mod row;
mod store;

pub use capture::{CapturedSession, rows_of_capture};
pub use error::CatalogueError;
pub use file::{FORMAT, FileHead, PoseRange, parquet_of_rows, pruned_groups, read_head, read_rows};
pub use row::{CatalogueRow, PoseCell};
pub use store::{
    Entry, EntryState, Report, add, captures_in, catalogue_beside, catalogue_files, is_catalogue, rebuild, show, update,
};

#[cfg(test)]
mod tests;
