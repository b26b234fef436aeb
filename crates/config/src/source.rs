//! Where the text of a settings file comes from: a path, or a file shipped in `config/` and built into the program.

use std::io::{self, Read};
use std::path::{Path, PathBuf};

use include_dir::Dir;

use super::ConfigError;
use crate::plain_file;

/// A settings file is a few KiB; whoever passes a recording by mistake should not wait for it to be read.
const MAX_BYTES: u64 = 1 << 20;

/// A folder of `config/`.
pub(super) struct Shipped {
    /// For messages: "field", "camera".
    pub kind: &'static str,
    pub folder: &'static Dir<'static>,
}

pub(super) struct Source {
    /// For messages: the path, or the name if shipped.
    pub name: String,
    pub text: String,
}

impl Shipped {
    /// The names of the files, without `.toml`, in alphabetic order.
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<_> = self.entries().map(|(name, _)| name.to_owned()).collect();
        names.sort();
        names
    }

    /// What exists as a file, or looks like a path by its ending or a folder, is a path; the rest is a shipped name.
    pub fn load(&self, path_or_name: &str) -> Result<Source, ConfigError> {
        if self.file(path_or_name).is_some() {
            return read(path_or_name);
        }
        match self.entries().find(|(name, _)| *name == path_or_name) {
            Some((name, text)) => Ok(Source { name: name.to_owned(), text: text.to_owned() }),
            None => Err(ConfigError::Unknown { kind: self.kind, name: path_or_name.to_owned(), known: self.names() }),
        }
    }

    /// What a file at `path` means by this: in a file, paths start at its own folder, wherever it is read.
    pub fn seen_from(&self, path: &Path, path_or_name: &str) -> String {
        let beside = path.parent().unwrap_or(Path::new("")).join(path_or_name).display().to_string();
        if self.file(&beside).is_some_and(|file| file.is_file()) || looks_like_a_path(path_or_name) {
            return beside;
        }
        path_or_name.to_owned()
    }

    /// The file that is read for it; none of a shipped name.
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

fn looks_like_a_path(text: &str) -> bool {
    text.contains(['/', '\\']) || [".toml", ".yaml", ".yml"].iter().any(|ending| text.ends_with(ending))
}

pub(super) fn read(path: &str) -> Result<Source, ConfigError> {
    let file = || path.to_owned();
    let bytes = read_at_most(path, MAX_BYTES + 1).map_err(|source| ConfigError::Read { file: file(), source })?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(ConfigError::TooLarge { file: file(), max_kib: MAX_BYTES / 1024 });
    }
    let text = String::from_utf8(bytes).map_err(|_| ConfigError::NotText { file: file() })?;
    // Windows editors put a byte order mark in front.
    let text = text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text);
    Ok(Source { name: file(), text })
}

fn read_at_most(path: &str, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    plain_file::open(Path::new(path))?.take(limit).read_to_end(&mut bytes)?;
    Ok(bytes)
}
