//! In which line of the file a key stands, for messages.

use std::collections::BTreeMap;

use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Lines by key as in messages: `effect[1].figures[0].height_m`. Nothing where a scene does not come from a text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Places {
    lines: BTreeMap<String, usize>,
}

impl Places {
    pub(super) fn of(text: &str, table: &DeTable) -> Self {
        let starts: Vec<usize> =
            core::iter::once(0).chain(text.match_indices('\n').map(|(place, _)| place + 1)).collect();
        let mut places = Self::default();
        for (key, value) in table {
            let line = line_at(&starts, key.span().start);
            places.note(key.get_ref().to_string(), line, value, &starts);
        }
        places
    }

    fn note(&mut self, key: String, line: usize, value: &Spanned<DeValue>, starts: &[usize]) {
        match value.get_ref() {
            DeValue::Table(table) => {
                for (part, value) in table {
                    self.note(format!("{key}.{}", part.get_ref()), line_at(starts, part.span().start), value, starts);
                }
            }
            DeValue::Array(list) => {
                for (index, value) in list.iter().enumerate() {
                    self.note(format!("{key}[{index}]"), line_at(starts, value.span().start), value, starts);
                }
            }
            _ => {}
        }
        self.lines.insert(key, line);
    }

    /// Of the key, or of the nearest table or list that it would stand in.
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

fn line_at(starts: &[usize], place: usize) -> usize {
    starts.partition_point(|start| *start <= place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_found_in_their_lines() {
        let text =
            "a = 1\n\n[[effect]]\nkind = \"x\"\nlist = [\n  { k = 1 },\n  { k = 2 },\n]\n[[effect]]\nkind = \"y\"\n";
        let table = DeTable::parse(text).expect("TOML");
        let places = Places::of(text, table.get_ref());
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
            assert_eq!(places.line(key), Some(line), "{key}");
        }
        assert_eq!(places.line("route's duration"), None);
    }
}
