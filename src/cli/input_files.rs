//! What a command reads: the files that are named to it, and those that these name.

use std::path::{Path, PathBuf};

use crate::config::{Settings, field_file, field_seen_from, lens_file, lens_seen_from, plain_file};
use crate::database::Catalogue;
use crate::evaluation::suite::Suite;
use crate::recording::{read_info, session_holding};
use crate::scene::SceneFile;

/// A file that names others is a text of a few KiB; a log is not read for this.
const MAX_BYTES: u64 = 1 << 20;

/// These and all that they name, by whatever way: a suite's cases, a case's scene, that scene's lens.
pub fn with_what_they_name(inputs: &[&Path]) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = Vec::new();
    let mut next: Vec<PathBuf> = inputs.iter().map(|input| input.to_path_buf()).collect();
    while let Some(path) = next.pop() {
        if !all.contains(&path) {
            next.extend(named_by(&path));
            all.push(path);
        }
    }
    all
}

/// Of whatever kind it is; nothing of a file that cannot be understood, which no command goes on with.
fn named_by(path: &Path) -> Vec<PathBuf> {
    if let Some(session) = session_holding(path) {
        return read_info(&session).map_or_else(|_| Vec::new(), |info| files_of(&info.settings));
    }
    if let Ok(catalogue) = Catalogue::read(path) {
        return catalogue.sources.into_iter().map(|source| source.path).collect();
    }
    let Some(text) = small_text(path) else { return Vec::new() };
    if let Ok(suite) = Suite::parse(&text, path) {
        return suite.files().map(Path::to_owned).collect();
    }
    if let Ok(scene) = SceneFile::from_toml(&text) {
        let field = field_file(&field_seen_from(path, &scene.scene.field));
        return field.into_iter().chain(lens_file(&lens_seen_from(path, &scene.camera.lens))).collect();
    }
    Settings::parse(&text, "").map_or_else(|_| Vec::new(), |settings| files_of(&settings.seen_from(path)))
}

/// What a config names.
pub fn files_of(settings: &Settings) -> Vec<PathBuf> {
    let lens = settings.camera.lens.as_deref().and_then(lens_file);
    let masks = settings.camera.body_mask.iter().map(|mask| PathBuf::from(&mask.png));
    field_file(&settings.field).into_iter().chain(lens).chain(masks).collect()
}

fn small_text(path: &Path) -> Option<String> {
    // Nothing to wait for: a pipe or a device names no files.
    plain_file::read_text(path, MAX_BYTES).ok()
}
