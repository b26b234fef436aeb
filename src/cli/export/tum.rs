//! Tags as a text file that evo and other tools for trajectories read.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::bail;

use super::super::paths::{cannot_write, check_old};
use crate::ros2::messages::FrameTag;

/// Writes the valid tags. Returns their number.
pub(super) fn tum(tags: &[FrameTag], path: &Path) -> anyhow::Result<usize> {
    let failed = |error| cannot_write(path, error);
    if !tags.iter().any(|tag| tag.valid) {
        bail!("nothing was written: none of its {} tags is valid", tags.len());
    }
    check_old(path, is_tum)?;
    let mut file = BufWriter::new(File::create(path).map_err(failed)?);
    let mut written = 0;
    for tag in tags.iter().filter(|tag| tag.valid) {
        let (p, q) = (&tag.pose.pose.position, &tag.pose.pose.orientation);
        let stamp = &tag.header.stamp;
        writeln!(
            file,
            "{}.{:09} {:.6} {:.6} {:.6} {:.9} {:.9} {:.9} {:.9}",
            stamp.sec, stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w
        )
        .map_err(failed)?;
        written += 1;
    }
    file.flush().map_err(failed)?;
    Ok(written)
}

/// Whether a file begins with a line as `tum` writes it.
fn is_tum(old: &[u8]) -> bool {
    let line = String::from_utf8_lossy(old).lines().next().unwrap_or_default().to_owned();
    line.split(' ').filter(|number| number.parse::<f64>().is_ok()).count() == TUM_COLUMNS
}

const TUM_COLUMNS: usize = 8;
