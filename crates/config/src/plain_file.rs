//! Opens files that a user names, without waiting, and reads them up to a limit.
//!
//! A path may name a pipe that nobody writes into, a device without an end, or a file far larger than expected. Anything but
//! a plain file is refused before a byte of it is read, and the error says what it is.

use std::fs::{File, FileType, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::Path;

use rustix::fs::OFlags;

/// Opens a plain file for reading, following links.
///
/// # Errors
///
/// Fails if the file cannot be opened, or is a folder, pipe, socket or device.
pub fn open(path: &Path) -> Result<File> {
    // The type is checked before opening, because opening alone may change a device, and again on the opened file.
    check_is_plain(std::fs::metadata(path)?.file_type())?;
    let without_waiting = (OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32;
    let file = OpenOptions::new().read(true).custom_flags(without_waiting).open(path)?;
    check_is_plain(file.metadata()?.file_type())?;
    Ok(file)
}

/// Reads all bytes of a plain file.
///
/// # Errors
///
/// Fails as [`open`] does, and if the file holds more than `max_bytes`.
pub fn read(path: &Path, max_bytes: u64) -> Result<Vec<u8>> {
    let file = open(path)?;
    let too_large = || Error::other(format!("it is larger than {max_bytes} bytes, and no such file is"));
    if file.metadata()?.len() > max_bytes {
        return Err(too_large());
    }
    let mut bytes = Vec::new();
    // A file may grow while it is read, and a file of the kernel (/proc) states a length of 0.
    file.take(max_bytes.saturating_add(1)).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes { Err(too_large()) } else { Ok(bytes) }
}

/// Reads the UTF-8 text of a plain file.
///
/// # Errors
///
/// Fails as [`read`] does, and if the bytes are not UTF-8.
pub fn read_text(path: &Path, max_bytes: u64) -> Result<String> {
    String::from_utf8(read(path, max_bytes)?).map_err(|_| Error::new(ErrorKind::InvalidData, "it is not UTF-8 text"))
}

/// Refuses every type of file but a plain one, with an error that names the type.
fn check_is_plain(kind: FileType) -> Result<()> {
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
    fn anything_but_a_plain_file_is_refused_and_named() {
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
        // A sparse file of two gigabytes takes no room on the disk.
        File::options().write(true).open(&path).expect("there").set_len(2 << 30).expect("longer");
        read(&path, 1 << 20).expect_err("too large");
        // A file of the kernel claims to be empty.
        assert!(!read(Path::new("/proc/self/stat"), 1 << 16).expect("readable").is_empty());
        read(Path::new("/proc/self/stat"), 3).expect_err("too large");
        fs::write(&path, [0xff, 0xfe]).expect("written");
        assert_eq!(read_text(&path, 5).expect_err("no text").kind(), ErrorKind::InvalidData);
    }
}
