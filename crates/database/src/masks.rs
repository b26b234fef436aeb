//! What of a source's images shows nothing: PNGs beside the index, named by their content.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use super::catalogue::{Catalogue, Source};
use super::error::DatabaseError;
use realitysim_config::plain_file;
use realitysim_log_input::mask;
use realitysim_recording::write_atomically;
use realitysim_vision::BodyMask;

const DARK: &str = "dark-";
const BODY: &str = "body-";

/// Where no image was ever lit.
pub(super) fn write_dark(folder: &Path, source: &Source, gray: Vec<u8>) -> Result<String, DatabaseError> {
    write(folder, source, DARK, gray)
}

/// The robot's own.
pub(super) fn write_body(folder: &Path, source: &Source, body: &BodyMask) -> Result<String, DatabaseError> {
    write(folder, source, BODY, body.to_gray())
}

/// The same content has the same name: what an older catalogue names stays as it is, whoever is reading it.
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

/// Of one source, read: where it is dark, and its bodies.
pub(super) struct Masks {
    pub(super) dark: Option<BodyMask>,
    pub(super) bodies: Vec<BodyMask>,
}

impl Masks {
    pub(super) fn read(folder: &Path, source: &Source) -> Result<Self, DatabaseError> {
        let read = |name: &String| {
            // One of a capture that has none of its own keeps its whole path.
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

/// Those of sources that are gone, and of additions that came to nothing; whoever has just read an older catalogue reads it again.
pub(super) fn remove_all_but(folder: &Path, catalogue: &Catalogue) {
    let masks = |source: &Source| source.dark.iter().chain(&source.body_masks).cloned().collect::<Vec<String>>();
    let used: Vec<String> = catalogue.sources.iter().flat_map(masks).collect();
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
    let hash = name.strip_prefix(DARK).or_else(|| name.strip_prefix(BODY));
    hash.and_then(|rest| rest.strip_suffix(".png")).is_some_and(|hash| hash.len() == 8)
}
