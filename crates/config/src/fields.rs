//! Field files in TOML. Each file in `config/fields` is built into the program as a field of that name.

use std::path::{Path, PathBuf};

use include_dir::{Dir, include_dir};

use super::ConfigError;
use super::source::Shipped;
use super::wording::in_words;
use realitysim_geometry::{Field, FieldDimensions};

static FOLDER: Dir<'static> = include_dir!("$CARGO_MANIFEST_DIR/fields");
const SHIPPED: Shipped = Shipped { kind: "field", folder: &FOLDER };

/// Returns the names of the shipped fields, in alphabetic order.
pub fn field_names() -> Vec<String> {
    SHIPPED.names()
}

/// Loads the dimensions of a field from a file, or those of a shipped field.
///
/// They are checked: [`Field::new`] accepts them.
pub fn load_field(path_or_name: &str) -> Result<FieldDimensions, ConfigError> {
    let source = SHIPPED.load(path_or_name)?;
    parse_field(&source.text, &source.name)
}

/// Loads a field as [`load_field`] does, with touchlines and goal lines where they were measured.
///
/// `size_m` is length and width between the centres of the lines, metres. Carpets of one rule book differ by centimetres, and
/// their owners measure the long lines only: the rest stays as the field's file says, relative to the goal lines.
///
/// # Errors
/// Besides those of [`load_field`]: areas, circle or marks do not fit into that size.
pub fn load_field_of_size(path_or_name: &str, size_m: Option<[f64; 2]>) -> Result<FieldDimensions, ConfigError> {
    let named = load_field(path_or_name)?;
    let Some(size_m) = size_m else { return Ok(named) };
    match Field::new(named.of_size(size_m)) {
        Ok(field) => Ok(field.dimensions().clone()),
        Err(source) => Err(ConfigError::FieldSize { field: path_or_name.to_owned(), size_m, source }),
    }
}

/// Checks a measured length and width of a field, metres; whether the areas of a field fit into it is not known here.
///
/// # Errors
/// The message says what is wrong and what would be right.
pub fn check_field_size([length_m, width_m]: [f64; 2]) -> Result<(), String> {
    let is_possible = |metres: f64| (1.0..=200.0).contains(&metres);
    if !is_possible(length_m) || !is_possible(width_m) {
        return Err(format!("{length_m} x {width_m}: length and width of a field are 1 to 200 m"));
    }
    if length_m < width_m {
        return Err(format!("{length_m} x {width_m}: the length, from goal line to goal line, comes first"));
    }
    Ok(())
}

/// Returns the file that [`load_field`] would read, or `None` if it would take a shipped field.
pub fn field_file(path_or_name: &str) -> Option<PathBuf> {
    SHIPPED.file(path_or_name)
}

/// Resolves a field that the file at `path` names: a relative path starts at the folder of that file.
pub fn field_seen_from(path: &Path, path_or_name: &str) -> String {
    SHIPPED.seen_from(path, path_or_name)
}

/// Parses and checks the text of a field file. Error messages show `name`.
pub fn parse_field(text: &str, name: &str) -> Result<FieldDimensions, ConfigError> {
    let syntax = |error: toml::de::Error| ConfigError::Syntax { file: name.to_owned(), message: in_words(&error) };
    let dimensions: FieldDimensions = toml::from_str(text).map_err(syntax)?;
    match Field::new(dimensions) {
        Ok(field) => Ok(field.dimensions().clone()),
        Err(source) => Err(ConfigError::Field { file: name.to_owned(), source }),
    }
}
