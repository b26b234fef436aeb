//! Field files: `config/fields/*.toml`. A new file there is a new field.

use std::path::{Path, PathBuf};

use include_dir::{Dir, include_dir};

use super::ConfigError;
use super::source::Shipped;
use super::wording::in_words;
use realitysim_geometry::{Field, FieldDimensions};

static FOLDER: Dir<'static> = include_dir!("$CARGO_MANIFEST_DIR/../../config/fields");
const SHIPPED: Shipped = Shipped { kind: "field", folder: &FOLDER };

/// The shipped fields.
pub fn field_names() -> Vec<String> {
    SHIPPED.names()
}

/// The dimensions in a file, or of a shipped field; checked, so [`Field::new`] accepts them.
pub fn load_field(path_or_name: &str) -> Result<FieldDimensions, ConfigError> {
    let source = SHIPPED.load(path_or_name)?;
    parse_field(&source.text, &source.name)
}

/// The file that is read for it; none of a shipped field.
pub fn field_file(path_or_name: &str) -> Option<PathBuf> {
    SHIPPED.file(path_or_name)
}

/// What a file at `path` means by this: its paths start at its own folder.
pub fn field_seen_from(path: &Path, path_or_name: &str) -> String {
    SHIPPED.seen_from(path, path_or_name)
}

/// The same from text; `name` is for messages.
pub fn parse_field(text: &str, name: &str) -> Result<FieldDimensions, ConfigError> {
    let syntax = |error: toml::de::Error| ConfigError::Syntax { file: name.to_owned(), message: in_words(&error) };
    let dimensions: FieldDimensions = toml::from_str(text).map_err(syntax)?;
    match Field::new(dimensions) {
        Ok(field) => Ok(field.dimensions().clone()),
        Err(source) => Err(ConfigError::Field { file: name.to_owned(), source }),
    }
}
