//! The recorder as a process: killed, starved of its folder, asked to keep up.

use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use realitysim::recording::{Counts, ManifestLine};
use realitysim::ros2::{LogReader, Selection};
use serde_json::Value;

use crate::replay::support::{CAPTURES, IMAGE, Room};

const PATIENCE: Duration = Duration::from_secs(60);

/// Whatever is left on the disk of whoever tests.
const ROOM_ENOUGH: &str = "--set recording.floor_mb=1 --set recording.floor_percent=0";

/// A recorder with a stream of its own.
struct Soak {
    process: Child,
    states: std::io::Lines<BufReader<std::process::ChildStdout>>,
}

impl Soak {
    fn start(room: &Room, arguments: &str) -> Self {
        let mut process = Command::new(env!("CARGO_BIN_EXE_realitysim"))
            .args(["measure", "soak", "-o", CAPTURES, "--states", "--json"])
            .args(arguments.split_whitespace())
            .args(ROOM_ENOUGH.split_whitespace())
            .current_dir(room.path(""))
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let states = BufReader::new(process.stdout.take().unwrap()).lines();
        Self { process, states }
    }

    fn state(&mut self) -> Value {
        serde_json::from_str(&self.states.next().expect("it is running").unwrap()).unwrap()
    }

    fn waits_for(&mut self, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let state = self.state();
            if is(&state) {
                return state;
            }
            assert!(began.elapsed() < PATIENCE, "{what}: {state}");
        }
    }
}

