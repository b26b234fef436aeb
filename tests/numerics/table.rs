//! docs/reference/numerics.md says what the tests say: each test that it names exists, and each figure is the one that its test
//! asserts.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

const DOCUMENT: &str = "docs/reference/numerics.md";
/// Every test of this folder has its row.
const FOLDER: &str = "tests/numerics";

/// One test: where it stands, and the figures that it asserts, as (number, unit).
struct Test {
    file: PathBuf,
    figures: BTreeSet<(String, String)>,
}

#[test]
fn the_table_of_numerics_is_right_and_whole() {
    let tests = tests();
    let text = fs::read_to_string(DOCUMENT).expect(DOCUMENT);
    let mut named = BTreeSet::new();
    let rows = text.lines().filter(|line| line.starts_with('|') && !line.contains("---") && !line.contains("| test |"));
    for line in rows {
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let ["", case, _, _, names, figures, ""] = cells[..] else { panic!("not five cells: {line}") };
        let names: Vec<&str> = quoted(names).collect();
        assert!(!names.is_empty(), "{case}: no test");
        let of_test = |name: &&str| match tests.get(*name).map(Vec::as_slice) {
            Some([test]) => &test.figures,
            Some(_) => panic!("{case}: several tests are called {name}"),
            None => panic!("{case}: there is no test {name}"),
        };
        let asserted: BTreeSet<_> = names.iter().flat_map(of_test).cloned().collect();
        let stated: BTreeSet<_> = match figures {
            "" => BTreeSet::new(),
            figures => figures.split("; ").map(figure).collect(),
        };
        assert_eq!(stated, asserted, "{DOCUMENT}, row {case:?}: figures against those that its tests assert");
        named.extend(names.into_iter().map(str::to_owned));
    }
    for name in quoted(&text).filter(|quoted| quoted.contains('_')) {
        assert!(named.contains(name), "{DOCUMENT}: {name} is in backticks, but is no test of the table");
    }
    for (name, test) in tests.iter().flat_map(|(name, tests)| tests.iter().map(move |test| (name, test))) {
        let belongs = test.file.starts_with(FOLDER) || !test.figures.is_empty();
        assert!(!belongs || named.contains(name) || test.file.ends_with("table.rs"), "{DOCUMENT} lacks {name}");
    }
    assert!(named.len() > 60, "the table was not read");
}

/// What stands between backticks.
fn quoted(text: &str) -> impl Iterator<Item = &str> {
    text.split('`').skip(1).step_by(2)
}

/// "3e-14 rad" as number and unit.
fn figure(text: &str) -> (String, String) {
    let (number, unit) = text.trim().split_once(' ').unwrap_or_else(|| panic!("{text:?}: a number and its unit"));
    (number.to_owned(), unit.to_owned())
}

fn tests() -> BTreeMap<String, Vec<Test>> {
    let mut tests = BTreeMap::new();
    for file in ["crates", "src", "tests"].iter().flat_map(|folder| rust_files(Path::new(folder))) {
        let text = fs::read_to_string(&file).expect("a source file");
        let lines: Vec<&str> = text.lines().collect();
        for (index, line) in lines.iter().enumerate() {
            let is_test = *line.trim() == *"#[test]";
            let Some(head) = is_test.then(|| lines.get(index + 1)).flatten() else { continue };
            let Some(name) = head.trim().strip_prefix("fn ").and_then(|rest| rest.split('(').next()) else { continue };
            let indent = &head[..head.len() - head.trim_start().len()];
            let end = format!("{indent}}}");
            let body: Vec<&str> = lines[index + 2..].iter().take_while(|line| **line != end).copied().collect();
            let test = Test { file: file.clone(), figures: asserted(&body.join(" ")) };
            tests.entry(name.to_owned()).or_insert_with(Vec::new).push(test);
        }
    }
    tests
}

/// The last two arguments of each `largest_error(found, figure, "unit")`.
fn asserted(body: &str) -> BTreeSet<(String, String)> {
    let calls = body.split("largest_error(").skip(1);
    calls
        .map(|call| {
            let (arguments, _) = call.split_once(");").expect("a whole call");
            let (before, unit) = arguments.trim().trim_end_matches(',').split_once(", \"").expect("a unit");
            let number = before.rsplit(", ").next().expect("a figure").trim();
            (number.to_owned(), unit.trim_end_matches('"').to_owned())
        })
        .collect()
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    let (folders, files): (Vec<_>, Vec<_>) = entries.partition(|path| path.is_dir());
    let own = files.into_iter().filter(|path| path.extension().is_some_and(|ending| ending == "rs"));
    own.chain(folders.iter().flat_map(|folder| rust_files(folder))).collect()
}
