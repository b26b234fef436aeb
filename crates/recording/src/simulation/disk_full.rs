//! Tests of what is removed when the disk fills up, in which order, and what never is.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::disk::{SimulatedDisk, Trouble};
use crate::acknowledgement::{ACK_FOLDER, Acknowledgement, RECEIVER_FILE, SYNC_FOLDER};
use crate::manifest::{Counts, MANIFEST_FILE, ManifestLine, PIN_FILE, SESSION_FILE};
use crate::record_queue::Allowed;
use crate::retention::{Limits, Retention, SpaceCheck};
use crate::storage::{Storage, write_atomically};
use realitysim_config::RecordingSettings;

const CAPTURES: &str = "/captures";
const MEBIBYTE: usize = 1 << 20;

fn settings() -> RecordingSettings {
    RecordingSettings { floor_mb: 4, floor_percent: 0.0, ..RecordingSettings::default() }
}

fn disk() -> SimulatedDisk {
    let disk = SimulatedDisk::new(1, Trouble::default());
    disk.create_folder(Path::new(CAPTURES)).unwrap();
    disk
}

fn put(disk: &SimulatedDisk, path: &Path, content: &[u8]) {
    write_atomically(disk, path, content).unwrap();
}

fn line(name: &str) -> ManifestLine {
    ManifestLine {
        name: name.to_owned(),
        bytes: MEBIBYTE as u64,
        blake3: blake3::hash(name.as_bytes()).to_hex().to_string(),
        first_ns: 0,
        last_ns: 0,
        messages: 1,
        frames: Counts::default(),
        poses: None,
        cut_bytes: None,
    }
}

