//! Logs however they are packed, and what is left of damaged ones.

use mcap::{Compression, WriteOptions};

use super::support::{IMAGE, Room, TRUTH, assert_same, foreign_log, on, read_bytes, walk};

#[test]
fn a_log_gives_the_same_tags_however_it_is_packed() {
    let options = || WriteOptions::new().profile("ros2").chunk_size(Some(1 << 18));
    for (name, options) in [
        ("zstd", options().compression(Some(Compression::Zstd))),
        ("lz4", options().compression(Some(Compression::Lz4))),
        ("plain", options().compression(None)),
        ("without an index", options().emit_chunk_indexes(false).emit_message_indexes(false)),
        ("without a summary", options().emit_summary_records(false).emit_summary_offsets(false)),
        ("without checksums", options().calculate_chunk_crcs(false).calculate_summary_section_crc(false)),
        ("without chunks", options().use_chunks(false)),
    ] {
        let room = Room::new();
        room.write("log.mcap", foreign_log(options, &walk().messages));
        let replayed = room.replay("log.mcap");
        assert_eq!(replayed.run.code, Some(0), "{name}: {:?}", replayed.run);
        assert_same(&replayed.tags, &walk().tags, name);
    }
}

/// Chunks so small that a tear costs little.
fn fine_log() -> Vec<u8> {
    foreign_log(WriteOptions::new().profile("ros2").chunk_size(Some(1 << 15)), &walk().messages)
}

#[test]
fn everything_before_a_tear_is_replayed_and_the_loss_is_reported() {
    let log = fine_log();
    for percent in [15, 40, 75, 95] {
        let torn = &log[..log.len() * percent / 100];
        let readable = on(&read_bytes(torn), IMAGE).count();
        assert!(readable > 0 && readable < walk().frames(), "{readable} frames at {percent} %");
        let room = Room::new();
        room.write("torn.mcap", torn);
        let replayed = room.replay("torn.mcap");
        assert_eq!(replayed.run.code, Some(3), "{:?}", replayed.run);
        assert!(replayed.run.stderr.contains("torn.mcap is damaged"), "{:?}", replayed.run);
        assert_eq!(replayed.report["damage"][0]["torn"], true);
        assert_eq!(replayed.tags.len(), readable);
        // The last one lacks the measurements after it.
        let known = readable - 1;
        assert_same(&replayed.tags[..known], &walk().tags[..known], &format!("{percent} %"));
    }
}

#[test]
fn the_agent_s_own_log_loses_little_at_a_tear() {
    let room = Room::new();
    room.write("torn.mcap", &walk().log[..walk().log.len() - 1000]);
    let replayed = room.replay("torn.mcap");
    assert_eq!(replayed.run.code, Some(3), "{:?}", replayed.run);
    assert!(replayed.tags.len() > walk().frames() / 2);
}

#[test]
fn a_log_torn_before_its_first_frame_is_an_error_that_says_so() {
    let room = Room::new();
    room.write("torn.mcap", &walk().log[..12]);
    let words = ["torn.mcap: ", "no camera images", "it is not whole, which may be why", "its end is missing"];
    room.run("replay torn.mcap -o captures").fails(1, &words);
    assert!(!room.path("captures").exists(), "nothing is left behind");
}

#[test]
fn a_log_that_lost_what_is_needed_says_that_it_is_damaged() {
    // Calibration and transforms stand at the front; the camera only started later.
    let log = fine_log();
    let first = &on(&walk().messages, IMAGE).next().unwrap().data;
    let before_images = log.windows(64).position(|window| window == &first[100..164]).unwrap();
    let room = Room::new();
    room.write("torn.mcap", &log[..before_images]);
    let words = ["torn.mcap: no camera images on /camera/image/compressed", "which may be why", "its end is missing"];
    room.run("replay torn.mcap -o captures").fails(1, &words);
    assert!(!room.path("captures").exists(), "nothing is left behind");
    // In a folder the file is named.
    std::fs::create_dir(room.path("bag")).unwrap();
    room.write("bag/bag_0.mcap", &log[..before_images]);
    room.run("replay bag -o captures").fails(1, &["bag: no camera images", "bag/bag_0.mcap: damaged"]);
    // What lacks them from the start is not torn.
    let room = Room::with_log(&super::support::without(&walk().messages, IMAGE));
    let run = room.run("replay log.mcap -o captures").fails(1, &["no camera images"]);
    assert!(!run.stderr.contains("not whole"), "{run:?}");
}

#[test]
fn a_flipped_bit_costs_its_chunk_and_is_reported() {
    let options = WriteOptions::new().profile("ros2").chunk_size(Some(1 << 15)).compression(None);
    let log = foreign_log(options, &walk().messages);
    let whole = read_bytes(&log).len();
    // In the middle of an image in the middle.
    let image = &on(&walk().messages, IMAGE).nth(walk().frames() / 2).unwrap().data;
    let inside = &image[image.len() / 2..][..64];
    let mut flipped = log.clone();
    flipped[log.windows(64).position(|window| window == inside).unwrap()] ^= 0x10;
    let left = read_bytes(&flipped);
    assert!(left.len() < whole, "the bit matters");
    let room = Room::new();
    room.write("flipped.mcap", &flipped);
    let replayed = room.replay("flipped.mcap");
    assert_eq!(replayed.run.code, Some(3), "{:?}", replayed.run);
    assert!(replayed.run.stderr.contains("flipped.mcap is damaged"), "{:?}", replayed.run);
    assert_eq!(replayed.report["damage"][0]["bad_chunks"], 1);
    assert_eq!(replayed.tags.len(), on(&left, IMAGE).count());
    assert_eq!(on(&left, TRUTH).count(), on(&read_bytes(&flipped), TRUTH).count());
    let valid = replayed.count("valid");
    assert!(10 * valid >= 8 * replayed.tags.len(), "{valid} of {} valid", replayed.tags.len());
}
