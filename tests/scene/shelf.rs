//! Every effect is there because a scene needs it, and is shown; every scene is held to limits.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use realitysim::evaluation::suite::Suite;
use realitysim::scene::SceneFile;

use super::common::{STRAIGHT, plain, shelf, with_effects};

/// As the program lists them when it knows one not.
fn effects() -> BTreeSet<String> {
    let unknown = with_effects(&plain(STRAIGHT), &["kind = \"no_such_effect\""]);
    let said = SceneFile::from_toml(&unknown).expect_err("refused").to_string();
    let listed = said.split("expected one of").nth(1).expect("a list");
    listed.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

#[test]
fn every_effect_is_called_for_by_a_scene_and_there_is_none_besides() {
    let called: BTreeSet<String> =
        shelf().iter().flat_map(|(_, scene)| scene.file().effects.iter().map(|e| e.name().to_owned())).collect();
    assert_eq!(called, effects());
    let files: BTreeSet<String> = fs::read_dir("crates/scene/src/effects")
        .expect("a folder")
        .map(|file| file.expect("a file").path().file_stem().expect("a name").to_string_lossy().into_owned())
        .filter(|name| name != "mod")
        .collect();
    assert_eq!(files, called, "one file each");
}

#[test]
fn every_effect_has_its_picture_and_its_cost_in_the_documentation() {
    let text = fs::read_to_string("docs/reference/scenes.md").expect("readable");
    let costs = text.split("## What a frame costs").nth(1).expect("a part about costs");
    for effect in effects() {
        let section = text.split(&format!("### `{effect}`\n")).nth(1).unwrap_or_else(|| panic!("{effect} has no part"));
        let section = section.split("\n#").next().unwrap_or_default();
        let picture = format!("scenes/{effect}.jpg");
        assert!(section.contains(&format!("]({picture})")), "{effect} has no picture");
        assert!(Path::new("docs/reference").join(&picture).is_file(), "{picture} is not there");
        assert!(costs.contains(&format!("`{effect}`")), "what does {effect} cost?");
    }
}

/// The figures come from commands that are there and are named beside them.
#[test]
fn the_commands_that_give_the_costs_are_named_beside_them() {
    let text = fs::read_to_string("docs/reference/scenes.md").expect("readable");
    let costs = text.split("## What a frame costs").nth(1).expect("a part about costs");
    assert!(costs.contains("cargo bench --bench scenes -- --write docs/reference/scenes.md"));
    let manifest = fs::read_to_string("Cargo.toml").expect("readable");
    assert!(manifest.contains("[[bench]]\nname = \"scenes\"\n"));
    let counted = costs.split("<!-- begin: bench scenes -->").nth(1).expect("a mark");
    let counted = counted.split("<!-- end: bench scenes -->").next().unwrap_or_default();
    let program = fs::read_to_string("benches/scenes.rs").expect("readable");
    let program: String = program.split("const ROWS").nth(1).expect("its rows").to_owned();
    let rows: Vec<&str> = counted.lines().filter_map(|line| line.strip_prefix("| `")?.split(" | ").next()).collect();
    assert!(rows.len() >= effects().len(), "{rows:?}");
    rows.iter().for_each(|row| assert!(program.contains(&format!("\"`{row}\"")), "{row} is not measured"));

    assert!(costs.contains("realitysim scene check replay/scenes/NAME.toml"));
    let timed = costs.split("| effect | ms more | scene |").nth(1).expect("a table");
    for row in timed.lines().skip(2).take_while(|line| line.starts_with("| `")) {
        let cells: Vec<&str> = row.split('`').collect();
        let effect = cells[1];
        for scene in cells[2..].iter().skip(1).step_by(2) {
            let shelf = fs::read_to_string(format!("replay/scenes/{scene}.toml")).expect(scene);
            assert!(shelf.contains(&format!("kind = \"{effect}\"")), "{scene} has no {effect}");
        }
    }
}

#[test]
fn every_scene_of_the_shelf_is_held_to_limits() {
    let suite = Suite::load(Path::new("replay/shelf.toml")).expect("a suite");
    let held: BTreeSet<String> = suite.cases.into_iter().map(|case| case.name).collect();
    let scenes: BTreeSet<String> = shelf().into_iter().map(|(name, _)| name).collect();
    assert_eq!(held, scenes);
}
