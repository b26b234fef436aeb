//! The documents lead somewhere: every link to a file or heading of the repository has its target.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use realitysim::localization::Rejection;

#[test]
fn every_link_of_a_document_has_its_target() {
    let mut broken = Vec::new();
    let documents = documents();
    assert!(documents.len() > 15, "the documents were not found");
    for document in &documents {
        let text = fs::read_to_string(document).expect("a document");
        for target in links(&text) {
            let (path, anchor) = target.split_once('#').unwrap_or((target, ""));
            let folder = document.parent().expect("a file stands in a folder");
            let file = if path.is_empty() { document.clone() } else { folder.join(path) };
            let is_there = file.exists() && (anchor.is_empty() || headings(&file).contains(anchor));
            if !is_there {
                broken.push(format!("{}: {target}", document.display()));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// Each reason of an invalid tag has its row among those of the `reason` of a tag, and each row names a reason.
#[test]
fn every_rejection_is_documented() {
    let text = fs::read_to_string("docs/reference/formats.md").expect("docs/reference/formats.md");
    let table = text.lines().skip_while(|line| !line.starts_with("| `reason` | meaning |")).skip(2);
    let rows = table.take_while(|line| line.starts_with('|')).filter_map(|line| line.split('|').nth(1));
    let documented: BTreeSet<&str> = rows.flat_map(|names| names.split('`').skip(1).step_by(2)).collect();
    let all: BTreeSet<&str> = Rejection::ALL.iter().map(|rejection| rejection.as_str()).collect();
    assert_eq!(documented, all);
}

/// The documents that `docs/SUMMARY.md`, the table of contents of the site, leads to: all of `docs`.
#[test]
fn the_table_of_contents_names_every_document() {
    let summary = fs::read_to_string("docs/SUMMARY.md").expect("docs/SUMMARY.md");
    let named: BTreeSet<PathBuf> = links(&summary).map(|target| Path::new("docs").join(target)).collect();
    let mut there = BTreeSet::new();
    collect(Path::new("docs"), &mut there);
    there.remove(Path::new("docs/SUMMARY.md"));
    let left_out: Vec<&PathBuf> = there.difference(&named).collect();
    assert!(left_out.is_empty(), "docs/SUMMARY.md lacks {left_out:?}");
}

/// The commands of the tutorial, one after the other in an empty folder, and what it says that they print.
#[test]
fn the_tutorial_runs_as_it_is_written() {
    let text = fs::read_to_string("docs/tutorial.md").expect("docs/tutorial.md");
    let folder = tempfile::tempdir().expect("a folder");
    std::os::unix::fs::symlink(fs::canonicalize("replay").expect("replay"), folder.path().join("replay"))
        .expect("a link");
    let program = Path::new(env!("CARGO_BIN_EXE_realitysim")).parent().expect("a folder").display().to_string();
    let path = format!("{program}:{}", std::env::var("PATH").unwrap_or_default());
    let mut printed = String::new();
    for command in
        text.lines().filter_map(|line| line.strip_prefix("    ")).filter(|line| line.starts_with("realitysim "))
    {
        let mut shell = Command::new("sh");
        let output = shell.args(["-c", command]).current_dir(&folder).env("PATH", &path).output().expect("sh");
        assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
        printed += &String::from_utf8_lossy(&output.stdout);
        printed += &String::from_utf8_lossy(&output.stderr);
    }
    for said in ["469 frames, 469 tagged, 469 valid", "captures/2025-10-09T08-53-20Z-robot", "the 95 % ellipse holds"] {
        assert!(text.contains(said) && printed.contains(said), "{said}: {printed}");
    }
    for picture in ["frame200.png", "view.png"] {
        assert!(folder.path().join(picture).is_file(), "{picture}");
    }
}

fn documents() -> BTreeSet<PathBuf> {
    let own = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "STYLE.md", "clients/python/README.md"];
    let mut all: BTreeSet<PathBuf> = own.iter().map(PathBuf::from).collect();
    collect(Path::new("docs"), &mut all);
    all
}

fn collect(folder: &Path, all: &mut BTreeSet<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            collect(&path, all);
        } else if path.extension().is_some_and(|ending| ending == "md") {
            all.insert(path);
        }
    }
}

/// Targets of links and pictures within the repository. What stands in a block of code is no link.
fn links(text: &str) -> impl Iterator<Item = &str> {
    let prose = text.lines().filter(|line| !line.starts_with("    "));
    prose
        .flat_map(|line| line.split("](").skip(1))
        .filter_map(|rest| rest.split(')').next())
        .filter(|target| !target.is_empty() && !target.contains("://") && !target.starts_with("mailto:"))
}

/// Headings as the anchors that renderers of Markdown make of them.
fn headings(file: &Path) -> BTreeSet<String> {
    let text = fs::read_to_string(file).unwrap_or_default();
    let heading = |line: &str| {
        let kept = line.trim_start_matches('#').trim().chars().filter_map(|letter| match letter {
            ' ' => Some('-'),
            letter if letter.is_alphanumeric() || letter == '-' || letter == '_' => Some(letter.to_ascii_lowercase()),
            _ => None,
        });
        kept.collect()
    };
    text.lines().filter(|line| line.starts_with('#')).map(heading).collect()
}
