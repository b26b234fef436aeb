//! Measures how long disk writes take, and what a recording loses with such a disk.

use std::fs::File;
use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::time::Instant;

use rustix::fs::{Mode, OFlags};

use super::{Finding, bad, good, image_size};
use crate::config::Settings;
use crate::recording::storage::Disk;
use crate::recording::{DiskMeasured, loss_bound_ms};

/// Size of one write: about a second of camera frames. There are enough writes to tell the worst from the typical.
const DISK_BLOCK_BYTES: usize = 512 << 10;
const DISK_BLOCKS: usize = 40;
/// Longest recording that a power cut may cost, milliseconds, for a good finding.
const ACCEPTED_LOSS_MS: f64 = 1000.0;

pub(super) fn check_disk(settings: &Settings, captures: &Path) -> Finding {
    let what = format!("disk {}", captures.display());
    let [typical_ms, worst_ms] = match measure_writes_ms(captures) {
        Err(error) => return bad(what, error.to_string(), "the recorder's user must be able to write there"),
        Ok(measured) => measured,
    };
    let measured = DiskMeasured { block_bytes: DISK_BLOCK_BYTES as u64, typical_ms, worst_ms };
    // The recorder sizes its queue from this measurement; without it, it assumes a usual disk.
    let noted = measured.save(&Disk, captures).map_or_else(|error| format!(" ({error})"), |()| String::new());
    let bytes_per_s = image_size(settings).map_or(0, |size| settings.capture.bytes_per_s(size));
    let queue_mb = measured.queue_mb(&settings.recording, bytes_per_s);
    let cut_ms = loss_bound_ms(settings.recording.sync_interval_ms as f64, worst_ms);
    let said = format!(
        "512 KiB to the disk: {typical_ms:.1} ms, the worst of {DISK_BLOCKS} {worst_ms:.1} ms: {queue_mb} MiB for frames that wait, \
         and a power cut costs at most {:.1} s{noted}",
        cut_ms * 1e-3
    );
    if !measured.fits(queue_mb, bytes_per_s) {
        bad(
            what,
            said,
            "a faster disk, a larger recording.queue_mb or fewer frames: they are dropped while it stands still",
        )
    } else if cut_ms > ACCEPTED_LOSS_MS {
        bad(what, said, "a faster disk: with this one, a power cut costs more than a second")
    } else {
        good(what, said)
    }
}

fn measure_writes_ms(captures: &Path) -> std::io::Result<[f64; 2]> {
    make_folder(captures)?;
    // A new file only: the doctor may run as root in a folder where others can place links.
    let path = captures.join(format!("doctor-{}.tmp", std::process::id()));
    let mut file = File::create_new(&path)?;
    let mut times = Vec::with_capacity(DISK_BLOCKS);
    let written = (|| {
        let block = vec![0x5a; DISK_BLOCK_BYTES];
        for _ in 0..DISK_BLOCKS {
            let start = Instant::now();
            file.write_all(&block)?;
            file.sync_data()?;
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        Ok(())
    })();
    let _ = std::fs::remove_file(&path);
    let failed: std::io::Result<()> = written;
    failed?;
    times.sort_by(f64::total_cmp);
    Ok([times[DISK_BLOCKS / 2], times[DISK_BLOCKS - 1]])
}

/// Makes the captures folder and gives each new folder the owner of the existing folder above: the recorder's user, even if
/// root runs this.
fn make_folder(captures: &Path) -> std::io::Result<()> {
    let captures = std::path::absolute(captures)?;
    let above = captures.ancestors().find(|folder| folder.exists()).and_then(|folder| folder.metadata().ok());
    let missing: Vec<&Path> = captures.ancestors().take_while(|folder| !folder.exists()).collect();
    std::fs::create_dir_all(&captures)?;
    if let Some(above) = above {
        for made in missing {
            // Only root may give folders away, and only root needs to. `DIRECTORY` and `NOFOLLOW` refuse a path that was
            // replaced meanwhile.
            let folder = rustix::fs::open(made, OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC, Mode::empty());
            let _ = folder.map(|folder| std::os::unix::fs::fchown(folder, Some(above.uid()), Some(above.gid())));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_disk_is_measured_in_a_new_file_whatever_lies_there() {
        let room = tempfile::tempdir().unwrap();
        let precious = room.path().join("precious");
        std::fs::write(&precious, "mine").unwrap();
        let captures = room.path().join("captures");
        std::fs::create_dir(&captures).unwrap();
        std::os::unix::fs::symlink(&precious, captures.join(format!("doctor-{}.tmp", std::process::id()))).unwrap();
        assert!(measure_writes_ms(&captures).is_err());
        assert_eq!(std::fs::read(&precious).unwrap(), b"mine");
    }

    #[test]
    fn a_folder_that_root_makes_belongs_to_whom_the_one_above_does() {
        let room = tempfile::tempdir().unwrap();
        let owner = if rustix::process::geteuid().is_root() { 4711 } else { rustix::process::geteuid().as_raw() };
        std::os::unix::fs::chown(room.path(), Some(owner), None).unwrap();
        make_folder(&room.path().join("captures/deep")).unwrap();
        for folder in ["captures", "captures/deep"] {
            assert_eq!(room.path().join(folder).metadata().unwrap().uid(), owner);
        }
    }
}
