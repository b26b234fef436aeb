//! `contrast`: how tags fare as lines fade.

use std::fs;

use super::support::Room;

const WORN: &str = "[[effect]]\nkind = \"worn_lines\"\nrole = \"base\"\nshare = 0.5\npatch_m = 0.35\n";

#[test]
fn faint_lines_are_refused_and_never_wrong() {
    let room = Room::new();
    let next = "[[effect]]\nkind = \"odometry_error\"";
    room.write_scene("scene.toml", |text| text.replacen(next, &format!("{WORN}\n{next}"), 1));
    let report = room.run("measure contrast scene.toml -o out --json").succeeds().json();
    let steps = report["steps"].as_array().expect("steps");
    assert_eq!((steps.len(), report["variants"][0]["name"].as_str()), (10, Some("gauss, refined")));
    let number = |step: usize, key: &str| steps[step]["tags"][0][key].as_u64().expect("a number");
    let frames = report["frames"].as_u64().expect("a number");
    assert!(10 * number(0, "valid") >= 9 * frames, "well painted: {}", steps[0]);
    // What was told of the start is carried on for half a second.
    assert!(number(9, "valid") <= 6, "without any paint: {}", steps[9]);
    assert!((0..10).all(|step| number(step, "wrong") == 0), "{report}");
    let ratios: Vec<f64> = steps.iter().map(|step| step["contrast_to_noise"].as_f64().expect("a number")).collect();
    assert!(ratios[0] > 2.0 && ratios.windows(2).all(|pair| pair[1] < pair[0]) && ratios[9] == 0.0, "{ratios:?}");
    assert_eq!(fs::read_to_string(room.path("out/contrast.csv")).expect("written").lines().count(), 61);
    assert!(fs::read_to_string(room.path("out/contrast.svg")).expect("written").contains("valid tags in %"));
}

#[test]
fn a_scene_without_worn_lines_is_told_what_it_lacks() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text);
    room.run("measure contrast scene.toml").fails(2, &["scene.toml", "worn_lines"]);
}
