//! Over real ssh: cut, corrupted, killed, and a disk that is full.

use std::fs;
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use realitysim::recording::sync::{Options, Selection, Source, Store, round};

use super::site::{Site, Synced, contents, finish_segment, noise};

/// Different with every N, the same in every run.
fn draws(seed: u64, count: usize, below: u64) -> Vec<u64> {
    let bytes = noise(seed, 8 * count);
    let (numbers, _) = bytes.as_chunks::<8>();
    numbers.iter().map(|number| u64::from_le_bytes(*number) % below).collect()
}

const SEGMENT: usize = 300_000;

fn robot_with_two_sessions(site: &Site) {
    for (which, name) in ["2026-11-21T10-00-00Z-r1", "2026-11-21T11-00-00Z-r1"].into_iter().enumerate() {
        let segments: Vec<_> = (0..3).map(|index| noise((10 * which + index) as u64, SEGMENT + index)).collect();
        site.session("robot", name, &segments);
    }
}

#[test]
fn everything_comes_over_ssh_is_acknowledged_and_comes_once() {
    let Some(site) = Site::with_ssh() else { return };
    robot_with_two_sessions(&site);
    let report = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!((report["fetched"].as_u64(), report["acknowledged"].as_bool()), (Some(6), Some(true)), "{report}");
    assert_eq!(site.holds("robot", &["dev"]), 6);
    assert_eq!(contents(&site.path("dev")), contents(&site.path("robot")));
    let again = site.sync("robot", "dev", &["--json"]).ends(0).json();
    assert_eq!((again["fetched"].as_u64(), again["already"].as_u64()), (Some(0), Some(6)), "{again}");
}

#[test]
fn a_link_cut_at_random_bytes_acknowledges_only_what_has_arrived() {
    let Some(site) = Site::with_ssh() else { return };
    robot_with_two_sessions(&site);
    // Each round has up to nine calls of ssh; they are cut anywhere, some in the greeting, most in the middle of a segment.
    for round in 0..12 {
        let cuts = draws(round, 9, if round % 3 == 0 { 2_000 } else { 900_000 });
        site.mangles(&cuts.iter().map(|at| format!("cut {at}")).collect::<Vec<_>>());
        let synced = site.sync("robot", "dev", &[]);
        assert!(matches!(synced.code, Some(0 | 1)) && !synced.stderr.contains("panicked"), "{synced:?}");
        site.holds("robot", &["dev"]);
    }
    site.mangles(&[]);
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 6);
    assert_eq!(contents(&site.path("dev")), contents(&site.path("robot")));
}

#[test]
fn what_vanishes_during_a_fetch_is_not_lost_where_another_has_it() {
    let Some(site) = Site::with_ssh() else { return };
    for (name, during, code, says) in [
        ("gone", "rm -r S", 1, "moved or gone there meanwhile: run it again"),
        ("moved", "mv S S-renamed", 1, "moved or gone there meanwhile: run it again"),
        ("evicted", "rm S/0001.mcap; cp S/later S/evicted.jsonl", 0, "gone there; other has it"),
        ("lost", "rm S/0001.mcap", 3, "0001.mcap: could not be had"),
    ] {
        let folder = site.session(name, "s", &[noise(1, SEGMENT), noise(2, SEGMENT)]);
        let hash = super::site::hash_of(&noise(2, SEGMENT));
        let evicted = serde_json::json!({ "file": "0001.mcap", "bytes": SEGMENT, "blake3": hash, "receiver": "other" });
        fs::write(folder.join("later"), format!("{evicted}\n")).expect("written");
        let during = during.replace('S', &folder.display().to_string());
        site.mangles(&["pass".to_owned(), "pass".to_owned(), format!("do {during}")]);
        let synced = site.sync(name, &format!("dev-{name}"), &[]).says(says).ends(code);
        assert_eq!(synced.stderr.contains("lost: "), code == 3, "{synced:?}");
    }
}

