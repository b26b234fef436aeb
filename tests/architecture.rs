//! The crates depend on one another as docs/explanation/architecture.md says.

use std::collections::BTreeSet;
use std::fs;
use std::process::Command;

/// Libraries that another team can use without files, devices or a network.
const CORE: [&str; 4] = ["geometry", "vision", "views", "localization"];

/// What the core may be built of: mathematics, random numbers, and derives. Each is pure.
const ALLOWED: [&str; 26] = [
    "approx",
    "bytemuck",
    "glam",
    "libm",
    "matrixmultiply",
    "nalgebra",
    "num-complex",
    "num-integer",
    "num-rational",
    "num-traits",
    "proc-macro2",
    "quote",
    "rand",
    "rand_core",
    "rawpointer",
    "safe_arch",
    "serde",
    "serde_core",
    "serde_derive",
    "simba",
    "syn",
    "thiserror",
    "thiserror-impl",
    "typenum",
    "unicode-ident",
    "wide",
];

#[test]
fn the_core_is_built_of_mathematics_alone() {
    let mut tree = Command::new(env!("CARGO"));
    tree.args(["tree", "--edges", "normal", "--prefix", "none", "--format", "{p}", "--offline", "--locked"]);
    for name in CORE {
        tree.args(["--package", &format!("realitysim-{name}")]);
    }
    let output = tree.output().expect("cargo");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("names");
    let names: BTreeSet<&str> = text.lines().filter_map(|line| line.split(' ').next()).collect();
    let own = CORE.map(|name| format!("realitysim-{name}"));
    assert!(own.iter().all(|name| names.contains(name.as_str())), "{names:?}");
    let is_allowed = |name: &str| name.is_empty() || ALLOWED.contains(&name) || own.iter().any(|own| own == name);
    let others: Vec<&&str> = names.iter().filter(|name| !is_allowed(name)).collect();
    assert!(others.is_empty(), "the core depends on {others:?}");
}

/// Crates that only optional features need: the default build leaves them out, because they take long to compile.
const OPTIONAL: [&str; 2] = ["catalogue-query", "remote"];

#[test]
fn every_crate_but_the_optional_ones_is_built_by_default() {
    let manifest: toml::Table = toml::from_str(include_str!("../Cargo.toml")).expect("a manifest");
    let members = manifest["workspace"]["default-members"].as_array().expect("a list");
    let named: BTreeSet<&str> = members.iter().filter_map(|name| name.as_str()?.strip_prefix("crates/")).collect();
    let folders = fs::read_dir("crates").expect("crates").map(|entry| entry.expect("an entry").file_name());
    let folders: Vec<String> = folders.map(|name| name.into_string().expect("a plain name")).collect();
    let built: BTreeSet<&str> = folders.iter().map(String::as_str).filter(|name| !OPTIONAL.contains(name)).collect();
    assert_eq!(named, built);
    let dev = include_str!("../dev");
    assert!(OPTIONAL.iter().all(|name| dev.contains(&format!("realitysim-{name}"))));
}

/// The rows of the table of crates in docs/explanation/architecture.md, in its order.
fn rows() -> Vec<String> {
    let text = fs::read_to_string("docs/explanation/architecture.md").expect("docs/explanation/architecture.md");
    let table =
        text.lines().skip_while(|line| !line.starts_with("| crate |")).skip(2).take_while(|line| line.starts_with('|'));
    let name = |line: &str| line.split('`').nth(1).expect("a crate's name").to_owned();
    table.map(name).collect()
}

#[test]
fn no_crate_uses_one_below_it() {
    let rows = rows();
    let folders = fs::read_dir("crates").expect("crates").map(|entry| entry.expect("an entry").file_name());
    let folders: BTreeSet<String> = folders.map(|name| name.into_string().expect("a plain name")).collect();
    let stated: BTreeSet<String> = rows.iter().filter(|name| *name != "realitysim").cloned().collect();
    assert_eq!(
        stated,
        &folders - &BTreeSet::from(["test-support".to_owned()]),
        "docs/explanation/architecture.md has a row for each crate"
    );
    for (place, name) in rows.iter().enumerate().filter(|(_, name)| *name != "realitysim") {
        let manifest = fs::read_to_string(format!("crates/{name}/Cargo.toml")).expect("a manifest");
        let used = manifest
            .lines()
            .skip_while(|line| *line != "[dependencies]")
            .take_while(|line| *line != "[dev-dependencies]");
        for other in used.filter_map(|line| line.strip_prefix("realitysim-")?.split(['.', ' ']).next()) {
            assert!(rows[..place].iter().any(|above| above == other), "{name} uses {other}, which stands below it");
        }
    }
}