impl Drop for Soak {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn only_session(room: &Room) -> PathBuf {
    let folders = fs::read_dir(room.path(CAPTURES)).unwrap().map(|entry| entry.unwrap().path());
    folders.into_iter().find(|path| path.join("session.json").is_file()).expect("a session")
}

/// Sequence numbers of all frames in the files that end like this.
fn frames(session: &Path, endings: &[&str]) -> Vec<u32> {
    let names: BTreeSet<String> =
        fs::read_dir(session).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    let mut found = Vec::new();
    for name in names.iter().filter(|name| endings.iter().any(|ending| name.ends_with(ending))) {
        let file = fs::File::open(session.join(name)).unwrap();
        let Ok(reader) = LogReader::open(file, Selection::topics([IMAGE])) else { continue };
        found.extend(reader.map(|message| message.unwrap().sequence));
    }
    found
}

fn assert_in_a_row(frames: &[u32], what: &str) {
    let expected: Vec<u32> = (0..frames.len() as u32).collect();
    assert!(frames == expected, "{what}: {} frames, not in a row", frames.len());
}

/// How often the recorder is killed: `REALITYSIM_KILLS`.
fn kills() -> u64 {
    std::env::var("REALITYSIM_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(50)
}

/// Where the moments begin: `REALITYSIM_KILL_SEED`, or another one in each run.
fn kill_seed() -> u64 {
    let wanted = std::env::var("REALITYSIM_KILL_SEED").ok().map(|text| text.parse().expect("a number"));
    wanted.unwrap_or_else(|| std::time::UNIX_EPOCH.elapsed().unwrap().as_secs())
}

#[test]
fn a_recorder_that_is_killed_at_any_moment_keeps_what_the_disk_had() {
    // A few at a time: most of each is waiting.
    const AT_ONCE: usize = 5;
    // Over several syncs and two segments.
    const MOMENTS_US: u64 = 600_000;
    let seed = kill_seed();
    println!("REALITYSIM_KILL_SEED={seed}");
    let mut drawn = vec![0; 8 * kills() as usize];
    blake3::Hasher::new().update(&seed.to_le_bytes()).finalize_xof().fill(&mut drawn);
    let moments = drawn.as_chunks::<8>().0.iter().map(|bytes| u64::from_le_bytes(*bytes) % MOMENTS_US);
    let moments: Vec<(u64, Duration)> = (0..).zip(moments.map(Duration::from_micros)).collect();
    std::thread::scope(|scope| {
        for first in 0..AT_ONCE {
            let moments = moments.iter().skip(first).step_by(AT_ONCE);
            scope.spawn(move || moments.for_each(|(kill, moment)| kill_and_repair(*kill, *moment)));
        }
    });
}

fn kill_and_repair(kill: u64, moment: Duration) {
    let room = Room::new();
    // A segment in a quarter of a second, a sync in a fiftieth.
    let stream = "--rate 200 --frame-kb 20 --set recording.segment_mb=1 --set recording.sync_interval_ms=20";
    let mut soak = Soak::start(&room, stream);
    soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(0));
    std::thread::sleep(moment);
    let _ = soak.process.kill();
    let _ = soak.process.wait();
    let synced = soak
        .states
        .by_ref()
        .map_while(Result::ok)
        .filter_map(|line| serde_json::from_str(&line).ok())
        .fold(0, |most: u64, state: Value| most.max(state["frames_synced"].as_u64().unwrap_or(0)));
    let session = only_session(&room);
    let at_once = frames(&session, &[".mcap", ".mcap.active"]);
    assert_in_a_row(&at_once, "as it lies there");
    assert!(at_once.len() as u64 >= synced, "kill {kill}: {} of {synced}", at_once.len());

    let repaired = room.run(&format!("sessions repair --captures {CAPTURES} --json"));
    assert!(matches!(repaired.code, Some(0 | 3)), "{repaired:?}");
    let whole = frames(&session, &[".mcap"]);
    assert_in_a_row(&whole, "repaired");
    assert!(whole.len() >= at_once.len(), "kill {kill}: {} of {}", whole.len(), at_once.len());
    room.run(&format!("sessions verify --captures {CAPTURES}")).succeeds();
    let again = room.run(&format!("sessions repair --captures {CAPTURES}")).succeeds();
    assert!(again.stdout.trim_end().ends_with(": whole"), "{again:?}");
    if kill == 0 {
        let info = room.run(&format!("log info {CAPTURES}/{}", session.file_name().unwrap().display()));
        assert_eq!(info.code, Some(0), "{info:?}");
        other_readers_agree(&session, whole.len());
    }
}

/// Of all segments, checked one by one.
fn manifest_counts(session: &Path) -> Counts {
    let mut sum = Counts::default();
    for line in fs::read_to_string(session.join("manifest.jsonl")).unwrap().lines() {
        let line: ManifestLine = serde_json::from_str(line).unwrap();
        assert!(line.frames.is_conserved(), "{line:?}");
        sum.add(&line.frames);
    }
    sum
}

#[test]
fn thinning_is_accounted_for_through_the_thread_and_through_a_crash() {
    let thinned = "--set recording.thinning.mode=\"rate\" --set recording.segment_mb=1";
    let room = Room::new();
    let report =
        room.run(&format!("measure soak -o {CAPTURES} --seconds 2 {thinned} {ROOM_ENOUGH} --json")).succeeds().json();
    let counts: Counts = serde_json::from_value(report["counts"].clone()).unwrap();
    assert!(counts.is_conserved() && counts.thinned > 8 * counts.written, "{counts:?}");
    assert_eq!(manifest_counts(&only_session(&room)), counts, "each in the segment in which it was");

    let room = Room::new();
    let mut soak = Soak::start(&room, &format!("--frame-kb 20 {thinned} --set recording.sync_interval_ms=50"));
    soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(4));
    drop(soak);
    room.run(&format!("sessions repair --captures {CAPTURES}"));
    let session = only_session(&room);
    let counts = manifest_counts(&session);
    assert_eq!(counts.written as usize, frames(&session, &[".mcap"]).len());
    assert!(counts.thinned > 0 && counts.tagged <= counts.captured, "{counts:?}");
    assert!(counts.captured <= counts.tagged + 1, "an image whose tag was cut off: {counts:?}");
}

