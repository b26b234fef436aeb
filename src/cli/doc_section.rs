//! A section of a document that a command writes. It lies between two marks, and the rest of the document stays as it is.

use std::path::{Path, PathBuf};

use super::paths;
use super::settings::UsageError;
use crate::config::plain_file;

/// Largest document that is read; a page of documentation takes some ten KiB.
const MAX_DOCUMENT_BYTES: u64 = 16 << 20;

/// A document with a section for the output of `realitysim NAME`.
pub struct Section {
    path: PathBuf,
    text: String,
    /// Byte range between the marks.
    inside: std::ops::Range<usize>,
}

fn marks(name: &str) -> [String; 2] {
    ["begin", "end"].map(|which| format!("<!-- {which}: realitysim {name} -->"))
}

impl Section {
    /// Reads the document. Called before long work, so that a document without marks is refused at once.
    pub fn open(path: &Path, name: &str) -> anyhow::Result<Self> {
        let text = plain_file::read_text(path, MAX_DOCUMENT_BYTES).map_err(|error| paths::cannot_read(path, error))?;
        let inside = find(&text, name).map_err(|error| UsageError(format!("{}: {error}", path.display())))?;
        Ok(Self { path: path.to_owned(), text, inside })
    }

    /// Replaces the section.
    pub fn write(&self, content: &str) -> anyhow::Result<()> {
        let (before, after) = (&self.text[..self.inside.start], &self.text[self.inside.end..]);
        paths::write(&self.path, &format!("{before}\n\n{}\n\n{after}", content.trim_matches('\n')))
    }

    /// Path of a file in the document's folder, for its pictures.
    pub fn beside(&self, name: &str) -> PathBuf {
        self.path.with_file_name(name)
    }
}

fn find(text: &str, name: &str) -> Result<std::ops::Range<usize>, String> {
    let [begin, end] = marks(name);
    let wanted = || format!("the section to write must stand between a line {begin} and a line {end}, once each");
    let once = |mark: &str| {
        let mut found = text.match_indices(mark);
        let place = found.next().map(|(place, _)| place);
        place.filter(|_| found.next().is_none()).ok_or_else(wanted)
    };
    let (start, stop) = (once(&begin)? + begin.len(), once(&end)?);
    if start <= stop { Ok(start..stop) } else { Err(wanted()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_section_changes() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.md");
        let text =
            "before\n\n<!-- begin: realitysim measure cost -->\nold\n<!-- end: realitysim measure cost -->\n\nafter\n";
        std::fs::write(&path, text).expect("written");
        for _ in 0..2 {
            Section::open(&path, "measure cost").expect("a section").write("new\n").expect("written");
            let expected = "before\n\n<!-- begin: realitysim measure cost -->\n\nnew\n\n<!-- end: realitysim measure cost -->\n\nafter\n";
            assert_eq!(std::fs::read_to_string(&path).expect("readable"), expected);
        }
    }

    #[test]
    fn a_document_without_its_marks_is_refused() {
        let [begin, end] = marks("measure cost");
        for text in [String::new(), begin.clone(), format!("{end}{begin}"), format!("{begin}{begin}{end}")] {
            let refused = find(&text, "measure cost").expect_err("refused");
            assert!(refused.contains(&begin) && refused.contains(&end), "{text}");
        }
        assert_eq!(find(&format!("{begin}{end}"), "measure cost"), Ok(begin.len()..begin.len()));
    }
}