/// Adds a session of two segments of a mebibyte each; the receiver `laptop` has acknowledged those that are named.
fn add(disk: &SimulatedDisk, name: &str, acknowledged: &[&str], is_pinned: bool) -> PathBuf {
    let session = Path::new(CAPTURES).join(name);
    disk.create_folder(&session).unwrap();
    put(disk, &session.join(SESSION_FILE), br#"{"format":1,"robot":"r","started":"2026-01-01T00:00:00Z"}"#);
    let names = ["0000.mcap", "0001.mcap"];
    let text: Vec<String> = names.iter().map(|name| serde_json::to_string(&line(name)).unwrap() + "\n").collect();
    put(disk, &session.join(MANIFEST_FILE), text.concat().as_bytes());
    for name in names {
        put(disk, &session.join(name), &vec![0; MEBIBYTE]);
    }
    if !acknowledged.is_empty() {
        let folder = session.join(ACK_FOLDER);
        disk.create_folder(&folder).unwrap();
        let acks = acknowledged.iter().map(|name| Acknowledgement::of(&line(name)).to_line());
        put(disk, &folder.join("laptop.jsonl"), acks.collect::<String>().as_bytes());
    }
    if is_pinned {
        put(disk, &session.join(PIN_FILE), b"");
    }
    session
}

/// Checks the disk while `free_mb` MiB of it are free.
fn look(disk: &SimulatedDisk, settings: &RecordingSettings, free_mb: f64, session: Option<&Path>) -> SpaceCheck {
    let used: usize = disk.snapshot().values().map(Vec::len).sum();
    let capacity_bytes = Some(used as u64 + (free_mb * MEBIBYTE as f64) as u64);
    disk.trouble(Trouble { capacity_bytes, ..Trouble::default() });
    Retention::new(Arc::new(disk.clone()), Limits::new(Path::new(CAPTURES), settings)).check_space(session)
}

/// Segments that were removed.
fn evicted(disk: &SimulatedDisk) -> Vec<String> {
    let snapshot = disk.snapshot();
    let all = snapshot.keys().filter(|path| path.file_name().is_some_and(|name| name == MANIFEST_FILE));
    let segments = all.flat_map(|path| ["0000.mcap", "0001.mcap"].map(|name| path.with_file_name(name)));
    let gone = segments.filter(|path| !snapshot.contains_key(path));
    gone.map(|path| path.strip_prefix(CAPTURES).unwrap().to_str().unwrap().to_owned()).collect()
}

#[test]
fn with_room_enough_nothing_goes() {
    let disk = disk();
    add(&disk, "a", &["0000.mcap", "0001.mcap"], false);
    let seen = look(&disk, &settings(), 4.5, None);
    assert_eq!((seen.allowed, seen.evicted.len()), (Allowed::All, 0));
}

#[test]
fn what_is_acknowledged_goes_oldest_first_and_pinned_last() {
    let disk = disk();
    let both = ["0000.mcap", "0001.mcap"];
    add(&disk, "a", &both, true);
    add(&disk, "b", &["0001.mcap"], false);
    add(&disk, "c", &both, false);
    add(&disk, "d", &[], false);
    let order = ["b/0001.mcap", "c/0000.mcap", "c/0001.mcap", "a/0000.mcap", "a/0001.mcap"];
    for count in 1..=order.len() {
        let seen = look(&disk, &settings(), 3.5, None);
        assert_eq!((seen.allowed, seen.evicted.len()), (Allowed::All, 1), "one is enough");
        let mut expected = order[..count].to_vec();
        expected.sort_unstable();
        assert_eq!(evicted(&disk), expected);
    }
    // A segment that no other store has stays, whatever that costs.
    let seen = look(&disk, &settings(), 3.5, None);
    assert_eq!((seen.allowed, seen.evicted.len()), (Allowed::NoFrames("disk_full"), 0));
    assert_eq!(look(&disk, &settings(), 0.9, None).allowed, Allowed::Nothing("disk_full"));
}

#[test]
fn only_what_is_verified_as_it_stands_may_go() {
    let (disk, other, third) = (disk(), disk(), disk());
    // An acknowledgement with another hash, one with another size, one whose name leads out of the folder, and one
    // that was cut.
    let session = add(&disk, "a", &["0000.mcap"], false);
    let [first, second] = ["0000.mcap", "0001.mcap"].map(|name| Acknowledgement::of(&line(name)));
    let lines = [
        Acknowledgement { blake3: second.blake3.clone(), ..first.clone() },
        Acknowledgement { bytes: 5, ..second.clone() },
        Acknowledgement { file: "../session.json".to_owned(), ..first },
    ];
    let text: String = lines.iter().map(Acknowledgement::to_line).collect();
    put(&disk, &session.join("ack/laptop.jsonl"), (text + &second.to_line()[..60]).as_bytes());
    // A file that changed after it was acknowledged.
    let changed = add(&other, "a", &["0000.mcap"], false);
    put(&other, &changed.join("0000.mcap"), b"short");
    // A folder that is no session.
    let foreign = add(&third, "a", &["0000.mcap"], false);
    third.remove(&foreign.join(SESSION_FILE)).unwrap();
    for disk in [disk, other, third] {
        let before = disk.snapshot();
        assert_eq!(look(&disk, &settings(), 3.5, None).allowed, Allowed::NoFrames("disk_full"));
        assert!(disk.snapshot() == before);
    }
}

/// A prune that has found its last copy here deletes its own, and takes back the acknowledgement by which this one
/// could be removed.
#[test]
fn nothing_goes_while_somebody_else_has_the_folder_s_turn() {
    let disk = disk();
    add(&disk, "a", &["0000.mcap"], false);
    let turn = disk.lock(Path::new(CAPTURES)).unwrap().expect("free");
    let seen = look(&disk, &settings(), 3.5, None);
    assert_eq!((seen.allowed, seen.evicted.len()), (Allowed::NoFrames("disk_full"), 0));
    drop(turn);
    assert_eq!(look(&disk, &settings(), 3.5, None).evicted.len(), 1);
    assert!(disk.lock(Path::new(CAPTURES)).unwrap().is_some(), "given back");
}

/// A development machine may record into the folder that it syncs into.
#[test]
fn the_folders_own_word_as_a_receiver_frees_nothing() {
    let disk = disk();
    add(&disk, "a", &["0000.mcap"], false);
    disk.create_folder(&Path::new(CAPTURES).join(SYNC_FOLDER)).unwrap();
    put(&disk, &Path::new(CAPTURES).join(SYNC_FOLDER).join(RECEIVER_FILE), b"laptop\n");
    assert_eq!(look(&disk, &settings(), 3.5, None).allowed, Allowed::NoFrames("disk_full"));
    assert_eq!(evicted(&disk), [""; 0]);
    put(&disk, &Path::new(CAPTURES).join(SYNC_FOLDER).join(RECEIVER_FILE), b"another\n");
    assert_eq!(look(&disk, &settings(), 3.5, None).evicted.len(), 1);
}

#[test]
fn quotas_hold_for_a_session_and_for_all() {
    let disk = disk();
    let session = add(&disk, "a", &["0000.mcap", "0001.mcap"], false);
    add(&disk, "b", &[], false);
    let of_session = RecordingSettings { session_mb: 2, ..settings() };
    let seen = look(&disk, &of_session, 100.0, Some(&session));
    assert_eq!((seen.allowed, seen.evicted.len()), (Allowed::Nothing("session_quota"), 0), "others are not in its way");
    let of_session = RecordingSettings { session_mb: 3, ..settings() };
    assert_eq!(look(&disk, &of_session, 100.0, Some(&session)).allowed, Allowed::All);
    let rest = session.join("rest");
    put(&disk, &rest, &vec![0; MEBIBYTE * 8 / 10]);
    assert_eq!(
        look(&disk, &of_session, 100.0, Some(&session)).allowed,
        Allowed::NoFrames("session_quota"),
        "the last tenth is for tags and measurements"
    );
    disk.remove(&rest).unwrap();
    let total = RecordingSettings { total_mb: 4, ..settings() };
    assert_eq!(look(&disk, &total, 100.0, None).allowed, Allowed::All, "room was made");
    assert_eq!(evicted(&disk), ["a/0000.mcap"]);
    let total = RecordingSettings { total_mb: 2, ..settings() };
    assert_eq!(look(&disk, &total, 100.0, None).allowed, Allowed::Nothing("total_quota"));
    assert_eq!(evicted(&disk), ["a/0000.mcap", "a/0001.mcap"]);
}

#[test]
fn the_floor_is_the_higher_of_bytes_and_share() {
    let disk = disk();
    add(&disk, "a", &[], false);
    let share = RecordingSettings { floor_mb: 1, floor_percent: 50.0, ..settings() };
    assert_eq!(look(&disk, &share, 1.5, None).allowed, Allowed::NoFrames("disk_full"));
    assert_eq!(look(&disk, &share, 3.0, None).allowed, Allowed::All);
}