/// With the readers that people use in Python, if `REALITYSIM_PYTHON` names one that has them.
fn other_readers_agree(session: &Path, frames: usize) {
    let Some(python) = std::env::var_os("REALITYSIM_PYTHON") else {
        println!("skipped: REALITYSIM_PYTHON names no interpreter");
        return;
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recording/check_repaired.py");
    let output = Command::new(python).arg(script).arg(session).arg(frames.to_string()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_mount_that_vanishes_for_a_while_is_named_and_recovered_from() {
    let room = Room::new();
    let mut soak = Soak::start(&room, "--seconds 8 --rate 30 --frame-kb 20 --set recording.segment_s=1");
    soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(10));
    let (there, away) = (room.path(CAPTURES), room.path("away"));
    fs::rename(&there, &away).unwrap();
    soak.waits_for("named", |state| state["fault"]["cause"] == "disk_gone");
    fs::rename(&away, &there).unwrap();
    soak.waits_for("recovered", |state| state["fault"].is_null() && state["faults"]["disk_gone"].as_u64() > Some(0));
    let report: Value = soak.states.by_ref().map(|line| serde_json::from_str(&line.unwrap()).unwrap()).last().unwrap();
    assert!(soak.process.wait().unwrap().success(), "{report}");
    let counts = &report["counts"];
    assert_eq!((&counts["captured"], &counts["dropped"]), (&counts["written"], &serde_json::json!({})), "{report}");
    room.run(&format!("sessions repair --captures {CAPTURES}")).succeeds();
    let all = frames(&only_session(&room), &[".mcap"]);
    assert_in_a_row(&all, "all of it waited in memory");
    assert_eq!(Some(all.len() as u64), counts["captured"].as_u64());
    room.run(&format!("sessions verify --captures {CAPTURES}")).succeeds();
}

#[test]
fn a_removed_session_folder_is_reported_and_later_frames_are_kept() {
    let room = Room::new();
    let mut soak = Soak::start(&room, "--seconds 6 --rate 30 --frame-kb 20");
    soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(10));
    let removed = only_session(&room);
    fs::remove_dir_all(&removed).unwrap();
    let state = soak.waits_for("told", |state| state["faults"]["removed"] == 1);
    assert_eq!(state["conserved"], true, "{state}");
    let report: Value = soak.states.by_ref().map(|line| serde_json::from_str(&line.unwrap()).unwrap()).last().unwrap();
    assert_eq!(soak.process.wait().unwrap().code(), Some(3), "{report}");
    let counts: Counts = serde_json::from_value(report["counts"].clone()).unwrap();
    assert!(counts.is_conserved() && counts.dropped["removed"] > 10, "{counts:?}");
    let all = frames(&only_session(&room), &[".mcap"]);
    assert_eq!(all.len() as u64, counts.written, "every frame that came after it");
    assert!(all.windows(2).all(|pair| pair[1] == pair[0] + 1) && all.len() > 30, "in a row: {all:?}");
    room.run(&format!("sessions verify --captures {CAPTURES}")).succeeds();
}

#[test]
fn a_session_that_is_being_recorded_is_left_alone() {
    let room = Room::new();
    let mut soak = Soak::start(&room, "--rate 30 --frame-kb 20");
    soak.waits_for("it writes", |state| state["frames_synced"].as_u64() > Some(0));
    let repaired = room.run(&format!("sessions repair --captures {CAPTURES}")).succeeds();
    assert!(repaired.stdout.contains("is being recorded"), "{repaired:?}");
    assert!(only_session(&room).join("0000.mcap.active").is_file());
    soak.waits_for("it goes on", |state| state["segments_given_up"] == 0);
}

/// The stream of the issue, for a few seconds; `./dev soak` takes ten minutes, at under 10 % of a core.
#[test]
fn the_recorder_keeps_up_with_60_frames_and_500_measurements_a_second() {
    let room = Room::new();
    let run = room.run(&format!("measure soak -o {CAPTURES} --seconds 4 --json {ROOM_ENOUGH}")).succeeds();
    let report = run.json();
    assert_eq!(report["counts"]["dropped"], serde_json::json!({}), "{report}");
    assert!(report["counts"]["written"].as_u64() > Some(200), "{report}");
    assert!(report["recorder"]["conserved"] == true, "{report}");
    room.run(&format!("sessions verify --captures {CAPTURES}")).succeeds();
}

#[test]
fn a_soak_that_costs_more_than_it_may_fails() {
    let room = Room::new();
    let soak = |most: &str| {
        room.run(&format!("measure soak -o {CAPTURES} --seconds 1 --max-core-percent {most} {ROOM_ENOUGH}"))
    };
    soak("100000").succeeds();
    soak("0.0001").fails(1, &["% of a core, and 0.0001 % are allowed"]);
    soak("0").fails(2, &["more than 0"]);
}

#[test]
fn what_is_no_session_is_neither_touched_nor_followed() {
    let room = Room::new();
    room.run(&format!("measure soak -o {CAPTURES} --seconds 1 {ROOM_ENOUGH}")).succeeds();
    let session = only_session(&room);
    fs::write(session.join("notes.txt"), "mine").unwrap();
    fs::write(session.join("x.mcap.active"), "not ours").unwrap();
    std::os::unix::fs::symlink("/etc/passwd", session.join("0007.mcap.active")).unwrap();
    fs::create_dir(room.path(CAPTURES).join("other")).unwrap();
    fs::write(room.path(CAPTURES).join("other/walk.mcap.active"), "no session").unwrap();
    let whole = room.run(&format!("sessions repair --captures {CAPTURES}")).succeeds();
    assert!(whole.stdout.trim_end().ends_with(": whole"), "{whole:?}");
    assert_eq!(fs::read_to_string(session.join("notes.txt")).unwrap(), "mine");
    assert!(session.join("x.mcap.active").is_file() && session.join("0007.mcap.active").is_symlink());

    // A name that leads out of the folder, and a version that is not known.
    let manifest = session.join("manifest.jsonl");
    let line = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, format!("{line}{}", line.replace("0000.mcap", "../../etc.mcap"))).unwrap();
    room.run(&format!("sessions verify --captures {CAPTURES}")).fails(3, &[]);
    fs::write(&manifest, line).unwrap();
    let info = fs::read_to_string(session.join("session.json")).unwrap();
    fs::write(session.join("session.json"), info.replace("\"format\": 1", "\"format\": 9")).unwrap();
    room.run(&format!("sessions repair --captures {CAPTURES}")).fails(1, &["format 9"]);
}

