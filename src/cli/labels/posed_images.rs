//! The images of a database with their poses and the covariances of these.

use super::super::pose_covariances::PoseCovariances;
use crate::database::{DatabaseError, ImageDatabase, Record};
use crate::labels::PosedImage;

/// Folder of the images in an output, from which YOLO's programs find the labels.
pub(super) const IMAGES: &str = "images";

/// A database, and the covariances of its poses.
pub(super) struct PosedImages<'a> {
    database: &'a ImageDatabase,
    covariances: PoseCovariances,
}

impl<'a> PosedImages<'a> {
    pub(super) fn new(database: &'a ImageDatabase) -> Result<Self, DatabaseError> {
        Ok(Self { database, covariances: PoseCovariances::of(database)? })
    }

    pub(super) fn database(&self) -> &'a ImageDatabase {
        self.database
    }

    /// An image with its pose. `shown` is the mask of the decoded image.
    pub(super) fn posed<'b>(&'b self, record: &Record, shown: &'b [u8]) -> Result<PosedImage<'b>, String> {
        let camera = self.database.camera(record).ok_or_else(|| "an image without a lens".to_owned())?;
        Ok(PosedImage {
            camera,
            map_from_link: record.pose(),
            covariance: self.covariances.get(record),
            shown,
            body: self.database.body(record.source),
        })
    }
}
