//! docs/reference/limits.md says what the source says.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Right-hand sides by file (from the crate's root) and name.
type Constants = BTreeMap<(String, String), String>;

#[test]
fn the_table_of_limits_is_right_and_whole() {
    let stated = stated();
    let found: Constants = source_folders().iter().flat_map(|folder| constants(folder)).collect();
    for (key, value) in &stated {
        assert_eq!(found.get(key), Some(value), "docs/reference/limits.md: {key:?}");
    }
    let is_limit = |name: &str| name.starts_with("MAX_");
    let left_out: Vec<_> = found.keys().filter(|key| is_limit(&key.1) && !stated.contains_key(*key)).collect();
    assert!(left_out.is_empty(), "docs/reference/limits.md lacks {left_out:?}");
    assert!(found.keys().filter(|key| is_limit(&key.1)).count() > 20, "the source was not read");
}

/// Files that people or other machines name are opened by `plain_file` alone, which waits for no pipe and reads no device to its
/// end. What is listed here opens what has a fixed name, or writes.
#[test]
fn files_are_read_through_one_door() {
    const OWN: [&str; 11] = [
        "crates/config/src/plain_file.rs",
        "src/cli/host_info.rs",
        "crates/recording/src/identity.rs",
        "crates/recording/src/storage/disk.rs",
        "crates/recording/src/folder_lock.rs",
        "crates/devices/src/permission.rs",
        "crates/devices/src/serial/latency.rs",
        "crates/devices/src/serial/port.rs",
        "crates/devices/src/video_out.rs",
        "crates/recording/src/sync/source_state.rs",
        "crates/recording/src/sync/store.rs",
    ];
    const DOORS: [&str; 6] =
        ["File::open(", "fs::read(", "read_to_string(\"", "fs::read_to_string(", "OpenOptions::new()", "image::open("];
    for path in source_folders().iter().flat_map(|folder| rust_files(folder)) {
        let text = fs::read_to_string(&path).expect("a source file");
        let code = text.split("#[cfg(test)]").next().unwrap_or_default();
        let name = path.to_str().expect("a plain name");
        for door in DOORS.into_iter().filter(|_| !OWN.contains(&name)) {
            assert!(!code.contains(door), "{name}: {door}..) beside realitysim_config::plain_file");
        }
    }
}

/// Rows of the form: | `NAME` | `value` | `file` | why |
fn stated() -> Constants {
    let text = fs::read_to_string("docs/reference/limits.md").expect("docs/reference/limits.md");
    let mut rows = Constants::new();
    for line in text.lines().filter(|line| line.starts_with("| `")) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [name, value, file, why] = cells[..] else { panic!("not four cells: {line}") };
        let [name, value, file] = [name, value, file].map(|cell| cell.trim_matches('`').to_owned());
        assert!(!why.is_empty(), "no reason: {line}");
        assert!(rows.insert((file, name), value).is_none(), "stands twice: {line}");
    }
    rows
}

/// Of the program and of each library.
fn source_folders() -> Vec<PathBuf> {
    let crates =
        fs::read_dir("crates").expect("the libraries").map(|entry| entry.expect("an entry").path().join("src"));
    crates.chain([PathBuf::from("src")]).collect()
}

fn constants(folder: &Path) -> Constants {
    let mut constants = Constants::new();
    for path in rust_files(folder) {
        let text = fs::read_to_string(&path).expect("a source file");
        let file = path.to_str().expect("a plain name").to_owned();
        constants.extend(text.lines().filter_map(constant).map(|(name, value)| ((file.clone(), name), value)));
    }
    constants
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            files.push(path);
        }
    }
    files
}

/// `pub(super) const NAME: type = value;` on one line.
fn constant(line: &str) -> Option<(String, String)> {
    let (visibility, rest) = line.trim().split_once("const ")?;
    if !(visibility.is_empty() || visibility.starts_with("pub")) {
        return None;
    }
    let (name, rest) = rest.split_once(": ")?;
    let (_, value) = rest.split_once(" = ")?;
    Some((name.to_owned(), value.strip_suffix(';')?.to_owned()))
}