/// In a mount namespace of its own: a real file system with `size` mebibytes. `None` where that is not allowed.
fn on_a_small_disk(room: &Room, size: u32, script: &str) -> Option<Output> {
    let program = env!("CARGO_BIN_EXE_realitysim");
    let script = format!(
        "mkdir -p {CAPTURES} && mount -t tmpfs -o size={size}m none {CAPTURES} || exit 77\nrs={program}\n{script}"
    );
    let command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", &script];
    let output = Command::new(command[0]).args(&command[1..]).current_dir(room.path("")).output().ok()?;
    let refused = output.status.code() == Some(77) || String::from_utf8_lossy(&output.stderr).contains("unshare:");
    assert!(!refused || std::env::var_os("CI").is_none(), "no file system can be mounted here: {output:?}");
    if refused {
        println!("skipped: no file system can be mounted here");
    }
    (!refused).then_some(output)
}

#[test]
fn a_real_disk_full_for_a_while_loses_nothing_that_fits_into_memory() {
    let room = Room::new();
    let script = format!(
        "dd if=/dev/zero of={CAPTURES}/filler bs=1M count=10 status=none\n(sleep 2; rm {CAPTURES}/filler) &\n\
         $rs measure soak -o {CAPTURES} --seconds 4 --rate 30 --frame-kb 40 --json --set recording.segment_mb=1 \
         --set recording.floor_mb=0 --set recording.floor_percent=0 >report.json; echo ended with $?\n\
         $rs sessions repair --captures {CAPTURES}; $rs sessions verify --captures {CAPTURES} && echo verified"
    );
    let Some(output) = on_a_small_disk(&room, 12, &script) else { return };
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("ended with 0") && said.contains("verified"), "{output:?}");
    let report: Value = serde_json::from_slice(&fs::read(room.path("report.json")).unwrap()).unwrap();
    assert_eq!(report["counts"]["captured"], report["counts"]["written"], "{report}");
    assert!(report["recorder"]["faults"]["disk_full"].as_u64() > Some(0), "it was full: {report}");
}

