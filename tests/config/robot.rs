//! `config/robot.toml` and docs/reference/formats.md name the same keys.

use std::collections::BTreeSet;

/// Of the shipped config, those that are commented out included.
fn shipped() -> BTreeSet<String> {
    let text = std::fs::read_to_string("config/robot.toml").expect("the shipped config");
    let mut section = String::new();
    let mut keys = BTreeSet::new();
    for line in text.lines() {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            section = format!("{name}.");
        }
        let Some((key, _)) = line.trim_start_matches("# ").split_once(" = ") else { continue };
        if key.chars().all(|c| c.is_ascii_lowercase() || c == '_') {
            keys.insert(format!("{section}{key}"));
        }
    }
    keys
}

/// First column of the table in the section "Robot config"; the first key of a row says the section of all.
fn documented() -> BTreeSet<String> {
    let text = std::fs::read_to_string("docs/reference/formats.md").expect("docs/reference/formats.md");
    let section = text.split("\n## Robot config").nth(1).expect("the section").split("\n## ").next().expect("its text");
    let mut keys = BTreeSet::new();
    for row in section.lines().filter(|line| line.starts_with("| `")) {
        let cell = row.split('|').nth(1).expect("a cell");
        let names: Vec<&str> = cell.split(',').map(|name| name.trim().trim_matches('`')).collect();
        let prefix = names[0].rsplit_once('.').map_or(String::new(), |(prefix, _)| format!("{prefix}."));
        for name in names {
            let key = if name.contains('.') || prefix.is_empty() { name.to_owned() } else { format!("{prefix}{name}") };
            assert!(keys.insert(key), "docs/reference/formats.md names {name} twice");
        }
    }
    keys
}

#[test]
fn every_key_of_the_shipped_config_is_documented_and_no_other() {
    let (shipped, documented) = (shipped(), documented());
    assert!(shipped.len() > 50, "{shipped:?}");
    let only = |a: &BTreeSet<String>, b: &BTreeSet<String>| a.difference(b).cloned().collect::<Vec<_>>();
    assert_eq!(only(&shipped, &documented), [""; 0], "docs/reference/formats.md lacks these");
    assert_eq!(only(&documented, &shipped), [""; 0], "config/robot.toml lacks these");
}
