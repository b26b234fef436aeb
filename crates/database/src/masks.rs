//! Masks of the pixels that do not show the world: PNGs in the database's folder, named by their content. Those of what stands before
//! the hall differ from image to image: see `moved.rs`.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use super::contents::{Contents, Source};
use super::error::DatabaseError;
use super::moved::MOVED;
use realitysim_config::plain_file;
use realitysim_log_input::mask;
use realitysim_recording::write_atomically;
use realitysim_vision::BodyMask;

const DARK: &str = "dark-";
const BODY: &str = "body-";

/// Writes the mask of pixels that no image has lit, and returns its file name.
pub(super) fn write_dark(folder: &Path, source: &Source, gray: Vec<u8>) -> Result<String, DatabaseError> {
    write(folder, source, DARK, gray)
}

/// Writes a mask of the robot's own body, and returns its file name.
pub(super) fn write_body(folder: &Path, source: &Source, body: &BodyMask) -> Result<String, DatabaseError> {
    write(folder, source, BODY, body.to_gray())
}

/// Writes a mask under a name made of its checksum, so that a file that an older `database.json` names is never changed.
fn write(folder: &Path, source: &Source, what: &str, gray: Vec<u8>) -> Result<String, DatabaseError> {
    let name = format!("{what}{:08x}.png", crc32fast::hash(&gray));
    let path = folder.join(&name);
    let failed = |what: String| DatabaseError::Image { path: path.clone(), what };
    let image = image::GrayImage::from_raw(source.lens.width, source.lens.height, gray);
    let image = image.ok_or_else(|| failed("does not fit the lens".to_owned()))?;
    let mut png = Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png).map_err(|error| failed(error.to_string()))?;
    if plain_file::read(&path, png.get_ref().len() as u64).ok().as_ref() != Some(png.get_ref()) {
        write_atomically(&path, png.get_ref())?;
    }
    Ok(name)
}

/// The masks of one source.
pub(super) struct Masks {
    /// The pixels that no image has lit.
    pub(super) dark: Option<BodyMask>,
    /// The pixels that show the robot's own body.
    pub(super) bodies: Vec<BodyMask>,
}

impl Masks {
    /// Reads the masks of a source of the database in `folder`.
    pub(super) fn read(folder: &Path, source: &Source) -> Result<Self, DatabaseError> {
        let read = |name: &String| {
            // A name that is an absolute path is a file outside the database; joining keeps it.
            let path = folder.join(name);
            let mask = mask(&path.display().to_string(), source.lens.width, source.lens.height);
            mask.map_err(|what| DatabaseError::Damaged { path, what })
        };
        Ok(Self {
            dark: source.dark.as_ref().map(read).transpose()?,
            bodies: source.body_masks.iter().map(read).collect::<Result<_, _>>()?,
        })
    }
}

/// Removes the masks that the contents do not name: those of removed sources and of failed additions.
///
/// A reader that has just read an older `database.json` reads it again.
pub(super) fn remove_all_but(folder: &Path, contents: &Contents) {
    let masks = |source: &Source| -> Vec<String> {
        source.dark.iter().chain(&source.body_masks).chain(&source.moved).cloned().collect()
    };
    let used: Vec<String> = contents.sources.iter().flat_map(masks).collect();
    let entries = fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    let unused = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        name.is_some_and(|name| is_mask(name) && !used.iter().any(|used| used == name))
    };
    for path in entries.map(|entry| entry.path()).filter(unused) {
        let _ = fs::remove_file(path);
    }
}

fn is_mask(name: &str) -> bool {
    let png = name.strip_suffix(".png").and_then(|name| name.strip_prefix(DARK).or_else(|| name.strip_prefix(BODY)));
    let moved = name.strip_suffix(".bin").and_then(|name| name.strip_prefix(MOVED));
    png.or(moved).is_some_and(|hash| hash.len() == 8)
}