#[test]
fn a_real_disk_that_fills_up_stops_frames_and_keeps_tags() {
    let room = Room::new();
    let script = format!(
        "$rs measure soak -o {CAPTURES} --seconds 4 --rate 60 --frame-kb 80 --json --set recording.segment_mb=1 \
         --set recording.floor_mb=6 --set recording.floor_percent=0 >report.json; echo ended with $?\n\
         $rs sessions verify --captures {CAPTURES} && echo verified; $rs sessions list --captures {CAPTURES} --json >list.json"
    );
    let Some(output) = on_a_small_disk(&room, 16, &script) else { return };
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("ended with 3") && said.contains("verified"), "{output:?}");
    let json = |name: &str| -> Value { serde_json::from_slice(&fs::read(room.path(name)).unwrap()).unwrap() };
    let (report, list) = (json("report.json"), json("list.json"));
    assert!(report["counts"]["dropped"]["disk_full"].as_u64() > Some(0), "{report}");
    assert_eq!(report["recorder"]["conserved"], true, "{report}");
    let counts: Counts = serde_json::from_value(list[0]["frames"].clone()).unwrap();
    assert_eq!((counts.captured, counts.tagged), (report["counts"]["captured"].as_u64().unwrap(), counts.captured));
}

#[test]
fn a_real_disk_without_inodes_is_survived_until_there_are_some_again() {
    let room = Room::new();
    let script = format!(
        "mount -o remount,nr_inodes=60 {CAPTURES} || exit 77\n\
         (sleep 1; i=0; while true >{CAPTURES}/x$i; do i=$((i+1)); done; sleep 2; rm -f {CAPTURES}/x*) 2>/dev/null &\n\
         $rs measure soak -o {CAPTURES} --seconds 6 --rate 30 --frame-kb 20 --json --set recording.segment_s=1 \
         --set recording.floor_mb=1 --set recording.floor_percent=0 >report.json; echo ended with $?\n\
         $rs sessions verify --captures {CAPTURES} && echo verified; $rs sessions list --captures {CAPTURES} --json >list.json"
    );
    let Some(output) = on_a_small_disk(&room, 64, &script) else { return };
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(said.contains("verified"), "{output:?}");
    let json = |name: &str| -> Value { serde_json::from_slice(&fs::read(room.path(name)).unwrap()).unwrap() };
    let (report, list) = (json("report.json"), json("list.json"));
    let named =
        report["counts"]["dropped"]["no_inodes"].as_u64().or(report["recorder"]["faults"]["no_inodes"].as_u64());
    assert!(named > Some(0), "{report}");
    assert_eq!((&report["recorder"]["conserved"], &report["recorder"]["fault"]), (&Value::Bool(true), &Value::Null));
    let counts: Counts = serde_json::from_value(list[0]["frames"].clone()).unwrap();
    assert_eq!(Some(counts.written), report["counts"]["written"].as_u64(), "{report}");
    assert!(counts.written > 60, "before and after: {report}");
}

/// No file may grow beyond 300 KiB: every segment fails long before it is full.
#[test]
fn segments_that_cannot_grow_are_given_up_and_nothing_is_lost() {
    let room = Room::new();
    let program = env!("CARGO_BIN_EXE_realitysim");
    let script = format!(
        "trap '' XFSZ; ulimit -f 600; exec {program} measure soak -o {CAPTURES} --seconds 2 --rate 30 --frame-kb 20 --json {ROOM_ENOUGH}"
    );
    let output = Command::new("sh").args(["-c", &script]).current_dir(room.path("")).output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(report["recorder"]["segments_given_up"].as_u64() > Some(2), "{report}");
    assert_eq!(report["counts"]["captured"], report["counts"]["written"], "{report}");
    room.run(&format!("sessions repair --captures {CAPTURES}"));
    let all = frames(&only_session(&room), &[".mcap"]);
    assert_in_a_row(&all, "each once");
    assert_eq!(Some(all.len() as u64), report["counts"]["written"].as_u64());
}

/// A finished session of three segments.
fn three_segments(room: &Room) -> PathBuf {
    let stream = "--rate 100 --frame-kb 20 --set recording.segment_mb=1";
    room.run(&format!("measure soak -o {CAPTURES} --seconds 2 {stream} {ROOM_ENOUGH}")).succeeds();
    let session = only_session(room);
    assert!(session.join("0002.mcap").is_file(), "three at least");
    session
}

