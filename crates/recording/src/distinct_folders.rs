//! Proof, by writing, that two folders are different storage.
//!
//! Device and inode numbers do not tell: an overlay, NFS, sshfs or Samba of the same machine shows a folder a second
//! time under other numbers, and what is deleted in one is gone from the other.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Beginning of the names of probe files, which are removed at once. A probe that a killed process has left means
/// nothing.
const PROBE: &str = ".storage-probe-";
/// Letters and digits behind [`PROBE`]: the name is new each time, so that no cache has an answer for it.
const RANDOM_LETTERS: usize = 32;

/// Whether a file of this name is a probe.
pub fn is_probe(name: &std::ffi::OsStr) -> bool {
    name.as_encoded_bytes().starts_with(PROBE.as_bytes())
}

/// Why the content of one folder does not count as a copy of the other's.
#[derive(Debug, Error)]
pub enum NotDistinct {
    /// Both paths lead to the same folder.
    #[error("{} is {} by another way: a file that is written into one appears in the other", .0.display(), .1.display())]
    Same(PathBuf, PathBuf),
    /// A folder could not be written or read, so that nothing is proven.
    #[error("nobody can tell whether {} is {} by another way: {folder}: {source}", .folders[0].display(), .folders[1].display(), folder = .folder.display())]
    Unproven {
        /// Both folders.
        folders: [PathBuf; 2],
        /// The folder that failed.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Proves that two folders are different storage: writes a probe file into each and looks for it in the other.
///
/// The error is [`NotDistinct::Same`] if the probe appears, and [`NotDistinct::Unproven`] if a folder cannot be written or
/// read.
pub fn prove_distinct(a: &Path, b: &Path) -> Result<(), NotDistinct> {
    let folders = || [a.to_owned(), b.to_owned()];
    let unproven = |folder: &Path| {
        let folder = folder.to_owned();
        move |source| NotDistinct::Unproven { folders: folders(), folder, source }
    };
    for (from, to) in [(a, b), (b, a)] {
        let mut probes = tempfile::Builder::new();
        let probe = probes.prefix(PROBE).rand_bytes(RANDOM_LETTERS).tempfile_in(from).map_err(unproven(from))?;
        let name = probe.path().file_name().unwrap_or_default();
        // It is looked up by name and in the listing: a network file system may cache either.
        let is_there = match to.join(name).symlink_metadata() {
            Ok(_) => true,
            Err(error) if error.kind() == io::ErrorKind::NotFound => false,
            Err(error) => return Err(unproven(to)(error)),
        };
        let mut names = std::fs::read_dir(to).map_err(unproven(to))?;
        if is_there || names.any(|entry| entry.is_ok_and(|entry| entry.file_name() == name)) {
            return Err(NotDistinct::Same(a.to_owned(), b.to_owned()));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn files_in(folder: &Path) -> usize {
        fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn two_folders_are_apart_and_one_is_not_and_nothing_is_left() {
        let (a, b) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        prove_distinct(a.path(), b.path()).unwrap();
        let link = b.path().join("link");
        std::os::unix::fs::symlink(a.path(), &link).unwrap();
        assert!(matches!(prove_distinct(a.path(), &link), Err(NotDistinct::Same(..))));
        assert!(matches!(prove_distinct(&link, a.path()), Err(NotDistinct::Same(..))));
        assert_eq!((files_in(a.path()), files_in(b.path())), (0, 1));
    }

    #[test]
    fn what_cannot_be_written_into_proves_nothing() {
        let a = tempfile::tempdir().unwrap();
        let said = prove_distinct(a.path(), &a.path().join("none")).unwrap_err().to_string();
        assert!(said.starts_with("nobody can tell whether") && said.contains("none: No such file"), "{said}");
    }
}
