//! Writes tags as a log of their own, without the images that they belong to.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use thiserror::Error;

use realitysim_ros2::messages::{FrameTag, Header, Message, PoseWithCovarianceStamped};
use realitysim_ros2::{Durability, LogWriter, WriteError, topics};

/// Why a log of tags cannot be written.
#[derive(Debug, Error)]
pub enum TagLogError {
    /// The file cannot be made or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What went wrong.
        source: io::Error,
    },
    /// A message cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Writes an MCAP file with `/frame_tag` for each tag, and `/camera/pose` for each that is valid. The file is forced onto the disk.
///
/// # Errors
///
/// Fails if the file cannot be written.
pub fn write_tag_log(path: &Path, tags: &[FrameTag]) -> Result<(), TagLogError> {
    let failed = |source| TagLogError::Io { path: path.to_owned(), source };
    let mut log = LogWriter::new(BufWriter::new(File::create(path).map_err(failed)?))?;
    let all = log.add_channel::<FrameTag>(topics::FRAME_TAG, Durability::Volatile)?;
    let poses = log.add_channel::<PoseWithCovarianceStamped>(topics::POSE, Durability::Volatile)?;
    for (sequence, tag) in (0..).zip(tags) {
        let stamp_ns = tag.header.stamp.to_nanoseconds();
        log.write(all, sequence, stamp_ns, stamp_ns, &tag.encode())?;
        if tag.valid {
            let header = Header::at(stamp_ns, &tag.header.frame_id);
            let pose = PoseWithCovarianceStamped { header, pose: tag.pose };
            log.write(poses, sequence, stamp_ns, stamp_ns, &pose.encode())?;
        }
    }
    let file = log.finish()?.into_inner().map_err(|error| failed(error.into_error()))?;
    file.sync_all().map_err(failed)
}
