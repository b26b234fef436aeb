//! Rules on where results may be written, and file errors in words that say what to do.

use std::io::{Error, ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::input_files::with_named_files;
use super::settings::UsageError;
use crate::config::plain_file;
use crate::devices::video_out::is_device_name;
use crate::recording::{cannot_be_made, session_holding};

/// Refuses an output that can only be a mistake: inside a capture, which never changes once it is written; over a file that
/// is read (an input, or a file that an input names); or a new file among the devices.
pub fn check_output(output: &Path, inputs: &[&Path]) -> Result<(), UsageError> {
    let refused = |why: String| Err(UsageError(format!("{}: {why}: choose another place", output.display())));
    if let Some(session) = session_holding(output) {
        return refused(format!("lies in the capture {}, into which nothing else is written", session.display()));
    }
    if is_device_name(output) && output.metadata().is_err() {
        return refused("there is no such device, and no file is made in its place".to_owned());
    }
    // A path that does not exist yet lies in its nearest existing folder.
    let place = std::path::absolute(output).ok().and_then(|path| nearest_existing(&path));
    for input in &with_named_files(inputs) {
        let Ok(read) = input.canonicalize() else {
            // An input that does not exist yet would be read after it is written.
            if is_same_place(output, input) {
                return refused(format!("is {}, which is to be read", input.display()));
            }
            continue;
        };
        let is_input = output.canonicalize().is_ok_and(|output| output == read);
        let is_within = read.is_dir() && place.as_ref().is_some_and(|place| place.starts_with(&read));
        if is_input || is_within {
            return refused(format!("would be written over {}, which is read", input.display()));
        }
    }
    Ok(())
}

/// Whether two paths are the same; the files need not exist.
fn is_same_place(a: &Path, b: &Path) -> bool {
    let place = |path: &Path| {
        let path = std::path::absolute(path).ok()?;
        Some((path.parent()?.canonicalize().ok()?, path.file_name()?.to_owned()))
    };
    place(a).is_some_and(|a| place(b) == Some(a))
}

fn nearest_existing(path: &Path) -> Option<PathBuf> {
    path.ancestors().find_map(|ancestor| ancestor.canonicalize().ok())
}

pub fn cannot_read(path: &Path, error: Error) -> anyhow::Error {
    let why = match error.kind() {
        ErrorKind::NotFound => "there is no such file".to_owned(),
        ErrorKind::PermissionDenied => "its permissions do not let you read it".to_owned(),
        ErrorKind::IsADirectory => "it is a folder, and a file is needed".to_owned(),
        ErrorKind::NotADirectory => "a part of its path is a file, not a folder".to_owned(),
        _ => error.to_string(),
    };
    file_error(path, "cannot be read", why, error)
}

pub fn cannot_write(path: &Path, error: Error) -> anyhow::Error {
    let why = match error.kind() {
        ErrorKind::NotFound => "its folder does not exist: make it first".to_owned(),
        ErrorKind::PermissionDenied => "you may not write there: choose another place".to_owned(),
        ErrorKind::IsADirectory => "it is a folder: name a file".to_owned(),
        ErrorKind::NotADirectory => "a part of its path is a file, not a folder".to_owned(),
        ErrorKind::AlreadyExists => "it is a file: name a folder".to_owned(),
        ErrorKind::StorageFull => "the disk is full".to_owned(),
        ErrorKind::ReadOnlyFilesystem => "the disk can only be read".to_owned(),
        _ => error.to_string(),
    };
    file_error(path, "cannot be written", why, error)
}

/// Writes a text file; see [`write_bytes`].
pub fn write(path: &Path, content: &str) -> anyhow::Result<()> {
    write_bytes(path, content.as_bytes())
}

/// Writes a file, unless it would replace one of another kind.
pub fn write_bytes(path: &Path, content: &[u8]) -> anyhow::Result<()> {
    check_replaceable(path, content)?;
    std::fs::write(path, content).map_err(|error| cannot_write(path, error))
}

/// Bytes at the start of a file that tell its kind: the magic of a log or a picture, or the first word of a text.
const KIND_BYTES: usize = 8;
/// The same for JPEGs, which differ from each other right behind these bytes.
const JPEG_BYTES: usize = 3;

/// Refuses to replace a file that begins differently from the new content, since it was probably named by mistake. An empty
/// file, a pipe or a device may be written into.
pub fn check_replaceable(path: &Path, content: &[u8]) -> Result<(), UsageError> {
    let kind = if content.starts_with(JPEG) { JPEG_BYTES } else { KIND_BYTES };
    check_old(path, |old| old.iter().zip(content).take(kind).all(|(old, new)| old == new))
}

const JPEG: &[u8] = &[0xff, 0xd8, 0xff];

/// Refuses to replace a file unless `is_ours` accepts its first `MAX_OLD_BYTES` bytes.
pub fn check_old(path: &Path, is_ours: impl Fn(&[u8]) -> bool) -> Result<(), UsageError> {
    if !path.is_file() {
        return Ok(());
    }
    let mut old = Vec::new();
    let read = plain_file::open(path).and_then(|file| file.take(MAX_OLD_BYTES).read_to_end(&mut old));
    // A file that may not be read is not ours either.
    if read.is_ok() && (old.is_empty() || is_ours(&old)) {
        return Ok(());
    }
    let what = "is there already and not of the kind that would be written: remove it first, or choose another place";
    Err(UsageError(format!("{}: {what}", path.display())))
}

/// Bytes of an old file that are looked at: more than a line of ours.
const MAX_OLD_BYTES: u64 = 1024;

/// Makes a folder to write into, if it is not there.
pub fn make_folder(path: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(path).map_err(|error| match error.kind() {
        ErrorKind::NotFound | ErrorKind::PermissionDenied => {
            file_error(path, "cannot be written", cannot_be_made(&error), error)
        }
        _ => cannot_write(path, error),
    })
}

/// A file that is written beside its place, and moved there once it is whole. If it is dropped before, nothing is left of it.
pub struct PendingFile {
    file: std::io::BufWriter<tempfile::NamedTempFile>,
    path: PathBuf,
}

impl PendingFile {
    /// Begins a file. What is there and no plain file is refused: a rename would replace a device or a pipe.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        if path.metadata().is_ok_and(|there| !there.is_file()) {
            return Err(UsageError(format!("{}: it is no plain file: name another", path.display())).into());
        }
        // A link stays a link, to the new file.
        let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        // As for every other new file, the process's mask takes permissions away.
        let permissions = std::os::unix::fs::PermissionsExt::from_mode(0o666);
        let file = tempfile::Builder::new().prefix(".realitysim-").permissions(permissions).tempfile_in(folder);
        let file = file.map_err(|error| cannot_write(&path, error.kind().into()))?;
        Ok(Self { file: std::io::BufWriter::with_capacity(1 << 20, file), path })
    }

    /// Moves the file to its place.
    pub fn keep(self) -> anyhow::Result<()> {
        let file = self.file.into_inner().map_err(|error| cannot_write(&self.path, error.into_error()))?;
        file.as_file().sync_all().map_err(|error| cannot_write(&self.path, error))?;
        file.persist(&self.path).map_err(|error| cannot_write(&self.path, error.error))?;
        Ok(())
    }
}

