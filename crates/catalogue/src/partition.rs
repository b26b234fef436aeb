//! The folders of a catalogue, in the style of Hive: `field=NAME/date=YYYY-MM-DD/robot=NAME`, which other programs read as columns.

use std::path::{Path, PathBuf};

use jiff::Timestamp;
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};

use super::error::{CatalogueError, io};
use realitysim_config::{field_names, load_field};
use realitysim_geometry::FieldDimensions;

/// Letters of a name that stay as they are in the name of a folder; programs that read such folders decode the others.
const ENCODED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'_').remove(b'.');
/// Ending of the files.
const ENDING: &str = "parquet";
/// Keys of the folders, outermost first.
const KEYS: [&str; 3] = ["field=", "date=", "robot="];

/// The folder, within a catalogue, of a session.
pub(super) fn folder_of(field: &FieldDimensions, started: Timestamp, robot: &str) -> PathBuf {
    let date = started.strftime("%Y-%m-%d").to_string();
    let values = [field_name(field), date, robot.to_owned()];
    KEYS.iter().zip(values).map(|(key, value)| format!("{key}{}", utf8_percent_encode(&value, ENCODED))).collect()
}

/// The name of a session's file: that of its folder and the start of its identity, since folders of one name may lie apart.
pub(super) fn file_name(session: &str, id: &str) -> String {
    let start = id.get(..6).unwrap_or(id);
    format!("{}-{start}.{ENDING}", utf8_percent_encode(session, ENCODED))
}

/// Name of the shipped field with these dimensions; of another field its title.
fn field_name(field: &FieldDimensions) -> String {
    let is_it = |name: &String| load_field(name).is_ok_and(|shipped| shipped.is_same_as(field));
    field_names().into_iter().find(is_it).unwrap_or_else(|| field.title.clone())
}

/// All Parquet files in the folders of a catalogue, by path. Other files and folders are passed over.
pub(super) fn files(catalogue: &Path) -> Result<Vec<PathBuf>, CatalogueError> {
    let mut folders = vec![catalogue.to_owned()];
    for key in KEYS {
        let mut next = Vec::new();
        for folder in &folders {
            let inside = entries(folder)?;
            next.extend(inside.into_iter().filter(|path| path.is_dir() && name(path).starts_with(key)));
        }
        folders = next;
    }
    let mut files = Vec::new();
    for folder in &folders {
        let inside = entries(folder)?;
        files.extend(inside.into_iter().filter(|path| path.extension().is_some_and(|ending| ending == ENDING)));
    }
    files.sort();
    Ok(files)
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, CatalogueError> {
    let listed = std::fs::read_dir(folder).map_err(io(folder))?;
    listed.map(|entry| entry.map(|entry| entry.path()).map_err(io(folder))).collect()
}

fn name(path: &Path) -> std::borrow::Cow<'_, str> {
    path.file_name().unwrap_or_default().to_string_lossy()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_of_a_robot_leads_out_of_the_catalogue() {
        let field = load_field("kid-2020").unwrap();
        let started = "2026-11-28T23:59:59Z".parse().unwrap();
        let folder = folder_of(&field, started, "../a b");
        assert_eq!(folder, Path::new("field=kid-2020/date=2026-11-28/robot=..%2Fa%20b"));
        assert_eq!(file_name("../x", "0123456789"), "..%2Fx-012345.parquet");
        let own = FieldDimensions { title: "Our hall".to_owned(), length_m: 7.0, ..field };
        assert!(folder_of(&own, started, "r").starts_with("field=Our%20hall"));
    }
}
