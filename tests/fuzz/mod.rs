//! Every input that is kept in tests/data/fuzz, through what reads such bytes: a few that are sound, from which the fuzzer
//! (`./dev fuzz`) starts, and each that has once shown a fault.

pub mod parsers;
mod seeds;

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use parsers::TARGETS;

const KEPT: &str = "tests/data/fuzz";

fn files(folder: &Path) -> Vec<PathBuf> {
    let listed = fs::read_dir(folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut files: Vec<PathBuf> = listed.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn nothing_that_the_fuzzer_has_found_breaks_a_parser_again() {
    for (name, read) in TARGETS {
        let inputs = files(&Path::new(KEPT).join(name));
        assert!(inputs.len() >= 3, "{name}: too few inputs to begin from");
        for input in inputs {
            let bytes = fs::read(&input).unwrap();
            let broke = std::panic::catch_unwind(|| read(&bytes)).is_err();
            assert!(!broke, "{} breaks {name}", input.display());
        }
    }
}

#[test]
fn every_parser_is_fuzzed_and_every_kept_input_has_its_parser() {
    let names: BTreeSet<String> = TARGETS.iter().map(|(name, _)| (*name).to_owned()).collect();
    let in_folder = |folder: &str| -> BTreeSet<String> {
        files(Path::new(folder)).iter().map(|path| path.file_stem().unwrap().to_string_lossy().into_owned()).collect()
    };
    assert_eq!(in_folder("fuzz/fuzz_targets"), names);
    assert_eq!(in_folder(KEPT), names);
    let manifest = fs::read_to_string("fuzz/Cargo.toml").unwrap();
    for name in names {
        assert!(manifest.contains(&format!("path = \"fuzz_targets/{name}.rs\"")), "{name} is not built");
    }
}
