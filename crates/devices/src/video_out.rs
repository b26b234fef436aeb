//! Writes pictures to where those of a camera would come from: a V4L2 output (v4l2loopback, vivid), a new file or a pipe.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use thiserror::Error;

/// The form in which each picture is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputForm {
    /// The JPEG file as it is.
    Mjpeg,
    /// Raw pixels, two in four bytes: Y U Y V.
    Yuyv,
}

/// An open output for pictures.
pub struct VideoOut {
    writer: Box<dyn Write + Send>,
    /// The form in which it takes pictures.
    pub form: OutputForm,
}

/// Why an output cannot be opened.
#[derive(Debug, Error)]
pub enum VideoOutError {
    /// The operating system refuses to open or create it.
    #[error("{}: {source}{}", path.display(), if source.kind() == io::ErrorKind::PermissionDenied {
        " (your user must be in the group video: sudo usermod -aG video $USER)"
    } else {
        ""
    })]
    Open {
        /// The device, pipe or file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// The device takes none of the forms.
    #[error("{}: takes neither MJPG nor YUYV of {width} x {height}: is it a v4l2loopback device, and free?", path.display())]
    Format {
        /// The device.
        path: PathBuf,
        /// Width of the pictures, pixels.
        width: u32,
        /// Height of the pictures, pixels.
        height: u32,
    },
    /// The name is that of a device, and there is none.
    #[error(
        "{}: there is no such device (docs/howto/robot.md: v4l2loopback; `realitysim log info DEVICE` shows what one can), and no file is made in its \
         place", .0.display()
    )]
    NoDevice(PathBuf),
    /// There is a file already, and it is not written over.
    #[error("{}: is there already, and no file is written over: name a new file, a pipe or a V4L2 output", .0.display())]
    Taken(PathBuf),
    /// The program was built without the feature `v4l2`.
    #[error("{}: this build knows no V4L2 devices: build it with the feature v4l2", .0.display())]
    NoV4l2(PathBuf),
}

impl VideoOut {
    /// Opens an existing V4L2 device or pipe, or creates a file. `width` and `height` are those of the pictures, pixels.
    ///
    /// No file is written over, and none is created among devices.
    pub fn open(path: &Path, width: u32, height: u32) -> Result<Self, VideoOutError> {
        let opened = |source| VideoOutError::Open { path: path.to_owned(), source };
        let file = match path.metadata().map(|meta| meta.file_type()) {
            Ok(kind) if kind.is_char_device() => return open_device(path, width, height),
            Ok(kind) if kind.is_fifo() => open_pipe(path).map_err(opened)?,
            Ok(_) => return Err(VideoOutError::Taken(path.to_owned())),
            Err(_) if is_device_name(path) => return Err(VideoOutError::NoDevice(path.to_owned())),
            Err(_) => OpenOptions::new().write(true).create_new(true).open(path).map_err(opened)?,
        };
        Ok(Self { writer: Box::new(file), form: OutputForm::Mjpeg })
    }

    /// Writes one whole picture in the form [`Self::form`]. A device takes each write for a picture.
    pub fn show(&mut self, picture: &[u8]) -> io::Result<()> {
        self.writer.write_all(picture)
    }
}

/// Returns whether a path, or the link there, leads into `/dev`, where a file could only be a mistake; `/dev/shm` is allowed.
pub fn is_device_name(path: &Path) -> bool {
    let path = path.read_link().map_or_else(|_| path.to_owned(), |to| path.parent().unwrap_or(path).join(to));
    let folder = std::path::absolute(path).ok().and_then(|path| path.parent()?.canonicalize().ok());
    folder.is_some_and(|folder| folder.starts_with(DEVICES) && !folder.starts_with(SHARED_MEMORY))
}

/// Folder of the devices.
const DEVICES: &str = "/dev";
/// A folder within it that is a place for files.
const SHARED_MEMORY: &str = "/dev/shm";

/// Opens a pipe for writing. It fails at once if nobody reads from it.
fn open_pipe(path: &Path) -> io::Result<File> {
    let without_waiting = OFlags::NONBLOCK.bits() as i32;
    let file = OpenOptions::new().write(true).custom_flags(without_waiting).open(path)?;
    let flags = fcntl_getfl(&file)?;
    fcntl_setfl(&file, flags - OFlags::NONBLOCK)?;
    Ok(file)
}

impl VideoOutError {
    /// Returns whether the output is a pipe without a reader.
    pub fn nobody_reads(&self) -> bool {
        matches!(self, Self::Open { source, .. } if source.raw_os_error() == Some(Errno::NXIO.raw_os_error()))
    }
}

