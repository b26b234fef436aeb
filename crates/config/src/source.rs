//! Reads the text of a settings file from a path, or from the files of `config/` that are built into the program.

use std::io::{self, Read};
use std::path::{Path, PathBuf};

use include_dir::Dir;

use super::ConfigError;
use crate::plain_file;

/// Largest settings file, bytes. A settings file has a few KiB; a recording passed by mistake is not read through.
const MAX_BYTES: u64 = 1 << 20;

/// A folder of `config/` whose files are built into the program.
pub(super) struct Shipped {
    /// Kind of file for messages: "field" or "camera".
    pub kind: &'static str,
    /// The folder with its files.
    pub folder: &'static Dir<'static>,
}

/// The text of a file, and what messages call the file.
pub(super) struct Source {
    /// The path, or the name if the file is shipped.
    pub name: String,
    pub text: String,
}

impl Shipped {
    /// Returns the names of the files, without `.toml`, in alphabetic order.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<_> = self.entries().map(|(name, _)| name.to_owned()).collect();
        names.sort();
        names
    }

    /// Loads a file or a shipped one; see [`Self::file`] for which of the two a text names.
    pub fn load(&self, path_or_name: &str) -> Result<Source, ConfigError> {
        if self.file(path_or_name).is_some() {
            return read(path_or_name);
        }
        match self.entries().find(|(name, _)| *name == path_or_name) {
            Some((name, text)) => Ok(Source { name: name.to_owned(), text: text.to_owned() }),
            None => Err(ConfigError::Unknown { kind: self.kind, name: path_or_name.to_owned(), known: self.names() }),
        }
    }

    /// Resolves what a file at `path` names: a relative path starts at the folder of that file, wherever the program runs.
    pub fn seen_from(&self, path: &Path, path_or_name: &str) -> String {
        let beside = path.parent().unwrap_or(Path::new("")).join(path_or_name).display().to_string();
        if self.file(&beside).is_some_and(|file| file.is_file()) || looks_like_a_path(path_or_name) {
            return beside;
        }
        path_or_name.to_owned()
    }

    /// Returns the path that a text names, or `None` if it is a shipped name.
    ///
    /// A text is a path if there is such a file, or if it contains a slash or ends as a settings file does.
    pub fn file(&self, path_or_name: &str) -> Option<PathBuf> {
        let path = Path::new(path_or_name);
        ((path.exists() && !path.is_dir()) || looks_like_a_path(path_or_name)).then(|| path.to_owned())
    }

    fn entries(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        self.folder.files().filter_map(|file| {
            let name = file.path().file_name()?.to_str()?.strip_suffix(".toml")?;
            Some((name, file.contents_utf8()?))
        })
    }
}

/// Whether a text contains a slash or backslash, or ends in `.toml`, `.yaml` or `.yml`.
fn looks_like_a_path(text: &str) -> bool {
    text.contains(['/', '\\']) || [".toml", ".yaml", ".yml"].iter().any(|ending| text.ends_with(ending))
}

/// Reads a settings file of at most [`MAX_BYTES`] bytes as UTF-8 text.
pub(super) fn read(path: &str) -> Result<Source, ConfigError> {
    let file = || path.to_owned();
    let bytes = read_at_most(path, MAX_BYTES + 1).map_err(|source| ConfigError::Read { file: file(), source })?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(ConfigError::TooLarge { file: file(), max_kib: MAX_BYTES / 1024 });
    }
    let text = String::from_utf8(bytes).map_err(|_| ConfigError::NotText { file: file() })?;
    // Windows editors put a byte order mark at the beginning.
    let text = text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text);
    Ok(Source { name: file(), text })
}

/// Reads at most `limit` bytes of a file.
fn read_at_most(path: &str, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    plain_file::open(Path::new(path))?.take(limit).read_to_end(&mut bytes)?;
    Ok(bytes)
}
