//! How well the poses of a database's images are known.

use std::collections::HashMap;

use crate::database::{self, DatabaseError, ImageDatabase, Record};
use crate::labels::PoseCovariance;

/// Covariances of the poses by stamp, for each source of a database.
pub struct PoseCovariances(Vec<HashMap<i64, [f64; 36]>>);

impl PoseCovariances {
    /// Reads the covariances of all tags that the database's images are from.
    pub fn of(database: &ImageDatabase) -> Result<Self, DatabaseError> {
        database.contents().sources.iter().map(database::covariances).collect::<Result<_, _>>().map(Self)
    }

    /// The covariance of the tag, or what the database knows of it.
    pub fn get(&self, record: &Record) -> PoseCovariance {
        let known = self.0.get(record.source as usize).and_then(|of_source| of_source.get(&record.stamp_ns));
        let tag = record.tag();
        let fallback = || PoseCovariance::isotropic(tag.position_m, tag.rotation_rad);
        known.and_then(PoseCovariance::from_rows).unwrap_or_else(fallback)
    }
}