impl std::io::Write for PendingFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// Makes a temporary folder, which is removed when the value goes out of scope.
pub fn temporary() -> anyhow::Result<tempfile::TempDir> {
    tempfile::tempdir().map_err(|error| cannot_write(&std::env::temp_dir(), error))
}

/// Saves a picture as PNG or JPEG, unless it would replace a file of another kind.
pub fn save(picture: &image::RgbImage, path: &Path) -> anyhow::Result<()> {
    let is_picture = |old: &[u8]| old.starts_with(b"\x89PNG") || old.starts_with(JPEG);
    check_old(path, is_picture)?;
    picture.save(path).map_err(|error| match error {
        image::ImageError::IoError(error) => cannot_write(path, error),
        image::ImageError::Unsupported(_) => {
            UsageError(format!("{}: its name must end in .png or .jpg", path.display())).into()
        }
        error => anyhow::Error::new(error).context(path.display().to_string()),
    })
}

/// An error with our reason; the system's text is kept as its cause where the reason is that text.
fn file_error(path: &Path, what: &str, why: String, error: Error) -> anyhow::Error {
    let shown = format!("{}: {what}: {why}", path.display());
    if why == error.to_string() { anyhow::Error::new(error).context(shown) } else { anyhow::Error::msg(shown) }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_words_say_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("none/x");
        let said = cannot_write(&path, fs::write(&path, "").unwrap_err()).to_string();
        assert!(said.ends_with("none/x: cannot be written: its folder does not exist: make it first"), "{said}");
        let said = cannot_read(folder.path(), fs::read(folder.path()).unwrap_err()).to_string();
        assert!(said.ends_with("cannot be read: it is a folder, and a file is needed"), "{said}");
        let picture = image::RgbImage::new(1, 1);
        let said = save(&picture, &path.with_extension("png")).unwrap_err().to_string();
        assert!(said.ends_with("its folder does not exist: make it first"), "{said}");
        let said = save(&picture, &path).unwrap_err().to_string();
        assert!(said.ends_with("none/x: its name must end in .png or .jpg"), "{said}");
    }

    #[test]
    fn a_file_of_another_kind_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("thesis.txt");
        let png = b"\x89PNG\r\n\x1a\nold".as_slice();
        for (old, new, may) in [
            (b"my thesis".as_slice(), b"a,b\n1,2\n".as_slice(), false),
            (b"stamp,x\n9,9\n", b"stamp,x\n1,2\n", true),
            (b"", b"a,b\n", true),
            (png, b"a,b\n", false),
            (b"\xff\xd8\xff\xe1Exif", b"\xff\xd8\xff\xe0JFIF", true),
            (b"\xff", b"\xff\xd8\xff\xe0JFIF", true),
        ] {
            fs::write(&path, old).unwrap();
            assert_eq!(write_bytes(&path, new).is_ok(), may, "{old:?}");
            assert_eq!(fs::read(&path).unwrap(), if may { new } else { old });
        }
        fs::write(&path, "my thesis").unwrap();
        let said = save(&image::RgbImage::new(1, 1), &path).unwrap_err().to_string();
        assert!(said.contains("thesis.txt: is there already and not of the kind"), "{said}");
    }

    #[test]
    fn no_file_is_made_among_devices() {
        let device = Path::new("/dev/video-realitysim-test");
        let said = check_output(device, &[]).unwrap_err().to_string();
        assert!(said.contains("there is no such device"), "{said}");
        check_output(Path::new("/dev/null"), &[]).unwrap();
    }

    #[test]
    fn what_is_read_is_not_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let (bag, file) = (folder.path().join("bag"), folder.path().join("bag/0.mcap"));
        fs::create_dir(&bag).unwrap();
        fs::write(&file, "").unwrap();
        for output in ["bag", "bag/x", "bag/new/x", "bag/../bag/x"] {
            let refused = check_output(&folder.path().join(output), &[&bag]).unwrap_err().to_string();
            assert!(refused.contains("bag, which is read: choose another place"), "{output}: {refused}");
        }
        check_output(&folder.path().join("bags"), &[&bag]).unwrap();
        check_output(&bag.join("x"), &[&file]).unwrap();
        check_output(&file, &[&file]).unwrap_err();
        check_output(&folder.path().join("out"), &[&folder.path().join("missing")]).unwrap();
        check_output(&folder.path().join("bag/../missing"), &[&folder.path().join("missing")]).unwrap_err();
    }
}
