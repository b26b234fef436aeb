//! Tables of measurements as text (CSV), for walks that were not recorded with ROS: attitude, odometry, head angles, mount, stamps of
//! pictures.
//!
//! A table has a head that names its columns; delimiter and columns are recognized, units stand in the names. What is not
//! understood is named, and what has no unit is refused: degrees read as radians give tags that are wrong and look right.
//! Everything here works on text; files are opened by the caller.
//!
//! ```rust
//! use realitysim_log_input::tables::{Table, imu};
//!
//! let mut table = Table::parse("time;Roll [deg];Pitch [deg]\n1760000000.0;0.5;-1\n1760000000.5;1;0\n", "imu.csv")?;
//! let samples = imu::read(&mut table, None)?.rows;
//! assert_eq!(samples[1].stamp_ns - samples[0].stamp_ns, 500_000_000);
//!
//! let mut table = Table::parse("time,roll,pitch\n1760000000.0,0.5,-1\n", "imu.csv")?;
//! let error = imu::read(&mut table, None).unwrap_err().to_string();
//! assert!(error.contains("roll_deg or roll_rad"), "{error}");
//! # Ok::<(), realitysim_log_input::tables::TableError>(())
//! ```

pub mod imu;
pub mod joints;
pub mod messages;
pub mod odometry;
pub mod pictures;
pub mod stamp;
mod table;
pub mod transforms;
mod units;

pub use table::{MAX_TABLE_BYTES, Row, Table, TableError};
pub use units::AngleUnit;

use stamp::StampUnit;

/// The measurements of a table.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured<T> {
    /// One measurement a row, in the order of time.
    pub rows: Vec<T>,
    /// Unit of the stamps, and whether it was recognized by their magnitude; `None` if the table has no stamps.
    pub stamps: Option<StampUnit>,
    /// What is taken for granted, in words for people.
    pub assumed: Vec<String>,
}
