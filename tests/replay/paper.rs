//! `paper`: its experiments in short, from end to end.

use std::fs;

use serde_json::Value;

use super::support::Room;

#[test]
fn the_paper_is_repeated_in_short() {
    let room = Room::new();
    room.write("paper.md", "<!-- begin: realitysim measure paper -->\n<!-- end: realitysim measure paper -->\n");
    let run = room.run("measure paper --quick -o out --write-docs paper.md --json").succeeds();
    let report = run.json();
    let error = |set: &str, name: &str| {
        let runs = report[set].as_array().unwrap();
        let wanted = |run: &&Value| run["method"] == name && run["particles"] == 800;
        runs.iter().find(wanted).and_then(|run| run["position_cm"]["mean"].as_f64()).unwrap()
    };
    for set in ["still", "walk"] {
        let (printed, corrected) = (error(set, "Gauss, as printed"), error(set, "Gauss, corrected"));
        let refined = error(set, "Gauss, corrected and refined");
        assert!(printed > 30.0, "the printed sign prefers dark pixels: {printed}");
        assert!(corrected < printed / 3.0 && refined < corrected, "{set}: {printed} {corrected} {refined}");
    }
    let document = fs::read_to_string(room.path("paper.md")).unwrap();
    for words in ["18.51", "18.1 cm, 850 ms", "18.5 cm, 1760 ms", "paper-fig9-error.svg", "Short form"] {
        assert!(document.contains(words), "{words}: {document}");
    }
    for name in ["paper-fig9-error.svg", "paper-fig9-time.svg", "paper-fig10.svg"] {
        assert!(fs::read_to_string(room.path(name)).unwrap().starts_with("<svg"), "{name}");
        assert!(room.path("out").join(name).exists());
    }
    let csv = fs::read_to_string(room.path("out/paper.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 5 + 6 + 6, "{csv}");
    let left = fs::read_dir(room.path("out")).unwrap().count();
    assert_eq!(left, 5, "nothing but the results: scenes are made in memory");
}