#[test]
fn of_two_lines_that_differ_repair_keeps_the_one_that_is_true() {
    let room = Room::new();
    let session = three_segments(&room);
    let manifest = session.join("manifest.jsonl");
    let text = fs::read_to_string(&manifest).unwrap();
    let second = text.lines().nth(1).unwrap();
    let hash = serde_json::from_str::<serde_json::Value>(second).unwrap()["blake3"].as_str().unwrap().to_owned();
    let wrong = second.replace(&hash, &"0".repeat(64));
    fs::write(&manifest, format!("{wrong}\n{text}")).unwrap();
    room.run(&format!("sessions repair --captures {CAPTURES}")).succeeds();
    assert_eq!(fs::read_to_string(&manifest).unwrap(), text);
    // None of them is true: both stay.
    let doubtful = text.replace(second, &format!("{wrong}\n{}", second.replace(&hash, &"1".repeat(64))));
    fs::write(&manifest, &doubtful).unwrap();
    room.run(&format!("sessions repair --captures {CAPTURES}")).fails(3, &[]);
    assert_eq!(fs::read_to_string(&manifest).unwrap(), doubtful);
}

#[test]
fn what_is_damaged_and_in_no_manifest_is_listed_with_its_loss() {
    let room = Room::new();
    let session = three_segments(&room);
    let (manifest, segment) = (session.join("manifest.jsonl"), session.join("0001.mcap"));
    let text = fs::read_to_string(&manifest).unwrap();
    let others: Vec<&str> = text.lines().filter(|line| !line.contains("0001.mcap")).collect();
    fs::write(&manifest, others.join("\n") + "\n").unwrap();
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 6].copy_from_slice(b"ROTTEN");
    fs::write(&segment, &bytes).unwrap();
    let repaired = room.run(&format!("sessions repair --captures {CAPTURES}")).fails(3, &[]);
    assert!(repaired.stdout.contains("lost: ") && repaired.stdout.contains("0001.mcap"), "{repaired:?}");
    let listed = fs::read_to_string(&manifest).unwrap();
    let line = listed.lines().find(|line| line.contains("0001.mcap")).expect("listed");
    let line: serde_json::Value = serde_json::from_str(line).unwrap();
    assert!(line["cut_bytes"].as_u64() > Some(0), "{line}");
    assert!(fs::read(&segment).unwrap() == bytes, "left as it is");
}

#[test]
fn repair_does_not_call_whole_what_is_not() {
    let room = Room::new();
    let session = three_segments(&room);
    let repaired = || room.run(&format!("sessions repair --captures {CAPTURES}"));
    let [manifest, segment, head] = ["manifest.jsonl", "0001.mcap", "session.json"].map(|name| session.join(name));
    let (text, bytes) = (fs::read_to_string(&manifest).unwrap(), fs::read(&segment).unwrap());

    fs::write(&segment, &bytes[..bytes.len() / 2]).unwrap();
    assert!(repaired().fails(3, &[]).stdout.contains("0001.mcap: has "), "cut");
    fs::write(&segment, &bytes).unwrap();
    assert!(repaired().succeeds().stdout.trim_end().ends_with(": whole"));

    fs::write(&manifest, format!("{text}{}\n", text.lines().next().unwrap().replace("0000.mcap", "../x"))).unwrap();
    assert!(repaired().fails(3, &[]).stdout.contains("no name of a segment"), "a name that leads away");
    fs::write(&manifest, &text).unwrap();

    fs::remove_file(&manifest).unwrap();
    fs::remove_file(&segment).unwrap();
    assert!(repaired().fails(3, &[]).stdout.contains("0001.mcap: is missing"), "manifest and a segment");
    fs::write(&manifest, &text).unwrap();
    fs::write(&segment, &bytes).unwrap();

    fs::remove_file(&head).unwrap();
    assert!(repaired().fails(3, &[]).stdout.contains("has no session.json"), "headless");
    std::process::Command::new("mkfifo").arg(&head).status().unwrap();
    assert!(repaired().fails(3, &[]).stdout.contains("no plain file"), "a pipe");
}
