//! Files that somebody named: opened without waiting, and read with a bound.
//!
//! A path may name a pipe that nobody writes into, a device without an end, or far more than any such file holds. What is no
//! plain file is refused in words that say what it is, before a byte of it is read.

use std::fs::{File, FileType, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

/// Opens a plain file, through links.
pub fn open(path: &Path) -> Result<File> {
    // Asked before opening, because opening alone may change a device, and once more of what was opened.
    check(std::fs::metadata(path)?.file_type())?;
    let without_waiting = (OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32;
    let file = OpenOptions::new().read(true).custom_flags(without_waiting).open(path)?;
    check(file.metadata()?.file_type())?;
    Ok(file)
}

/// All bytes of a plain file that holds at most `max_bytes`.
pub fn read(path: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let too_large = || Error::other(format!("it is larger than {max_bytes} bytes, and no such file is"));
    if file.metadata()?.len() > max_bytes {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    // A file may grow meanwhile, and one of the kernel does not say how long it is.
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes { Err(too_large()) } else { Ok(bytes) }
}

/// The text of a plain file that holds at most `max_bytes`.
pub fn read_text(path: &Path, max_bytes: u64) -> Result<String> {
    String::from_utf8(read(path, max_bytes)?).map_err(|_| Error::new(ErrorKind::InvalidData, "it is not UTF-8 text"))
}

fn check(kind: FileType) -> Result<()> {
    let found = match kind {
        kind if kind.is_file() => return Ok(()),
        kind if kind.is_dir() => return Err(ErrorKind::IsADirectory.into()),
        kind if kind.is_fifo() => "a pipe",
        kind if kind.is_socket() => "a socket",
        kind if kind.is_char_device() || kind.is_block_device() => "a device",
        _ => "not a plain file",
    };
    Err(Error::other(format!("it is {found}, and a plain file is needed")))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use rustix::fs::{CWD, FileType, Mode, mknodat};

    use super::*;

    #[test]
    fn what_is_no_plain_file_is_refused_by_what_it_is() {
        let folder = tempfile::tempdir().expect("a folder");
        let pipe = folder.path().join("pipe");
        mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).expect("a pipe");
        let socket = folder.path().join("socket");
        let _listening = std::os::unix::net::UnixListener::bind(&socket).expect("a socket");
        for (path, what) in
            [(pipe.as_path(), "a pipe"), (socket.as_path(), "a socket"), (Path::new("/dev/zero"), "a device")]
        {
            let refused = read(path, 10).expect_err("no plain file").to_string();
            assert!(refused.contains(&format!("it is {what}, and a plain file is needed")), "{refused}");
        }
        assert_eq!(read(folder.path(), 10).expect_err("a folder").kind(), ErrorKind::IsADirectory);
        assert_eq!(read(&folder.path().join("none"), 10).expect_err("missing").kind(), ErrorKind::NotFound);
    }

    #[test]
    fn a_file_is_read_up_to_its_limit_and_not_beyond() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("file");
        fs::write(&path, "12345").expect("written");
        assert_eq!(read_text(&path, 5).expect("five bytes"), "12345");
        let refused = read(&path, 4).expect_err("too large").to_string();
        assert!(refused.contains("larger than 4 bytes"), "{refused}");
        // Of two gigabytes that take no room on the disk.
        File::options().write(true).open(&path).expect("there").set_len(2 << 30).expect("longer");
        read(&path, 1 << 20).expect_err("too large");
        // Of a file that claims to be empty.
        assert!(!read(Path::new("/proc/self/stat"), 1 << 16).expect("readable").is_empty());
        read(Path::new("/proc/self/stat"), 3).expect_err("too large");
        fs::write(&path, [0xff, 0xfe]).expect("written");
        assert_eq!(read_text(&path, 5).expect_err("no text").kind(), ErrorKind::InvalidData);
    }
}
