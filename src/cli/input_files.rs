//! Finds the files that a command reads: those named to it, and those that these name in turn.

use std::path::{Path, PathBuf};

use crate::config::{Settings, field_file, field_seen_from, lens_file, lens_seen_from, plain_file};
use crate::database::Contents;
use crate::evaluation::suite::Suite;
use crate::recording::{read_info, session_holding};
use crate::scene::SceneFile;

/// Largest file that is searched for names. A file that names others is a text of a few KiB; a log is not read for this.
const MAX_BYTES: u64 = 1 << 20;

/// Returns the inputs and all files that they name, directly or not: a suite's cases, a case's scene, that scene's lens.
pub fn with_named_files(inputs: &[&Path]) -> Vec<PathBuf> {
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

/// Returns the files that a file of any kind names; none if it cannot be parsed, since the command fails on it anyhow.
fn named_by(path: &Path) -> Vec<PathBuf> {
    if let Some(session) = session_holding(path) {
        return read_info(&session).map_or_else(|_| Vec::new(), |info| files_named_in(&info.settings));
    }
    if let Ok(contents) = Contents::read(path) {
        return contents.sources.into_iter().map(|source| source.path).collect();
    }
    let Some(text) = small_text(path) else { return Vec::new() };
    if let Ok(suite) = Suite::parse(&text, path) {
        return suite.files().map(Path::to_owned).collect();
    }
    if let Ok(scene) = SceneFile::from_toml(&text) {
        let field = field_file(&field_seen_from(path, &scene.scene.field));
        return field.into_iter().chain(lens_file(&lens_seen_from(path, &scene.camera.lens))).collect();
    }
    Settings::parse(&text, "").map_or_else(|_| Vec::new(), |settings| files_named_in(&settings.seen_from(path)))
}

/// Returns the files that a config names.
pub fn files_named_in(settings: &Settings) -> Vec<PathBuf> {
    let lens = settings.camera.lens.as_deref().and_then(lens_file);
    let masks = settings.camera.body_mask.iter().map(|mask| PathBuf::from(&mask.png));
    field_file(&settings.field).into_iter().chain(lens).chain(masks).collect()
}

pub fn small_text(path: &Path) -> Option<String> {
    // A pipe or a device names no files, and must not be waited for.
    plain_file::read_text(path, MAX_BYTES).ok()
}