/// Opens a V4L2 output in the first form that it takes.
#[cfg(feature = "v4l2")]
fn open_device(path: &Path, width: u32, height: u32) -> Result<VideoOut, VideoOutError> {
    use v4l::video::Output;
    use v4l::{Device, Format, FourCC};
    let opened = |source| VideoOutError::Open { path: path.to_owned(), source };
    let device = Device::with_path(path).map_err(opened)?;
    for (code, form) in [(b"MJPG", OutputForm::Mjpeg), (b"YUYV", OutputForm::Yuyv)] {
        let mut format = Format::new(width, height, FourCC::new(code));
        // No JPEG of these dimensions is larger; raw pictures have exactly this size.
        format.size = width * height * 2;
        let given = Output::set_format(&device, &format);
        if given.is_ok_and(|given| given.fourcc == format.fourcc && (given.width, given.height) == (width, height)) {
            return Ok(VideoOut { writer: Box::new(device), form });
        }
    }
    Err(VideoOutError::Format { path: path.to_owned(), width, height })
}

#[cfg(not(feature = "v4l2"))]
fn open_device(path: &Path, _width: u32, _height: u32) -> Result<VideoOut, VideoOutError> {
    Err(VideoOutError::NoV4l2(path.to_owned()))
}

/// Converts RGB into Y U Y V by BT.601, with full range. The chroma of a pair is that of its mean; an odd last column is left out.
pub fn yuyv(rgb: &[u8], width: usize) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(rgb.len() / 3 * 2);
    for row in rgb.chunks_exact(3 * width) {
        for pair in row.chunks_exact(6) {
            let channel = |i: usize| i32::from(pair[i]);
            let luma = |i: usize| ((77 * channel(i) + 150 * channel(i + 1) + 29 * channel(i + 2) + 128) >> 8) as u8;
            let mean = |i: usize| (channel(i) + channel(i + 3) + 1) / 2;
            let (r, g, b) = (mean(0), mean(1), mean(2));
            let chroma = |sum: i32| ((sum + 32_768 + 128) >> 8).clamp(0, 255) as u8;
            let (u, v) = (chroma(-43 * r - 85 * g + 128 * b), chroma(128 * r - 107 * g - 21 * b));
            bytes.extend([luma(0), u, luma(3), v]);
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_where_the_standard_puts_them() {
        for (rgb, [y, u, v]) in [
            ([255, 255, 255], [255, 128, 128]),
            ([0, 0, 0], [0, 128, 128]),
            ([255, 0, 0], [76, 85, 255]),
            ([0, 0, 255], [29, 255, 107]),
        ] {
            let found = yuyv(&[rgb, rgb].concat(), 2);
            let near = |a: u8, b: u8| a.abs_diff(b) <= 1;
            assert!(
                near(found[0], y) && near(found[1], u) && near(found[2], y) && near(found[3], v),
                "{rgb:?}: {found:?}"
            );
        }
    }

    #[test]
    fn a_file_gets_the_pictures_one_after_the_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("video.mjpeg");
        let mut out = VideoOut::open(&path, 4, 4).expect("opened");
        out.show(b"one").and_then(|()| out.show(b"two")).expect("written");
        assert_eq!(std::fs::read(&path).expect("there"), b"onetwo");
        let said = VideoOut::open(Path::new("/dev/null"), 4, 4).err().expect("no camera").to_string();
        assert!(said.contains("/dev/null"), "{said}");
    }

    #[test]
    fn nothing_is_made_among_devices_and_nothing_written_over() {
        let refused = |path: &Path| VideoOut::open(path, 4, 4).err().expect("refused").to_string();
        let folder = tempfile::tempdir().expect("a folder");
        let device = Path::new("/dev/video-realitysim-test");
        assert!(refused(device).contains("there is no such device"));
        let link = folder.path().join("camera");
        std::os::unix::fs::symlink(device, &link).expect("linked");
        assert!(refused(&link).contains("there is no such device"));
        assert!(!device.exists(), "a file among the devices");
        let mine = folder.path().join("notes.txt");
        std::fs::write(&mine, "mine").expect("written");
        assert!(refused(&mine).contains("no file is written over"));
        assert_eq!(std::fs::read(&mine).expect("there"), b"mine");
        assert!(refused(folder.path()).contains("is there already"));
        assert!(!is_device_name(Path::new("/dev/shm/x")) && is_device_name(Path::new("/dev/../dev/x")));
    }
}
