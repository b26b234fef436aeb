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