#[test]
fn a_damaged_segment_is_not_fetched_again_until_it_changes() {
    let Some(site) = Site::new() else { return };
    let path = site.session("robot", "s", &[noise(1, 1_000)]).join("0000.mcap");
    let mut damaged = noise(1, 1_000);
    damaged[500] ^= 1;
    fs::write(&path, damaged).expect("written");
    let store = Store::open(&site.path("dev")).expect("a store");
    let options = Options {
        source: Source::parse(site.path("robot").to_str().expect("text")).expect("a source"),
        selection: Selection::default(),
        ssh: String::new(),
        acknowledge: true,
    };
    let round = || round(&options, &store, &AtomicBool::new(false), &mut |_| ()).expect("a round");
    for said in ["came 2 times with another hash", "came damaged before", "came damaged before"] {
        let report = round();
        assert!(report.lost.len() == 1 && report.lost[0].why.starts_with(said), "{report:?}");
    }
    fs::write(&path, noise(1, 1_000)).expect("mended");
    let file = fs::File::options().write(true).open(&path).expect("opened");
    file.set_modified(std::time::SystemTime::now() + Duration::from_secs(5)).expect("set");
    assert_eq!((round().fetched, round().already), (1, 1));
}

#[test]
fn a_cut_transfer_goes_on_where_it_broke() {
    let Some(site) = Site::with_ssh() else { return };
    site.session("robot", "s", &[noise(1, 4_000_000)]);
    // Listing, manifest, then three tries of the segment, each with a third of it.
    let cuts = ["pass", "pass", "cut 1500000", "cut 1500000", "cut 1500000"];
    site.mangles(&cuts.map(str::to_owned));
    site.sync("robot", "dev", &[]).ends(0).says("it is tried again");
    assert_eq!(site.holds("robot", &["dev"]), 1);
}

#[test]
fn bytes_flipped_on_the_way_are_never_believed() {
    let Some(site) = Site::with_ssh() else { return };
    robot_with_two_sessions(&site);
    for round in 0..8 {
        let flips = draws(100 + round, 9, if round % 2 == 0 { 3_000 } else { 900_000 });
        site.mangles(&flips.iter().map(|at| format!("flip {at}")).collect::<Vec<_>>());
        let synced = site.sync("robot", "dev", &[]);
        assert!(synced.code.is_some() && !synced.stderr.contains("panicked"), "{synced:?}");
        site.holds("robot", &["dev"]);
    }
    site.mangles(&[]);
    site.sync("robot", "dev", &[]);
    assert_eq!(site.holds("robot", &["dev"]), 6);
    assert_eq!(contents(&site.path("dev")), contents(&site.path("robot")));
}

#[test]
fn a_sync_killed_anywhere_claims_nothing_false_and_the_next_ends_it() {
    let Some(site) = Site::with_ssh() else { return };
    robot_with_two_sessions(&site);
    for delay_ms in draws(7, 10, 1_500) {
        let mut sync = site.command("robot", "dev", &[]).spawn().expect("started");
        std::thread::sleep(Duration::from_millis(delay_ms));
        let _ = sync.kill();
        let _ = sync.wait();
        site.holds("robot", &["dev"]);
    }
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 6);
}

#[test]
fn a_robot_that_records_meanwhile_is_followed() {
    let Some(site) = Site::with_ssh() else { return };
    let folder = site.session("robot", "2026-11-21T10-00-00Z-r1", &[noise(1, SEGMENT)]);
    let mut watch = site.command("robot", "dev", &["--watch", "--every", "1"]).spawn().expect("started");
    for index in 1..6 {
        // An open segment has another name and no line, and is not touched.
        fs::write(folder.join(format!("{index:04}.mcap.active")), noise(99, 1000)).expect("written");
        std::thread::sleep(Duration::from_millis(400));
        finish_segment(&folder, index, &noise(index as u64, SEGMENT));
        site.holds("robot", &["dev"]);
    }
    let began = std::time::Instant::now();
    while site.holds("robot", &["dev"]) < 6 {
        assert!(began.elapsed() < Duration::from_secs(60), "never came");
        std::thread::sleep(Duration::from_millis(100));
    }
    let id = rustix::process::Pid::from_raw(watch.id() as i32).expect("a process");
    rustix::process::kill_process(id, rustix::process::Signal::INT).expect("alive");
    assert!(watch.wait().expect("ended").success());
    assert!(!site.path("dev/2026-11-21T10-00-00Z-r1/0001.mcap.active").exists());
}

