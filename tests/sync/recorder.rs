//! A robot that records with the recorder's own thread: fetched while it writes, and freed of what was fetched.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use realitysim::recording::ManifestLine;
use serde_json::Value;

use super::site::{Site, contents};

/// A segment in less than half a second.
const STREAM: &str = "--rate 60 --frame-kb 40 --set recording.segment_mb=1 --set recording.sync_interval_ms=100 \
                      --set recording.floor_mb=1 --set recording.floor_percent=0";

fn record(site: &Site, seconds: u32, more: &str, code: i32) -> (PathBuf, Value) {
    let ended = site.run(&format!("measure soak -o robot --seconds {seconds} --json {STREAM} {more}")).ends(code);
    let report = ended.json();
    (site.path(report["session"].as_str().expect("a session")), report)
}

fn lines(session: &Path) -> Vec<ManifestLine> {
    let text = fs::read_to_string(session.join("manifest.jsonl")).expect("a manifest");
    text.lines().map(|line| serde_json::from_str(line).expect("a line")).collect()
}

/// Names of the segments that lie there.
fn there(session: &Path) -> Vec<String> {
    lines(session).into_iter().map(|line| line.name).filter(|name| session.join(name).is_file()).collect()
}

/// Size of the segments that lie there.
fn bytes(session: &Path) -> u64 {
    there(session).iter().map(|name| fs::metadata(session.join(name)).expect("a segment").len()).sum()
}

#[test]
fn a_robot_that_records_in_its_own_thread_is_followed() {
    let Some(site) = Site::new() else { return };
    let mut robot = Command::new(env!("CARGO_BIN_EXE_realitysim"))
        .args(["measure", "soak", "-o", "robot", "--seconds", "5", "--json"])
        .args(STREAM.split_whitespace())
        .current_dir(site.path(""))
        .stdout(Stdio::piped())
        .spawn()
        .expect("started");
    let mut before = 0;
    while robot.try_wait().expect("asked").is_none() {
        if !site.path("robot").is_dir() {
            continue;
        }
        site.sync("robot", "dev", &[]).ends(0);
        assert!(site.holds("robot", &["dev"]) >= before);
        before = site.holds("robot", &["dev"]);
    }
    assert!(before > 0, "something was fetched while it recorded");
    let output = robot.wait_with_output().expect("ended");
    assert!(output.status.success(), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let session = site.path(report["session"].as_str().expect("a session"));
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), lines(&session).len());
    assert!(contents(&site.path("dev")) == contents(&site.path("robot")));
    site.run("sessions verify --captures dev").ends(0);
    // Whoever syncs is of the recorder's group, not the recorder itself.
    let mode = fs::metadata(session.join("ack")).expect("made by the recorder").permissions().mode();
    assert_eq!(mode & 0o070, 0o070, "{mode:o}");
}

#[test]
fn eviction_frees_only_what_a_sync_has_acknowledged() {
    let Some(site) = Site::new() else { return };
    // So much that a recording of a second does not drive out all of it, even on a machine that takes three for it.
    let (synced, _) = record(&site, 4, "", 0);
    site.sync("robot", "dev", &[]).ends(0);
    let (unsynced, _) = record(&site, 1, "", 0);
    let [before, kept] = [&synced, &unsynced].map(|session| there(session));
    assert!(before.len() > 3 && !kept.is_empty(), "{before:?}, {kept:?}");

    // Together with what comes it is more than may be: the oldest goes, as much as is needed and no more.
    let quota_mb = [&synced, &unsynced].map(|session| bytes(session)).into_iter().sum::<u64>().div_ceil(1 << 20);
    record(&site, 1, &format!("--set recording.total_mb={quota_mb}"), 0);
    let left = there(&synced);
    assert!(!left.is_empty() && left.len() < before.len(), "{left:?} of {before:?}");
    assert_eq!(left, before[before.len() - left.len()..], "oldest first");
    assert_eq!(there(&unsynced), kept);
    let receiver = fs::read_to_string(site.path("dev/.sync/receiver")).expect("a name");
    let evicted = fs::read_to_string(synced.join("evicted.jsonl")).expect("told");
    assert_eq!(evicted.matches(receiver.trim()).count(), before.len() - left.len(), "{evicted}");

    // Nothing is missed by anybody.
    site.run("sessions verify --captures robot").ends(0);
    let name = synced.file_name().expect("a name").to_string_lossy().into_owned();
    let shown = site.run(&format!("sessions show {name} --captures robot --json")).ends(0).json();
    assert_eq!(
        (&shown["missing"], shown["evicted"].as_u64()),
        (&Value::from(0), Some((before.len() - left.len()) as u64))
    );
    site.sync("robot", "dev", &[]).ends(0);
    site.run("sessions verify --captures dev").ends(0);

    // Now all of it is there; even so it is more than the quota within the first second: then nothing is written, and that is told.
    let (full, report) = record(&site, 2, "--set recording.total_mb=1", 3);
    assert!(report["counts"]["dropped"]["total_quota"].as_u64() > Some(0), "{report}");
    assert_eq!([&synced, &unsynced].map(|session| there(session).len()), [0, 0]);
    let tagged: u64 = lines(&full).iter().map(|line| line.frames.tagged).sum();
    let untagged = report["counts"]["untagged"]["total_quota"].as_u64().unwrap_or(0);
    assert_eq!(Some(tagged + untagged), report["counts"]["captured"].as_u64(), "{report}");
    assert!(tagged > 0 && untagged > 0, "{report}");
    let told: u64 = lines(&full).iter().filter_map(|line| line.frames.untagged.get("total_quota")).sum();
    assert_eq!(told, untagged, "the manifest says what the recorder says: {report}");

    // What was lost at the dev machine since is said to be.
    fs::remove_file(site.path("dev").join(&name).join(&before[0])).expect("removed");
    site.sync("robot", "dev", &[&name]).ends(3).says("which it has not any more");
}
