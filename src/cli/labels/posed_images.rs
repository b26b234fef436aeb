//! The images of a database with their poses and the covariances of these.

use std::collections::HashMap;

use crate::database::{self, DatabaseError, ImageDatabase, Record};
use crate::labels::{PoseCovariance, PosedImage};

/// Folder of the images in an output, from which YOLO's programs find the labels.
pub(super) const IMAGES: &str = "images";

/// A database, and the covariances of its poses.
pub(super) struct PosedImages<'a> {
    database: &'a ImageDatabase,
    /// Covariances of the poses by stamp, for each source.
    covariances: Vec<HashMap<i64, [f64; 36]>>,
}

impl<'a> PosedImages<'a> {
    pub(super) fn new(database: &'a ImageDatabase) -> Result<Self, DatabaseError> {
        let sources = database.contents().sources.iter();
        let covariances = sources.map(database::covariances).collect::<Result<_, _>>()?;
        Ok(Self { database, covariances })
    }

    pub(super) fn database(&self) -> &'a ImageDatabase {
        self.database
    }

    /// An image with its pose. `shown` is the mask of the decoded image.
    pub(super) fn posed<'b>(&'b self, record: &Record, shown: &'b [u8]) -> Result<PosedImage<'b>, String> {
        let camera = self.database.camera(record).ok_or_else(|| "an image without a lens".to_owned())?;
        let covariance = self.covariance(record);
        Ok(PosedImage {
            camera,
            map_from_link: record.pose(),
            covariance,
            shown,
            body: self.database.body(record.source),
        })
    }

    /// The covariance of the tag, or what the database knows of it.
    fn covariance(&self, record: &Record) -> PoseCovariance {
        let known = self.covariances.get(record.source as usize).and_then(|of_source| of_source.get(&record.stamp_ns));
        let tag = record.tag();
        let fallback = || PoseCovariance::isotropic(tag.position_m, tag.rotation_rad);
        known.and_then(PoseCovariance::from_rows).unwrap_or_else(fallback)
    }
}