#[test]
fn a_full_disk_acknowledges_nothing_more_until_there_is_room_again() {
    let Some(site) = Site::with_ssh() else { return };
    site.session("robot", "small", &[noise(1, 200_000)]);
    site.session("robot", "z-large", &[noise(2, 3_000_000)]);
    // No file may grow beyond a megabyte: an error in the middle of a write, as of a full disk.
    let sync = site.command("robot", "dev", &[]);
    let mut limited = Command::new("bash");
    limited.current_dir(site.path("")).args(["-c", "trap '' XFSZ; ulimit -f 1024; exec \"$@\"", "bash"]);
    limited.arg(sync.get_program()).args(sync.get_args());
    Synced::of(limited.output().expect("ran")).ends(1).says("so large");
    assert_eq!(site.holds("robot", &["dev"]), 1, "what fits is here and acknowledged");
    site.sync("robot", "dev", &[]).ends(0);
    assert_eq!(site.holds("robot", &["dev"]), 2);
}

#[test]
fn what_has_no_room_is_not_begun() {
    let Some(site) = Site::new() else { return };
    site.session("robot", "s", &(0..4).map(|index| noise(index, 2_000_000)).collect::<Vec<_>>());
    let disk = site.path("disk");
    fs::create_dir(&disk).expect("made");
    let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=70m", "tmpfs"]).arg(&disk).output();
    if !mounted.is_ok_and(|mounted| mounted.status.success()) {
        println!("skipped: only root may mount a small disk");
        return;
    }
    let synced = site.sync("robot", "disk/dev", &["--json"]);
    let held = site.holds("robot", &["disk/dev"]);
    let _ = Command::new("umount").arg(&disk).status();
    let report = synced.ends(1).says("no room here").json();
    assert!(report["no_room_bytes"].as_u64() > Some(0), "{report}");
    assert!((1..4).contains(&held), "{held}");
}

#[test]
fn a_disk_that_fills_up_during_a_transfer_tears_nothing() {
    let Some(site) = Site::with_ssh() else { return };
    site.session("robot", "s", &(0..3).map(|index| noise(index, 2_000_000)).collect::<Vec<_>>());
    let disk = site.path("disk");
    fs::create_dir(&disk).expect("made");
    let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=80m", "tmpfs"]).arg(&disk).output();
    if !mounted.is_ok_and(|mounted| mounted.status.success()) {
        println!("skipped: only root may mount a small disk");
        return;
    }
    let filler = disk.join("filler");
    // There is room when it is planned; somebody else takes all but three megabytes before the first segment comes.
    let fill = format!("fill {}", filler.display());
    let mut held = Vec::new();
    let mut ended = Vec::new();
    for _ in 0..2 {
        site.mangles(&["pass".to_owned(), "pass".to_owned(), fill.clone()]);
        ended.push(site.sync("robot", "disk/dev", &[]));
        held.push(site.holds("robot", &["disk/dev"]));
        fs::remove_file(&filler).expect("it was filled");
    }
    let last = site.sync("robot", "disk/dev", &["--json"]);
    held.push(site.holds("robot", &["disk/dev"]));
    let verified = site.run("sessions verify --captures disk/dev");
    let info = fs::read_to_string(disk.join("dev/s/manifest.jsonl"));
    let _ = Command::new("umount").arg(&disk).status();
    ended.remove(0).ends(1).says("no space left");
    last.ends(0);
    verified.ends(0);
    assert!(held[0] < 3 && held[2] == 3, "{held:?}");
    assert_eq!(info.expect("there").lines().count(), 3, "no line was torn");
}

#[test]
fn a_slow_transfer_tells_its_progress_its_rate_and_the_time_left() {
    let Some(site) = Site::with_ssh() else { return };
    site.session("robot", "s", &[noise(1, 3_000_000)]);
    site.mangles(&["pass", "pass", "slow 150"].map(str::to_owned));
    let said = site.sync("robot", "dev", &[]).ends(0).says("segments to come: 1, 3.0 MB").stderr;
    // Before the first bytes have come nobody knows how long it will take.
    let told = |line: &str| line.contains(" of 3.0 MB, ") && line.contains("/s, ") && line.ends_with(" s left");
    assert!(said.lines().any(told), "{said}");
}
