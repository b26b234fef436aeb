//! `cost`: sweeps from end to end.

use std::fs;

use realitysim::config::Settings;
use realitysim::ros2::messages::{CompressedImage, FrameTag, PoseStamped};
use realitysim::tagging::{FrameCache, FrameCacheOptions};
use serde_json::Value;

use super::support::{IMAGE, Room, TRUTH, assert_same, changed, on, walk, without};

/// Few frames, one seed: what comes out is no measurement.
const SHORT: &str = "--seeds 1 --for 1.2";
const FRAMES: usize = 12;

fn rows(report: &Value) -> &Vec<Value> {
    report["rows"].as_array().unwrap()
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap_or_else(|| panic!("{key}: {value}"))
}

#[test]
fn a_sweep_recommends_a_row_of_the_front_and_its_config_is_accepted() {
    let room = Room::with_walk();
    let run = room.run(&format!("measure cost log.mcap {SHORT} --budget-ms 1000 -o out --json")).succeeds();
    let report = run.json();
    assert_eq!((report["frames"].as_u64(), report["frames_judged"].as_u64()), (Some(12), Some(12)), "{report}");
    assert_eq!(report["judged_by"]["kind"], "ground_truth");
    let rows = rows(&report);
    assert!(rows.len() > 30);
    assert_eq!(rows.iter().filter(|row| row["configured"] == true).count(), 1);
    let chosen: Vec<&Value> = rows.iter().filter(|row| row["recommended"] == true).collect();
    assert!(chosen.len() == 1 && chosen[0]["on_front"] == true, "{report}");
    assert_eq!(report["recommended"]["keeps_budget"], true);
    for row in rows {
        assert!(number(row, "p50_ms") > 0.0 && number(row, "p50_ms") <= number(row, "p99_ms"), "{row}");
    }
    // With as few pixels as these, half of them are too few.
    let whole = rows.iter().filter(|row| row["image_reduction"] == 0);
    assert!(whole.clone().count() > 25 && whole.clone().all(|row| number(row, "valid_share") > 0.4), "{report}");
    let best = rows.iter().map(|row| number(&row["position_cm"], "mean")).fold(f64::INFINITY, f64::min);
    assert!(best < 3.0, "{best}");

    let csv = fs::read_to_string(room.path("out/cost.csv")).unwrap();
    assert_eq!(csv.lines().count(), rows.len() + 1);
    let columns = csv.lines().next().unwrap().split(',').count();
    assert!(csv.lines().all(|line| line.split(',').count() == columns), "{csv}");
    let svg = fs::read_to_string(room.path("out/cost.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("budget 1000 ms") && svg.contains("recommended"));

    let replayed = room.replay("log.mcap --config out/cost.toml");
    let particles = chosen[0]["particles"].as_u64().unwrap();
    // Which row is the cheapest depends on the machine; one that adapts takes as many as a frame needs.
    let adaptive = chosen[0]["adaptive"].as_bool().unwrap();
    let as_chosen = |used: u64| if adaptive { (1..=particles).contains(&used) } else { used == particles };
    for tag in &replayed.tags {
        assert!(as_chosen(tag.particles.into()) && tag.model == chosen[0]["model"], "{tag:?}: {}", chosen[0]);
    }
}

#[test]
fn the_budget_of_the_config_stays_although_rows_are_measured_without() {
    let room = Room::with_walk();
    let run =
        room.run(&format!("measure cost log.mcap {SHORT} --budget-ms 1000 -o out --set filter.budget_ms=50 --json"));
    assert_eq!(number(&run.succeeds().json()["recommended"], "budget_ms"), 0.0);
    let config = fs::read_to_string(room.path("out/cost.toml")).unwrap();
    assert!(config.contains("budget_ms = 50.0"), "{config}");
}

#[test]
fn frames_that_are_kept_get_the_tags_of_a_replay() {
    let room = Room::with_walk();
    let settings = Settings::default();
    let source = room.path("log.mcap");
    let options = FrameCacheOptions { source, settings: settings.clone(), initial: None, from_s: 0.0, for_s: None };
    let cache = FrameCache::load(&options, &mut |_, _| {}).unwrap();
    for _ in 0..2 {
        let attempts = cache.try_out(&settings, &mut |_| {}).unwrap();
        let tags: Vec<FrameTag> = (attempts.into_iter().zip(&walk().tags))
            .map(|(attempt, tag)| FrameTag {
                sequence: tag.sequence,
                kernel_stamp_ns: tag.kernel_stamp_ns,
                ..attempt.tag
            })
            .collect();
        assert_same(&tags, &walk().tags, "buffers that are used again change nothing");
    }
}

#[test]
fn a_log_without_truth_is_judged_by_a_long_run() {
    let room = Room::with_log(&without(&walk().messages, TRUTH));
    let run = room.run(&format!("measure cost log.mcap {SHORT} --accuracy-cm 50 -o out --set robot=tom")).succeeds();
    for words in ["no ground truth", "4000 particles", "the cheapest row that reaches 50 cm"] {
        assert!(run.stdout.contains(words), "{words}: {run:?}");
    }
    assert!(fs::read_to_string(room.path("out/cost.toml")).unwrap().contains("robot = \"tom\""));
    assert!(fs::read_to_string(room.path("out/cost.svg")).unwrap().contains("50 cm wanted"));
}

#[test]
fn a_truth_that_stops_half_way_judges_only_its_own_half() {
    let truth: Vec<i64> = on(&walk().messages, TRUTH).map(|message| message.log_time_ns).collect();
    let messages: Vec<_> = (walk().messages.iter())
        .filter(|message| message.channel.topic != TRUTH || message.log_time_ns < truth[6])
        .cloned()
        .collect();
    let room = Room::with_log(&messages);
    let short = format!("{SHORT} --budget-ms 1000 -o out");
    let run = room.run(&format!("measure cost log.mcap {short}")).succeeds();
    assert!(run.stdout.contains("covers 6 of them"), "{run:?}");
    // In a log of its own it counts as well; one of another time does not.
    room.write("truth.mcap", &walk().log);
    let run = room.run(&format!("measure cost log.mcap --truth truth.mcap {short} --json")).succeeds();
    assert_eq!(run.json()["frames_judged"], FRAMES, "{run:?}");
    let late = changed::<PoseStamped>(&walk().messages, TRUTH, |truth| truth.header.stamp.sec += 3600);
    let run = Room::with_log(&late).run(&format!("measure cost log.mcap {short} --json")).succeeds();
    assert_eq!(run.json()["judged_by"]["elsewhere"], true, "{run:?}");
}

#[test]
fn a_budget_that_cannot_be_kept_is_told_with_what_was_reached() {
    let room = Room::with_walk();
    let run = room.run(&format!("measure cost log.mcap {SHORT} --budget-ms 0.0001 -o out")).fails(1, &[]);
    assert!(run.stdout.contains("no row keeps 0.0001 ms; this is the fastest, with"), "{run:?}");
    assert!(room.path("out/cost.toml").exists(), "the fastest can be used all the same");
    let run =
        room.run(&format!("measure cost log.mcap {SHORT} --budget-ms 0.0001 --accuracy-cm 1e-7 -o out")).fails(1, &[]);
    assert!(run.stdout.contains("no row keeps 0.0001 ms and none reaches 0.0000001 cm"), "{run:?}");
    // The bargains are tried once more, each frame within the least budget that there is.
    let run = room.run(&format!("measure cost log.mcap {SHORT} --budget-ms 0.1 -o out --json")).fails(1, &[]).json();
    let with = |budget_ms: f64| rows(&run).iter().filter(|row| number(row, "budget_ms") == budget_ms).count();
    assert!(with(0.1) > 0 && with(0.0) > 30 && with(0.1) + with(0.0) == rows(&run).len(), "{run:#}");
    // Half of what was asked for can be had.
    let run = room.run(&format!("measure cost log.mcap {SHORT} --budget-ms 0.0001 --accuracy-cm 90 -o out")).succeeds();
    assert!(run.stdout.contains("this is the cheapest that reaches 90 cm"), "{run:?}");
    let run = room.run(&format!("measure cost log.mcap {SHORT} --budget-ms 1000 --accuracy-cm 1e-7 -o out")).succeeds();
    assert!(run.stdout.contains("no row reaches 0.0000001 cm"), "{run:?}");
}

#[test]
fn a_window_later_in_the_log_begins_where_the_robot_is_by_then() {
    let room = Room::with_walk();
    let run = room.run("measure cost log.mcap --seeds 1 --from 1.5 --for 1 --budget-ms 1000 -o out --json").succeeds();
    let report = run.json();
    assert_eq!(report["frames"], 10);
    let usual = |row: &&Value| row["refinement"] == true && row["image_reduction"] == 0;
    assert!(rows(&report).iter().filter(usual).all(|row| row["valid_share"] == 1.0), "{report}");
    room.run("measure cost log.mcap --from 1000 -o out")
        .fails(1, &["log.mcap", "the last one comes 3.", "before the window"]);
}

#[test]
fn what_cannot_be_compared_is_an_error_that_says_why() {
    let black = {
        let mut data = Vec::new();
        let image = image::RgbImage::new(320, 240);
        let encoder = image::codecs::jpeg::JpegEncoder::new(&mut data);
        image.write_with_encoder(encoder).unwrap();
        data
    };
    let dark = changed::<CompressedImage>(&walk().messages, IMAGE, |image| image.data.clone_from(&black));
    let room = Room::with_log(&dark);
    room.run(&format!("measure cost log.mcap {SHORT} -o out"))
        .fails(1, &["log.mcap", "no setting gave a valid tag", "x "]);
    room.run("measure cost none.mcap -o out").fails(1, &["none.mcap"]);
    for (arguments, words) in [
        ("--budget-ms 0", vec!["--budget-ms", "above 0"]),
        ("--accuracy-cm nan", vec!["--accuracy-cm", "above 0"]),
        ("--from -1", vec!["--from"]),
        ("--for 0", vec!["--for", "above 0"]),
        ("--seeds 0", vec!["--seeds", "1 to 20"]),
        ("--particles 0", vec!["filter.particles is 0"]),
        ("--initial 90,0,0", vec!["--initial is 90,0", "kid-2009"]),
        ("--set filter.image_reduction=9", vec!["filter.image_reduction is 9", "0 to 8"]),
    ] {
        room.run(&format!("measure cost log.mcap -o out {arguments}")).fails(2, &words);
    }
    room.run("measure cost log.mcap -o log.mcap").fails(2, &["log.mcap", "would be written over"]);
    room.write("plain.md", "no marks\n");
    room.run("measure cost log.mcap -o out --write-docs plain.md")
        .fails(2, &["plain.md", "begin: realitysim measure cost"]);
}

#[test]
fn a_scene_is_swept_and_its_section_of_a_document_written() {
    let room = Room::new();
    room.write_scene("scene.toml", |text| text);
    room.write(
        "doc.md",
        "# Cost\n\n<!-- begin: realitysim measure cost -->\n<!-- end: realitysim measure cost -->\n\nThe end.\n",
    );
    let run =
        room.run(&format!("measure cost scene.toml {SHORT} --budget-ms 1000 -o out --write-docs doc.md")).succeeds();
    assert!(run.stdout.contains("12 frames of scene.toml, judged by the ground truth"), "{run:?}");
    let document = fs::read_to_string(room.path("doc.md")).unwrap();
    assert!(document.starts_with("# Cost\n") && document.ends_with("\nThe end.\n"), "{document}");
    for words in ["realitysim measure cost scene.toml", "**recommended**", "configured", "![", "(cost.svg)"] {
        assert!(document.contains(words), "{words}: {document}");
    }
    assert!(room.path("cost.svg").exists());
}
