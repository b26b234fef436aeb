//! Line numbers of the keys of a scene file, for error messages.

use std::collections::BTreeMap;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Lines (from 1) by key, for example `effect[1].figures[0].height_m`. Empty if the scene does not come from a text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeyLines {
    lines: BTreeMap<String, usize>,
}

impl KeyLines {
    /// Finds the lines of all keys in `text`, of which `table` is the parsed form.
    pub(super) fn find(text: &str, table: &DeTable) -> Self {
        let starts: Vec<usize> =
            core::iter::once(0).chain(text.match_indices('\n').map(|(byte, _)| byte + 1)).collect();
        let mut key_lines = Self::default();
        for (key, value) in table {
            let line = line_at(&starts, key.span().start);
            key_lines.insert(key.get_ref().to_string(), line, value, &starts);
        }
        key_lines
    }

    /// Inserts the line of a key and of all keys below it. `starts` has the byte at which each line begins.
    fn insert(&mut self, key: String, line: usize, value: &Spanned<DeValue>, starts: &[usize]) {
        match value.get_ref() {
            DeValue::Table(table) => {
                for (part, value) in table {
                    self.insert(format!("{key}.{}", part.get_ref()), line_at(starts, part.span().start), value, starts);
                }
            }
            DeValue::Array(list) => {
                for (index, value) in list.iter().enumerate() {
                    self.insert(format!("{key}[{index}]"), line_at(starts, value.span().start), value, starts);
                }
            }
            _ => {}
        }
        self.lines.insert(key, line);
    }

    /// Line of the key, or of the nearest table or list around it if the key is absent.
    pub fn line(&self, key: &str) -> Option<usize> {
        let mut key = key.split([' ', ':']).next().unwrap_or(key);
        loop {
            if let Some(line) = self.lines.get(key) {
                return Some(*line);
            }
            key = &key[..key.rfind(['.', '['])?];
        }
    }
}

/// Line number, from 1, of a byte of the text.
fn line_at(starts: &[usize], byte: usize) -> usize {
    starts.partition_point(|start| *start <= byte)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_in_their_lines() {
        let text =
            "a = 1\n\n[[effect]]\nkind = \"x\"\nlist = [\n  { k = 1 },\n  { k = 2 },\n]\n[[effect]]\nkind = \"y\"\n";
        let table = DeTable::parse(text).expect("TOML");
        let key_lines = KeyLines::find(text, table.get_ref());
        for (key, line) in [
            ("a", 1),
            ("effect[0].kind", 4),
            ("effect[0].list", 5),
            ("effect[0].list[1].k", 7),
            ("effect[0].list[1].missing", 7),
            ("effect[0].list[1].k (y)", 7),
            ("effect[1].kind", 10),
            ("effect[1].absent", 9),
        ] {
            assert_eq!(key_lines.line(key), Some(line), "{key}");
        }
        assert_eq!(key_lines.line("route's duration"), None);
    }
}
