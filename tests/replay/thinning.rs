//! Fewer images of the same view: what is left out is counted, and every tag is there.

use std::collections::BTreeSet;

use realitysim::ros2::messages::{CompressedImageView, FrameTag};
use serde_json::Value;

use super::support::{CAPTURES, IMAGE, Room, TAG, assert_same, decode_all, on, read_capture, walk};

fn manifest(session: &std::path::Path) -> Vec<Value> {
    let text = std::fs::read_to_string(session.join("manifest.jsonl")).expect("a manifest");
    text.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

#[test]
fn every_mode_of_thinning_keeps_all_tags_and_counts_what_it_left_out() {
    let room = Room::with_walk();
    for mode in ["all", "rate", "novelty", "coverage"] {
        let arguments = "--set recording.thinning.rate_hz=3 --set recording.thinning.images_per_cell=1";
        let replayed = room.replay(&format!("log.mcap --set recording.thinning.mode=\"{mode}\" {arguments}"));
        assert_same(&replayed.tags, &walk().tags, mode);
        let recorded = read_capture(&replayed.session);
        let images: BTreeSet<i64> = on(&recorded, IMAGE).map(|m| stamp(&m.data)).collect();
        let tags: BTreeSet<i64> = replayed.tags.iter().map(|tag| tag.header.stamp.to_nanoseconds()).collect();
        assert!(images.is_subset(&tags), "{mode}");
        let sum = |key: &str| -> u64 {
            manifest(&replayed.session).iter().map(|line| line["frames"][key].as_u64().expect("a count")).sum()
        };
        assert_eq!(sum("written"), images.len() as u64, "{mode}");
        assert_eq!(sum("captured"), sum("written") + sum("thinned"), "{mode}");
        assert_eq!(sum("tagged") as usize, walk().frames(), "{mode}");
        assert_eq!(replayed.run.code, Some(0), "{mode}: nothing was lost");
        assert_eq!(sum("thinned") == 0, mode == "all", "{mode}: {}", sum("thinned"));
        // Untouched, like every recorded message.
        let originals: BTreeSet<&[u8]> = on(&walk().messages, IMAGE).map(|message| message.data.as_slice()).collect();
        assert!(on(&recorded, IMAGE).all(|message| originals.contains(message.data.as_slice())), "{mode}");
    }
}

#[test]
fn a_thinned_capture_can_be_read_again() {
    let room = Room::with_walk();
    let thinned = room.replay("log.mcap --set recording.thinning.mode=\"novelty\"");
    let name = format!("{CAPTURES}/{}", thinned.session.file_name().expect("a name").to_string_lossy());
    let again = room.replay(&format!("{name} --set recording.thinning.mode=\"all\""));
    assert_eq!(again.tags.len(), on(&read_capture(&thinned.session), IMAGE).count());
    let all: Vec<FrameTag> = decode_all(&read_capture(&again.session), TAG);
    assert!(all.iter().filter(|tag| tag.valid).count() * 10 >= all.len() * 8, "{}", all.len());
    room.run(&format!("db add {name} --db db")).succeeds();
}

#[test]
fn the_coverage_is_that_of_the_images_however_it_is_found() {
    let room = Room::with_walk();
    for mode in ["all", "novelty"] {
        let replayed = room.replay(&format!("log.mcap --set recording.thinning.mode=\"{mode}\""));
        let name = format!("{CAPTURES}/{}", replayed.session.file_name().expect("a name").to_string_lossy());
        let shown = room.run(&format!("sessions show {name} --json -o cover.png")).succeeds().json();
        assert!(room.path("cover.png").is_file());
        assert!(shown["coverage"]["filled"].as_u64() > Some(0), "{shown}");
        let rows = shown["coverage"]["map"].as_array().expect("a map").len() as u64;
        assert_eq!(Some(rows), shown["coverage"]["rows"].as_u64());
        let headings = shown["coverage"]["headings"].as_array().expect("one map each");
        let filled: u64 = headings.iter().filter_map(|heading| heading["filled"].as_u64()).sum();
        assert_eq!(
            (Some(headings.len() as u64), Some(filled)),
            (shown["coverage"]["sectors"].as_u64(), shown["coverage"]["filled"].as_u64())
        );
        let marks = |heading: &serde_json::Value| {
            let rows = heading["map"].as_array().expect("rows").iter().map(|row| row.as_str().expect("text"));
            rows.map(|row| row.chars().filter(|c| *c != '.').count() as u64).sum::<u64>()
        };
        assert!(headings.iter().all(|heading| Some(marks(heading)) == heading["filled"].as_u64()), "{shown}");
        // As after a kill: counted from what is there.
        std::fs::remove_file(replayed.session.join("coverage.json")).expect("it was there");
        let counted = room.run(&format!("sessions show {name} --json")).succeeds().json();
        assert_eq!(counted["coverage"], shown["coverage"], "{mode}");
        let text = room.run(&format!("sessions show {name}")).succeeds().stdout;
        assert!(text.contains("poses (cells of 0.5 m, 8 headings"), "{text}");
    }
}

#[test]
fn a_thinning_that_cannot_be_is_refused() {
    let room = Room::with_walk();
    let replay = |set: &str| room.run(&format!("replay log.mcap -o {CAPTURES} --set recording.thinning.{set}"));
    replay("mode=\"some\"").fails(2, &["some"]);
    replay("cell_m=0").fails(2, &["recording.thinning.cell_m is 0: it must be 0.1 to 5"]);
}

fn stamp(image: &[u8]) -> i64 {
    CompressedImageView::decode(image).expect("an image").header.stamp.to_nanoseconds()
}
